"""Weights of the states of a hidden Markov chain by the densities of continuous readings."""

from __future__ import annotations

import math
from functools import cached_property
from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from pgm.beliefs.markov.sensor_weights import SensorWeights
from pgm.cpds import CPD, ConditionalGaussian, MixtureCPD, Noise, SwitchingCPD
from pgm.cpds.base import Known
from pgm.cpds.conditional import evaluate
from pgm.errors import ModelError
from pgm.evidence import Reading
from pgm.factors.axes import sizes
from pgm.kernels import roots
from pgm.kernels.arrays import Array
from pgm.kernels.semirings import SUM_PRODUCT, Semiring
from pgm.variables import Discrete

if TYPE_CHECKING:
    from pgm.beliefs.markov.plan import SlicePlan


class DensityWeights(SensorWeights):
    """The densities p(z | x) of a continuous sensor's readings, whose CPD the states choose.

    A reading's logarithms have their largest one as log-scale, so that far readings cost no states.
    A case without noise in some direction is a ModelError: between a point mass and a density there
    are no odds that densities tell.
    """

    cpd: SwitchingCPD

    def __init__(self, plan: SlicePlan, reading: Reading, runs: int, batch: bool) -> None:
        super().__init__(plan, reading, runs, batch)
        for case, part in self.cpd.cases.items():
            _require_noise(self.cpd, case, part, reading)

    @cached_property
    def _logs(self) -> Array:
        """Log-densities of all rows, (rows, *slice, [runs or 1]); zero where nothing was read."""
        reading = self.reading
        taken = np.broadcast_to(
            reading.taken, np.broadcast_shapes(reading.taken.shape, reading.values.shape)
        )
        values = np.where(taken, reading.values, np.nan)
        runs = max(values.shape[1], *(a.shape[1] for a in reading.inputs.values()), 1)
        shape = len(values), runs
        values = np.broadcast_to(values, (*shape, values.shape[-1]))
        nothing = ~np.broadcast_to(taken.any(axis=-1), shape)
        inputs = {v: a[..., 0] if isinstance(v, Discrete) else a for v, a in reading.inputs.items()}
        hidden = tuple(v for v in self.order if isinstance(v, Discrete))
        found = np.empty((*sizes(hidden), *shape))
        if found.size:
            step = reading.step[:, None]
            for states in product(*map(range, sizes(hidden))):
                chosen = {v: np.full((1, 1), k) for v, k in zip(hidden, states, strict=True)}
                known = Known(inputs | chosen, shape, shape, step)
                own = self.cpd._log_density(values, known)
                found[states] = np.where(nothing, 0.0, own)
        found = np.moveaxis(found, -2, 0)  # (rows, hidden parents, runs)
        found = found.reshape(len(values), *self.shape, runs)
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


def _require_noise(cpd: SwitchingCPD, case: tuple[int, ...], part: CPD, reading: Reading) -> None:
    """Refuse a case, or part of a mixture, without noise in some direction, by a ModelError."""
    if isinstance(part, MixtureCPD):
        for each in part.parts:
            _require_noise(cpd, case, each, reading)
    if not isinstance(part, ConditionalGaussian):
        return
    cov = part.cov
    if isinstance(cov, Noise):
        rows = {v: reading.inputs[v] for v in cov.given}
        shape = np.broadcast_shapes(*(a.shape[:-1] for a in rows.values()))
        if not math.prod(shape):
            return
        known = {v: np.broadcast_to(a, (*shape, a.shape[-1])) for v, a in rows.items()}
        cov = evaluate(part, known, shape, reading.step[:, None])
    if roots.determined(roots.root(cov)).any():
        raise ModelError(
            f"{cpd!r}: its case {cpd.named(case)!r} has no noise in some direction, and states are "
            "weighed by densities, which a point mass has none of: give it some noise",
            variable=cpd.child,
            cpd=cpd,
        )
