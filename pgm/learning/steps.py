"""The M steps of tables, and of parameters of functions."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from pgm.boundary import as_floats
from pgm.cpds import TableCPD
from pgm.errors import ModelError
from pgm.factors.scope import as_value
from pgm.inference.chain.families import FamilyBelief
from pgm.kernels.arrays import Array
from pgm.learning.residuals import Known, residuals
from pgm.learning.values import Parameter, Table
from pgm.variables import Variable

_TINY = 1e-300


class TableStep:
    """The M step of one table, exact: Baum & Welch's, for any family of the slice.

    Zeros stay zeros. Rows of parents' states that never occur stay as they are.
    """

    def __init__(self, cpd: TableCPD, parts: Sequence[Table]) -> None:
        if cpd.function is not None or cpd._maps:
            raise ModelError(
                f"{cpd!r}: its table is structured, or a function of inputs; one that is an array "
                "can be learnt",
                cpd=cpd,
            )
        counts = as_floats(parts[0].prior_counts, f"{cpd!r}: prior_counts", cpd=cpd)
        if counts.shape not in ((), cpd.table.shape):
            raise ModelError(
                f"{cpd!r}: prior_counts has shape {counts.shape}; () or {cpd.table.shape} was due",
                cpd=cpd,
            )
        self.start, self.free = cpd, cpd.table > 0.0
        self.prior = np.where(self.free, counts, 0.0)

    def log_prior(self, cpd: TableCPD) -> float:
        """The logarithm of the Dirichlet prior, but for a constant."""
        logs = np.log(np.maximum(cpd.table, _TINY))
        return float(np.sum(self.prior * np.where(self.free, logs, 0.0)))

    def maximised(self, cpd: TableCPD, counts: Array) -> TableCPD:
        """The table of expected counts, (parents..., child)."""
        counts = np.where(self.free, counts + self.prior, 0.0)
        total = counts.sum(axis=-1, keepdims=True)
        table = np.where(total > 0.0, counts / np.where(total > 0.0, total, 1.0), cpd.table)
        return TableCPD(cpd.child, cpd.given, table=table)

    def vector(self, cpd: TableCPD) -> Array:
        """The coordinates of a table: roots of what is not zero at the start."""
        return np.sqrt(cpd.table)[self.free]

    def gradient(self, cpd: TableCPD, counts: Array) -> Array:
        """The derivatives of the expected log-density by the roots s, of p = s² / Σ s²."""
        counts = np.where(self.free, counts + self.prior, 0.0)
        roots = np.sqrt(cpd.table)
        told = counts / np.where(roots > 0.0, roots, 1.0)
        found: Array = 2.0 * (told - roots * counts.sum(axis=-1, keepdims=True))
        return found[self.free]

    def at(self, vector: Array) -> TableCPD:
        """The table of some coordinates."""
        weights = np.zeros(self.free.shape)
        weights[self.free] = vector**2
        total = weights.sum(axis=-1, keepdims=True)
        table = np.where(total > 0.0, weights / np.where(total > 0.0, total, 1.0), self.start.table)
        return TableCPD(self.start.child, self.start.given, table=table)


_HALVINGS = 20
_ROUNDS = 5
_STEP = 1e-4
# The relative fall of V from which on a step is the last.
_SMALL = 1e-12


class ParameterStep:
    """The M step of a parent with one value at all rows of all recordings.

    The expected log-density is, but for constants, −½ V(θ), V(θ) = Σ tr(Q⁻¹ E[r rᵀ]) of all CPDs
    that have the parent, their residuals expected at each θ. Its gradient is taken by central
    differences, its curvature is Gauss and Newton's; a step that does not lower V is halved. It is
    exact where residuals are linear in θ.
    """

    def __init__(self, variable: Variable, declared: Parameter) -> None:
        self.variable = variable
        size = variable.dimension
        self.start = np.array(as_value(variable, declared.start, "start"))
        if self.start.shape != (size,):
            raise ModelError(
                f"{variable!r}: the start of a parameter has shape {self.start.shape}; ({size},) "
                "was due, one value for all runs",
                variable=variable,
            )
        bounds = []
        for name in ("lower", "upper"):
            bound = as_floats(getattr(declared, name), f"{variable!r}: {name}", variable=variable)
            if bound.shape not in ((), (size,)):
                raise ModelError(
                    f"{variable!r}: {name} has shape {bound.shape}; () or ({size},) was due",
                    variable=variable,
                )
            bounds.append(np.broadcast_to(bound, (size,)))
        self.lower, self.upper = bounds

    def clipped(self, value: Array) -> Array:
        """A value moved within the bounds."""
        return np.clip(value, self.lower, self.upper)

    def maximised(self, beliefs: Sequence[FamilyBelief], known: Known) -> tuple[Array, Array]:
        """The value after a few steps, or until none lowers V; and the gradient at the start."""
        value = known[self.variable]
        here = self._parts(beliefs, known, value)
        weights = [np.linalg.pinv(each.noise, hermitian=True) for each in here]
        cost, first = _cost(here, weights), None
        for _ in range(_ROUNDS):
            gradient, curvature = self._derivatives(beliefs, known, value, weights)
            first = gradient if first is None else first
            outward = np.where(gradient > 0.0, value <= self.lower, value >= self.upper)
            free = ~outward & (gradient != 0.0)
            if not free.any():
                break
            step = np.zeros_like(value)
            step[free] = -np.linalg.lstsq(curvature[np.ix_(free, free)], gradient[free])[0]
            moved, there = self._halved(beliefs, known, value, step, cost, weights)
            if not there < cost:
                break
            small = cost - there < _SMALL * abs(cost)
            value, cost = moved, there
            if small:
                break
        assert first is not None
        return value, -first

    def _halved(
        self,
        beliefs: Sequence[FamilyBelief],
        known: Known,
        value: Array,
        step: Array,
        cost: float,
        weights: list[Array],
    ) -> tuple[Array, float]:
        """The longest of the step's halves, within bounds, that lowers V."""
        there = cost
        for k in range(_HALVINGS):
            moved = self.clipped(value + 0.5**k * step)
            there = _cost(self._parts(beliefs, known, moved), weights)
            if there < cost:
                return moved, there
        return value, there

    def _parts(self, beliefs: Sequence[FamilyBelief], known: Known, value: Array) -> list[Any]:
        return [residuals(each, {**known, self.variable: value}) for each in beliefs]

    def _derivatives(
        self, beliefs: Sequence[FamilyBelief], known: Known, value: Array, weights: list[Array]
    ) -> tuple[Array, Array]:
        """Half the gradient of V, and half its curvature."""
        size = value.size
        steps = _STEP * np.maximum(np.abs(value), 1.0)
        gradient, curvature = np.zeros(size), np.zeros((size, size))
        sides = [
            [self._parts(beliefs, known, value + sign * h * unit) for sign in (1.0, -1.0)]
            for h, unit in zip(steps, np.eye(size), strict=True)
        ]
        for k, (ahead, behind) in enumerate(sides):
            gradient[k] = (_cost(ahead, weights) - _cost(behind, weights)) / (4.0 * steps[k])
        for place, weight in enumerate(weights):
            slopes = []
            for (ahead, behind), h in zip(sides, steps, strict=True):
                a, b = ahead[place], behind[place]
                slopes.append(((a.mean - b.mean) / (2.0 * h), (a.line - b.line) / (2.0 * h)))
            cov = sides[0][0][place].cov
            for k, (mean, line) in enumerate(slopes):
                for m, (other, along) in enumerate(slopes[: k + 1]):
                    both = mean[:, :, None] * other[:, None, :]
                    both = both + line @ cov @ np.swapaxes(along, -1, -2)
                    curvature[k, m] += float(np.sum(weight * both))
                    curvature[m, k] = curvature[k, m]
        return gradient, curvature


def _cost(parts: list[Any], weights: list[Array]) -> float:
    return float(
        sum(np.sum(weight * each.rows()[0]) for each, weight in zip(parts, weights, strict=True))
    )
