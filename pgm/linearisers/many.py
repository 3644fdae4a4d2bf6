"""The library's linearisers at the beliefs of many runs, on arrays whose last axis is the runs.

A sweep of many runs spends much of its time on what surrounds the arithmetic, so everything that
does not change from step to step is prepared once here. What is out of the ordinary is left to the
general linearisers: the result is then None.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, TypeGuard

import numpy as np

from pgm.kernels import along_runs
from pgm.kernels.arrays import Array
from pgm.linearisers.function import FunctionTemplate, Lineariser
from pgm.linearisers.regression import FEW, StatisticalRegression
from pgm.linearisers.taylor import Taylor

# Values (rows, runs or 1, d) of the parents with evidence, None of hidden ones.
Known = list[Array | None]
# F (d, n, runs), the value F μ + b (d, runs), and the covariance (d, d, runs) of the error or None.
Linearised = tuple[Array, Array, Array | None]
_FLOAT = np.dtype(np.float64)


def prepare(
    template: FunctionTemplate, lineariser: Lineariser, known: Known, runs: int
) -> ManyLineariser | None:
    """A lineariser for many runs; None where there is none but the general one."""
    if type(lineariser) is Taylor and not template.numerical:
        return _Taylor(template, known, runs)
    if (
        isinstance(lineariser, StatisticalRegression)
        and type(lineariser).affine is StatisticalRegression.affine
        and not (lineariser.fresh_per_run or lineariser.prior_moments)
    ):
        return _Regression(template, known, runs, lineariser)
    return None


class ManyLineariser(ABC):
    """A function and how it is linearised, prepared for many runs at a time."""

    def __init__(self, template: FunctionTemplate, known: Known, runs: int) -> None:
        self.template, self.function = template, template.function
        self.height, self.size = template.child.dimension, template.size
        self.parents = [
            (place, None if values is None else _wide(values, runs))
            for place, values in zip(template.places, known, strict=True)
        ]

    @abstractmethod
    def __call__(self, row: int, step: int, mean: Array, cov: Array) -> Linearised | None:
        """Linearise a row at beliefs (n, runs) and (n, n, runs)."""

    def _arguments(self, x: Array, row: int) -> list[Array]:
        """What the function is called with at points (runs, ..., n): (runs, ..., d) each."""
        arguments = []
        for place, wide in self.parents:
            if wide is None:
                arguments.append(x[..., place])
            elif x.ndim == 2:
                arguments.append(wide[row])
            else:
                values = wide[row]
                shape = (*x.shape[:-1], values.shape[-1])
                arguments.append(np.broadcast_to(values[:, None], shape))
        return arguments


class _Taylor(ManyLineariser):
    """`Taylor` with the user's own derivatives."""

    def __call__(self, row: int, step: int, mean: Array, cov: Array) -> Linearised | None:
        arguments = self._arguments(mean.T, row)
        value = self.function(*arguments)
        runs = mean.shape[1]
        if not _is(value, (runs, self.height)):
            return None
        parts = []
        for place, derivative in zip(self.template.places, self.template.jacobians, strict=True):
            if place is not None and derivative is not None:
                part = derivative(*arguments)
                if not isinstance(part, np.ndarray) or part.ndim != 3:
                    return None
                parts.append(part)
        slope = parts[0] if len(parts) == 1 else np.concatenate(parts, axis=-1)
        if not _is(slope, (runs, self.height, self.size)):
            return None
        return slope.transpose(1, 2, 0), value.T, None


class _Regression(ManyLineariser):
    """A sigma-point rule whose points all runs share."""

    def __init__(
        self, template: FunctionTemplate, known: Known, runs: int, rule: StatisticalRegression
    ) -> None:
        super().__init__(template, known, runs)
        self.rule, self.name = rule, template.child.name
        self.angles = np.flatnonzero(template.angles).tolist()

    def __call__(self, row: int, step: int, mean: Array, cov: Array) -> Linearised | None:
        points = self.rule.points(self.size, self.name, step)
        s = points.points
        if s.ndim != 2 or len(s) > FEW:
            return None
        lower = along_runs.root(cov)
        if lower is None:
            return None
        # Values are compared with the one at the centre, which not every rule has.
        first = int(bool(self.angles) and not points.centred)
        called = np.concatenate([np.zeros((1, self.size)), s]) if first else s
        x = np.matmul(called, lower)
        x += mean[:, None]
        value = self.function(*self._arguments(x.T, row))
        if not _is(value, (x.shape[2], x.shape[1], self.height)):
            return None
        values = value.T
        reference = values[:, 0]
        raw = values[:, first:] - reference[:, None]
        if any(np.abs(raw[k]).max() > np.pi for k in self.angles):
            return None
        fit = points.line
        centre_and_slope = fit.moments @ raw
        left, signed = fit.left @ raw, fit.signed @ raw
        error: Array = np.einsum("ikr,jkr->ijr", signed, left)
        slope = along_runs.divide(centre_and_slope[:, 1:], lower)
        return slope, reference + centre_and_slope[:, 0], error


def _wide(values: Array, runs: int) -> Array:
    """Values (rows, runs or 1, d) for each run, read-only, since functions of users see them."""
    rows, _, size = values.shape
    return np.broadcast_to(values, (rows, runs, size))


def _is(value: Any, shape: tuple[int, ...]) -> TypeGuard[Array]:
    return type(value) is np.ndarray and value.dtype is _FLOAT and value.shape == shape
