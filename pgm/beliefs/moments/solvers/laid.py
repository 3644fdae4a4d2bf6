"""A chain whose arrays lie on a card: where, and the sweeps over them.

Of each array of a plan that has runs the card has one of its own, in which the runs lie beside each
other or as the user has them; of each other array it has a copy. Of one of so many runs beliefs
come home, at which traces are judged.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from math import prod
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from pgm.beliefs.moments.compiled.sweep import KNOWN, PREDICTED, squares_of
from pgm.beliefs.moments.compiled.table import Record
from pgm.beliefs.moments.digits import certificate
from pgm.beliefs.moments.steps.plan import ChainPlan
from pgm.kernels.arrays import Array, Mask, address, vacant
from pgm.kernels.machine.emitter.arena import Arena
from pgm.kernels.machine.emitter.driver import Device
from pgm.kernels.machine.studies import card as kernels
from pgm.kernels.machine.studies.sums import Cells
from pgm.kernels.machine.studies.transitions import COMPOSE, Transition, composing
from pgm.kernels.machine.sweeps import card, told
from pgm.kernels.machine.sweeps import chain as sweeps
from pgm.kernels.machine.sweeps.writer import arrays
from pgm.resources import NUMBER

Anything = npt.NDArray[Any]
# An array of the plan that tells a chain: where it lies, and how.
Key = tuple[int, tuple[int, ...], tuple[int, ...]]


class Left(Exception):
    """Work that is left to the processor, and why."""


class Sweep(NamedTuple):
    """A chain that was told: its numbers, and its arrays by the places of their addresses."""

    chain: sweeps.Chain
    numbers: Sequence[int]
    arrays: Mapping[int, Anything]


class Composed(NamedTuple):
    """A transition of several CPDs: its form, their F and Q, and the matrices that are found."""

    form: Transition
    laws: Sequence[Array]
    found: Sequence[Array]


class Told(NamedTuple):
    """A chain as a plan of a few runs tells it.

    sweeps: Forward, and back if it smooths.
    record: By name the arrays that sweeps read or fill beside those of CPDs and sensors.
    belief: The names of the means and covariances that are asked for.
    iterations: How often sensors are linearised at the most; `iterated` says if they are again.
    composed: None where one CPD is the transition, or there is no way back.
    judge: What judges traces at known and predicted beliefs of a few runs, of which some are done.
    """

    plan: ChainPlan
    sweeps: Sequence[Sweep]
    record: Record
    belief: Sequence[str]
    iterations: int
    iterated: bool
    composed: Composed | None
    judge: Callable[[Sequence[Array], Sequence[Array], Mask], None]

    @property
    def smooths(self) -> bool:
        """Whether there is a way back."""
        return len(self.sweeps) > 1


class Lying(NamedTuple):
    """How runs lie on a card: the room for them, and for those that come home, one of so many."""

    stride: int
    kept: int
    apart: int


class Laid:
    """A chain whose arrays lie on a card.

    Attributes
    ----------
    belief : tuple of Cells
        The means and covariances that the schedule is asked for.
    density : Cells
        The log-densities of each step's measurements.
    squares : mapping
        By sensor that was read, the address of its NIS and the distance between steps.
    """

    def __init__(
        self,
        chain: Told,
        fixed: Arena,
        loose: Arena,
        held: Mapping[Key, Cells],
        of: Lying,
    ) -> None:
        self._chain, self._of, self._loose = chain, of, loose
        plan, record = chain.plan, chain.record
        self._held = dict(held)
        self._residuals = loose.floats((chain.iterations + 1) * of.stride)
        self._ended = [loose.floats(sweeps.TOLD * of.stride) for _ in chain.sweeps]
        heads = zip(chain.sweeps, self._ended, strict=True)
        self._heads = [self._head(sweep, ended, fixed) for sweep, ended in heads]
        self._composing: tuple[Transition, int] | None = None
        if chain.composed is not None:
            form, laws, found = chain.composed
            cells = [self._placed(each, fixed) for each in (*laws, *found)]
            self._composing = form, kernels.table(fixed, plan.steps, *cells)
        self.known = tuple(self._held[key_of(record[name])] for name in KNOWN[:2])
        self.predicted = tuple(self._held[key_of(record[name])] for name in PREDICTED)
        self.belief = tuple(self._held[key_of(record[name])] for name in chain.belief)
        self.density = self._held[key_of(record[KNOWN[2]])]
        self.squares = {
            sensor.variable: self._held[key_of(record[name])]
            for sensor, name in zip(plan.read, squares_of(plan), strict=True)
            if name in record
        }

    def _head(self, sweep: Sweep, ended: int, fixed: Arena) -> int:
        """The address of a sweep's table."""
        chain, plan, of = self._chain, self._chain.plan, self._of
        numbers = list(sweep.numbers)
        numbers[: told.FIRST] = [0] * told.FIRST
        numbers[told.LAST], numbers[told.RUNS] = plan.steps, of.stride
        numbers[told.ITERATIONS], numbers[told.ENDED] = chain.iterations, ended
        own = {array.place: array for array in arrays(sweep.chain)}
        for place, array in sweep.arrays.items():
            if place in own:
                cells, form = self._placed(array, fixed), own[place]
                if form.near and prod(form.shape) > 1 and cells.cell != 1:
                    raise Left("numbers of a run do not lie beside each other, as they were told")
                address, across, down, cell = cells
                numbers[place : place + told.CELL + 1] = address, down, across, cell
            elif place == told.RESIDUALS:
                numbers[place] = self._residuals
            else:
                numbers[place] = fixed.put(array)
        return fixed.put(np.array(numbers, dtype=np.int64))

    def _placed(self, array: Anything, fixed: Arena) -> Cells:
        """Where an array of the plan lies on the card; one that all runs share is copied."""
        chain, of = self._chain, self._of
        if not has_runs(array, chain.plan.runs):
            return _copied(fixed, array)
        key = key_of(array)
        if key not in self._held:
            kept = not chain.smooths and key in (key_of(chain.record[name]) for name in PREDICTED)
            stride = of.kept if kept else of.stride
            self._held[key] = _cells(self._loose, array.shape[0], array.shape[2:], stride)
        return self._held[key]

    def sweep(self, device: Device, runs: int) -> Mask:
        """Sweep so many runs; whether each has, for certain, the digits that are promised."""
        return self.swept(device, runs)[0]

    def swept(self, device: Device, runs: int) -> tuple[Mask, Mask]:
        """Sweep so many runs: which have their digits, as of `sweep`; and which were ever lost."""
        chain = self._chain
        fine, lost = np.ones(runs, dtype=bool), np.zeros(runs, dtype=bool)
        if chain.iterated:
            self._loose.renew(self._residuals, np.zeros((chain.iterations + 1, self._of.stride)))
        for sweep, head, ended in zip(chain.sweeps, self._heads, self._ended, strict=True):
            if self._composing is not None and isinstance(sweep.chain, told.Backward):
                form, place = self._composing
                kernel = kernels.loaded(composing, COMPOSE, device, form)
                device.launch(kernel, runs, (place, 0, runs), kernels.KINDS)
            device.launch(card.loaded(sweep.chain, device), runs, (head, 0, runs), card.KINDS)
            found = self._loose.get(ended, (sweeps.TOLD, self._of.stride))[:, :runs]
            fine &= found[sweeps.LEFT] == 0.0
            if isinstance(sweep.chain, told.Backward):
                fine &= found[sweeps.KEPT] == 1.0
            else:
                fine &= (found[sweeps.FAR] == 0.0) & (found[sweeps.MOVING] == 0.0)
                fine &= found[sweeps.CLOSEST] * certificate.MODERATE > 1.0
                lost |= found[sweeps.LOST] != 0.0
        return fine, lost

    def unsettled(self, runs: int) -> Mask:
        """Which of so many runs have not settled in their iterations."""
        if not self._chain.iterated:
            return np.zeros(runs, dtype=bool)
        row = self._residuals + NUMBER * self._chain.iterations * self._of.stride
        found: Mask = self._loose.get(row, (runs,)) != 0.0
        return found

    def judge(self, device: Device, few: Few, fine: Mask) -> None:
        """Judge traces at the beliefs of the runs that come home, so far as they are `fine`."""
        chain, of = self._chain, self._of
        plan, size = chain.plan, chain.plan.layout.slice_size
        own, done = ((size,), (size, size)), np.zeros(plan.runs, dtype=bool)
        some = fine[:: of.apart]
        done[: len(some)] = some
        rows = plan.steps + 1
        known = [few.of(device, c, rows, each) for c, each in zip(self.known, own, strict=True)]
        if chain.smooths:
            ahead = [
                few.of(device, c, rows, each) for c, each in zip(self.predicted, own, strict=True)
            ]
        else:
            ahead = [
                _as_read(self._loose.get(c.address, (rows, prod(each), of.kept)), each)
                for c, each in zip(self.predicted, own, strict=True)
            ]
        known, ahead = ([_as_wide(a, plan.runs) for a in each] for each in (known, ahead))
        chain.judge(known, ahead, done)


