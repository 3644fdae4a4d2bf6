"""A call's evidence that lies on a card: what is found in it there, and what comes home."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from pgm.errors import EvidenceError
from pgm.evidence import BoundEvidence
from pgm.evidence.on_card import Numbers, brought, lying_of
from pgm.kernels.arrays import Array, Integers, address
from pgm.kernels.machine.emitter.driver import Device, device
from pgm.kernels.machine.sweeps import lying as kernels
from pgm.networks import DynamicBayesianNetwork
from pgm.resources import NUMBER
from pgm.schedules.binding import bind_chain
from pgm.variables import Variable


class CardEvidence:
    """Evidence of a network, some of whose numbers lie on the card, and have been looked at.

    An EvidenceError refuses numbers of another card, of runs that do not fit together, and such as
    evidence at home may not have.

    Attributes
    ----------
    device : Device
    places : Places
        Where the numbers lie.
    lead : tuple of int
        The axis of runs, if there is one.
    runs : int
    missing : set of Variable
        The sensors of whose readings there some are missing.
    """

    def __init__(
        self, model: DynamicBayesianNetwork, evidence: Mapping[Variable, Any], steps: int | None
    ) -> None:
        self._model, self._evidence, self._steps = model, dict(evidence), steps
        self.device, self.places = device(), lying_of(evidence)
        with self.device.current():
            self.device.settle()
            for numbers in self.places.values():
                self._require_own(numbers)
        found = {each.runs: each for each in self.places.values() if each.runs is not None}
        if len(found) > 1:
            one, other = list(found.values())[:2]
            raise EvidenceError(
                f"evidence for {one.variable!r} has {one.runs} runs on the card, and for "
                f"{other.variable!r} {other.runs}; all of them were due to have as many"
            )
        self.lead, self.runs = tuple(found), next(iter(found), 1)
        looks = {owner: self._look(numbers) for owner, numbers in self.places.items()}
        self._require_finite(looks)
        self.missing = {z for (z, of), each in looks.items() if z == of and each.any()}

    def bind(self, runs: Integers | None) -> BoundEvidence:
        """The evidence of some runs, None for all, brought home and checked."""
        here = brought(self._evidence, self.places, partial(self._home, runs))
        bound = bind_chain(self._model, here, self._steps, identities=True, among=True)
        self._steps = bound.steps  # of which is warned once
        if runs is None or not self.lead:
            return bound
        return replace(bound, first_run=int(runs[0]))

    def brought(self, runs: Integers) -> dict[Variable, Any]:
        """The evidence of some runs at home, of which each array from the card has an axis."""

        def home(numbers: Numbers) -> Array:
            if numbers.runs is not None:
                return self._home(runs, numbers)
            return np.stack([self._home(None, numbers)] * len(runs))

        return brought(self._evidence, self.places, home)

    def _require_own(self, numbers: Numbers) -> None:
        try:
            self.device.require_own(numbers.address)
        except OSError as error:
            raise EvidenceError(
                f"evidence for {numbers.variable!r} does not lie on the card that sweeps, the "
                f"first that CUDA_VISIBLE_DEVICES shows: {error}",
                variable=numbers.variable,
            ) from error

    def _look(self, numbers: Numbers) -> Array:
        """The worst kind of number of each run, (runs,); see `kernels.look`."""
        runs = 1 if numbers.runs is None else numbers.runs
        down, across, cell = numbers.distances
        given = numbers.address, down, across, cell, numbers.rows, numbers.shape[-1]
        return by_run(self.device, kernels.look(self.device), given, runs)

    def _require_finite(self, looks: Mapping[tuple[Variable, Variable], Array]) -> None:
        """Refuse what is no evidence, as evidence at home is, by the first such run."""
        for (owner, of), each in looks.items():
            worst = kernels.MISSING if owner == of and self._is_sensor(owner) else kernels.FINITE
            bad = np.flatnonzero(each > worst)
            if bad.size:
                where = f" (run {bad[0]})" if self.lead else ""
                try:
                    self.bind(bad[:1])
                except EvidenceError as error:
                    told = {"variable": error.variable, "step": error.step}
                    raise EvidenceError(f"{error}{where}", **told) from error
                raise EvidenceError(f"evidence for {of!r} is not finite{where}", variable=of)

    def _is_sensor(self, variable: Variable) -> bool:
        return any(cpd.child == variable for cpd in self._model.observation)

    def _home(self, runs: Integers | None, numbers: Numbers) -> Array:
        """Numbers of some runs, None for all, copied to this machine's memory."""
        with self.device.current():
            if numbers.runs is None or runs is None:
                return _whole(self.device, numbers)
            return np.stack([_of_run(self.device, numbers.of(int(run))) for run in runs])


def by_run(own: Device, kernel: Any, given: tuple[int, ...], runs: int) -> Array:
    """The result of a kernel for each run, (runs,); `given` are all but its last arguments."""
    found = np.empty(runs)
    with own.current(), own.room(found.nbytes) as out:
        own.launch(kernel, runs, (*given, out, runs), kernels.KINDS)
        own.get(out, address(found), found.nbytes)
    return found


def _whole(own: Device, numbers: Numbers) -> Array:
    """All numbers, copied with all that lies between them."""
    pairs = zip(numbers.strides, numbers.shape, strict=True)
    extent = sum(stride * (length - 1) for stride, length in pairs) + NUMBER
    room = np.empty(extent // NUMBER)
    own.get(numbers.address, address(room), room.nbytes)
    return np.lib.stride_tricks.as_strided(room, numbers.shape, numbers.strides)


def _of_run(own: Device, numbers: Numbers) -> Array:
    """The numbers of one run, (rows, d), copied alone."""
    found = np.empty(numbers.shape)
    (rows, size), (down, cell) = numbers.shape, numbers.strides
    whole = size == 1 or (cell == NUMBER and down >= NUMBER * size)
    for k in range(1 if whole else size):
        width = NUMBER * (size if whole else 1)
        place = numbers.address + k * cell
        own.get(place, address(found[:, k:]), width, rows, NUMBER * size, down)
    return found
