"""Weights of the states of a hidden Markov chain by the densities of continuous readings."""

from __future__ import annotations

import math
from functools import cached_property
from typing import Any

import numpy as np

from pgm.beliefs.markov.sensor_weights import SensorWeights
from pgm.cpds import CPD, ConditionalGaussian, MixtureCPD, Noise, SwitchingCPD
from pgm.cpds.base import Known
from pgm.cpds.conditional import evaluate
from pgm.errors import GraphError, ModelError
from pgm.kernels import roots
from pgm.kernels.arrays import Array, Integers
from pgm.kernels.semirings import SUM_PRODUCT, Semiring
from pgm.resources import require_memory

# So many arrays of the densities of all readings there are at a time.
_COPIES = 3


class DensityWeights(SensorWeights):
    """The densities p(z | x) of a continuous sensor's readings, whose CPD the states choose.

    A reading's logarithms have their largest one as log-scale, so that far readings cost no digits.
    A case without noise in some direction is a ModelError where it is asked: between a point mass
    and a density there are no odds that densities tell.
    """

    cpd: SwitchingCPD
    advice = "Leave it out: it is too far from what every state that is possible makes of it"

    @cached_property
    def _logs(self) -> Array:
        """Log-densities of all rows, (rows, *slice, [runs or 1]); zero where nothing was read.

        Each case is asked for the readings alone of which an observed switch may choose it.
        """
        reading, cpd = self.reading, self.cpd
        values = np.where(reading.taken, reading.values, np.nan)
        count = max(each.shape[1] for each in (values, *reading.inputs.values()))
        shape = len(values), count
        require_memory(
            _COPIES * math.prod((*shape, *self.shape)),
            f"the densities of {len(values)} readings of {cpd.child!r} in {count} runs",
            "give fewer runs or steps to a call",
            error=GraphError,
        )

        def wide(rows: Any) -> Any:
            """Rows (rows, runs or 1, d) for all runs."""
            return np.broadcast_to(rows, (*shape, rows.shape[-1]))

        values = wide(values)
        inputs = {v: wide(rows) for v, rows in reading.inputs.items()}
        read = wide(reading.taken).any(axis=-1)
        step = np.broadcast_to(reading.step[:, None], shape)
        found = np.zeros((shape[0], *(v.size for v in self.order), shape[1]))
        for case, part in cpd.cases.items():
            state: dict[Any, int] = dict(zip(cpd.switches, case, strict=True))
            chosen = [inputs[v][..., 0] == k for v, k in state.items() if v in inputs]
            rows = np.nonzero(np.logical_and.reduce([read, *chosen]))
            if not rows[0].size:
                continue
            parents = {v: inputs[v][rows] for v in part.parents}
            known = Known(parents, rows[0].shape, rows[0].shape, step[rows])
            _require_noise(cpd, case, part, known, step[rows])
            place: Any = rows[0], *(state[v] for v in self.order), rows[1]
            found[place] = part._log_density(values[rows], known)
        found = found.reshape(shape[0], *self.shape, shape[1])
        return found if self.batch else found[..., 0]

    @cached_property
    def _tops(self) -> Array:
        """The largest log-density of each row, (rows, [runs or 1]); zero if none is possible."""
        top = self._logs.max(axis=tuple(range(1, 1 + len(self.shape))), initial=-np.inf)
        return np.where(np.isfinite(top), top, 0.0)

    @cached_property
    def _log_scaled(self) -> Array:
        """The log-densities of all rows less the largest one of each row and run."""
        own: Array = self._logs - np.expand_dims(self._tops, tuple(range(1, 1 + len(self.shape))))
        return own

    @cached_property
    def _scaled(self) -> Array:
        """The densities of all rows over the largest one of each row and run."""
        with np.errstate(under="ignore"):
            scaled: Array = np.exp(self._log_scaled)
        return scaled

    def row(self, row: int, semiring: Semiring = SUM_PRODUCT) -> Array:
        """The densities of the reading at a row, (*slice, [runs or 1]), as entries of the semiring.

        They are divided by the largest, whose logarithm `log_scale` gives: beside the logarithm of
        a far reading's density those of a belief would lose their digits.
        """
        found: Array = (self._scaled if semiring.linear else self._log_scaled)[row]
        return found

    def log_scale(self, row: int, semiring: Semiring = SUM_PRODUCT) -> Array | float:
        """The largest log-density of a row, (runs or 1,), or one number without axes of runs."""
        top: Array = self._tops[row]
        return top if self.batch else float(top)

    def picked(self, part: range) -> tuple[Array, Array] | None:
        """The densities of some steps and their log-scales; None with several readings at a step.

        See `SensorWeights.picked`.
        """
        rows = self._rows(part)
        step = self.reading.step[rows.start : rows.stop] - part.start
        if (np.diff(step) < 1).any():
            return None
        own = (self.runs,) if self.batch else ()
        found, scales = np.ones((len(part), *self.shape, *own)), np.zeros((len(part), *own))
        found[step], scales[step] = (
            self._scaled[rows.start : rows.stop],
            self._tops[rows.start : rows.stop],
        )
        return found, scales

    @property
    def smallest(self) -> float:
        """A lower bound, for any step, of the product of its densities over the largest ones."""
        possible = np.isfinite(self._logs)
        least = float(self._scaled.min(where=possible, initial=1.0))
        counts = np.diff(self.starts)
        return float(least ** max(counts.max(initial=0), 0))


def _require_noise(
    cpd: SwitchingCPD, case: tuple[int, ...], part: CPD, known: Known, step: Integers
) -> None:
    """Refuse a case, or part of a mixture, without noise in some direction, by a ModelError."""
    if isinstance(part, MixtureCPD):
        for each in part.parts:
            _require_noise(cpd, case, each, known, step)
    if not isinstance(part, ConditionalGaussian):
        return
    cov = part.cov
    if isinstance(cov, Noise):
        given = {v: known.values[v] for v in cov.given}
        cov = evaluate(part, given, known.shape, step)
    if roots.determined(roots.root(cov)).any():
        raise ModelError(
            f"{cpd!r}: its case {cpd.named(case)!r} has no noise in some direction, and states are "
            "weighed by densities, which a point mass has none of: give it some noise",
            variable=cpd.child,
            cpd=cpd,
        )