class Few:
    """One of so many runs of arrays on a card, which come home."""

    def __init__(self, arena: Arena, of: Lying, longest: int) -> None:
        self._arena, self._of = arena, of
        self._room, self._table = arena.floats(longest * of.kept), arena.floats(5)

    def of(self, device: Device, cells: Cells, rows: int, own: tuple[int, ...]) -> Array:
        """An array (rows, kept runs, own axes)."""
        of, count = self._of, rows * prod(own)
        numbers = [cells.address, cells.cell, of.kept, of.apart, self._room]
        self._arena.renew(self._table, np.array(numbers, dtype=np.int64))
        kernel = kernels.loaded(kernels.picking, kernels.PICK, device)
        device.launch(kernel, count, (self._table, 0, count), kernels.KINDS)
        return _as_read(self._arena.get(self._room, (rows, prod(own), of.kept)), own)


def _as_read(cells: Array, own: tuple[int, ...]) -> Array:
    """An array (rows, own axes, runs), flat along its own axes, as (rows, runs, own axes)."""
    found: Array = np.moveaxis(cells, -1, 1).reshape(len(cells), cells.shape[-1], *own)
    return found


def _as_wide(array: Array, runs: int) -> Array:
    """An array of some of so many runs, by runs, with those that are not there as zeros."""
    found = vacant((len(array), runs), array.shape[2:])
    found[...] = 0.0
    count = min(runs, array.shape[1])
    found[:, :count] = array[:, :count]
    return found


def key_of(array: Anything) -> Key:
    """By what an array of a plan is known."""
    return address(array), array.shape, array.strides


def has_runs(array: Anything, runs: int) -> bool:
    """Whether an array (rows, runs or 1, ...) has something else for each of so many runs."""
    return array.shape[1] == runs and array.strides[1] != 0


def _cells(arena: Arena, rows: int, own: tuple[int, ...], stride: int) -> Cells:
    """Room for an array of runs that lie beside each other."""
    count = prod(own)
    return Cells(arena.floats(rows * count * stride), 1, count * stride, stride)


def _copied(arena: Arena, array: Anything) -> Cells:
    """A copy of an array that all runs share, whose cells are next to each other."""
    rows = 1 if array.strides[0] == 0 else array.shape[0]
    own: Anything = np.ascontiguousarray(array[:rows, :1])
    return Cells(arena.put(own), 0, 0 if rows == 1 else own[0].size, 1)
