"""The lines that sigma points give the regression of `step`, by weighted least squares.

The N points s are sigma points of a standard normal vector of n components, mapped to x = m + L s
by a root L of the covariance of x; the values Y of the function at them are regressed on s by
weighted least squares. The weights of means and of covariances (N,) are those of the rule that the
points belong to.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pgm.kernels import step
from pgm.kernels.arrays import Array, Mask, apply, transpose
from pgm.kernels.dense import Dense, Runs, Stack, StackRoot


def regress(
    root: StackRoot,
    s: Array,
    values: Array,
    mean_weights: Array,
    cov_weights: Array,
    *,
    known: bool = False,
) -> step.Regressed:
    """The regression of values (..., N, d) on points s (..., N, n) of N(0, I), in stacks.

    Components of s have no part where the column of the root L (..., n, n) is zero. The mean and
    covariance of s are those of the sample, or, if `known`, 0 and I; then the error may be
    indefinite.
    """
    line = _line(s, values, mean_weights, cov_weights, root.fixed, known=known)
    left, weights = line.left, cov_weights
    if known:  # of the values' covariance the line's own is taken off
        left = np.concatenate([left, line.slope], axis=-2)
        weights = np.concatenate([weights, np.full(s.shape[-1], -1.0)])
    rest = Stack(transpose(left)), Stack(transpose(weights[:, None] * left))
    return step.regressed(root, Stack.column(line.value), Stack(line.slope), *rest)


def fit(s: Array, mean_weights: Array, cov_weights: Array) -> step.Rule:
    """The regression on fixed points s (N, n), for roots L without a zero column, as `Dense`.

    The mean and covariance of s are those of the sample.
    """
    count, size = s.shape
    line = _line(s, np.eye(count), mean_weights, cov_weights, np.zeros(size, dtype=bool))
    # As many squares as there are points more than a line passes through.
    values, vectors = np.linalg.eigh(transpose(line.left) @ (cov_weights[:, None] * line.left))
    largest = np.argsort(np.abs(values))[size + 1 :]
    rest = (np.sqrt(np.abs(values)) * vectors)[:, largest].T
    signs = np.sign(values[largest])
    return step.Rule(
        Dense(line.value[None]),
        Dense(line.slope),
        Dense(rest),
        None if (signs > 0.0).all() else Dense(np.diag(signs)),
    )


def of_runs(rule: step.Rule) -> step.Rule:
    """The rule of a `fit` for the values of many runs, as `Runs`."""
    return step.Rule(*(None if each is None else Runs(each.array[..., None]) for each in rule))


class RangeRoot(StackRoot):
    """The roots L of singular covariances (..., n, n), some components of which are determined.

    `std` (..., n) are the components' deviations, which tell their units, and `null` is I − L L⁻;
    see `range_inverse`.
    """

    def __init__(self, lower: Array, std: Array) -> None:
        super().__init__(lower)
        self.std = std
        self._inverse, self.null = range_inverse(lower, std)

    def solve_transposed(self, right: Stack) -> Stack:
        """The X with Lᵀ X = B that has no part in directions without variance: L⁻ᵀ B."""
        return Stack(transpose(self._inverse) @ right.array)


def range_inverse(lower: Array, std: Array) -> tuple[Array, Array]:
    """A generalised inverse L⁻ of a root L (..., n, n), and the matrix I − L L⁻, (..., n, n).

    L⁻ is pinv(D⁻¹ L) D⁻¹, so that it does not depend on units. D is the diagonal matrix of the
    standard deviations `std` (..., n) of the components, with one in place of a deviation of zero.
    I − L L⁻ is zero on the range of L: it leaves what lies in directions without variance.
    """
    unit = np.where(std > 0.0, std, 1.0)
    inverse = np.linalg.pinv(lower / unit[..., None], rcond=1e-10) / unit[..., None, :]
    return inverse, np.eye(lower.shape[-1]) - lower @ inverse


class _Line(NamedTuple):
    """A line through values: at s = 0 `value` (..., d), along s `slope` (..., n, d).

    `left` (..., N, d) is what it leaves of the values.
    """

    value: Array
    slope: Array
    left: Array


def _line(
    s: Array,
    values: Array,
    mean_weights: Array,
    cov_weights: Array,
    unused: Mask,
    *,
    known: bool = False,
) -> _Line:
    """The line through values (..., N, d) at points s (..., N, n), but for `unused` components.

    If the moments of s are `known`, 0 and I, what is left is so of a level line.
    """
    value, middle = mean_weights @ values, mean_weights @ s
    off, ds = values - value[..., None, :], s - middle[..., None, :]
    some = unused.any()
    if some:
        ds = np.where(unused[..., None, :], 0.0, ds)
    weighted = transpose(cov_weights[:, None] * ds)
    moment = weighted @ off
    if known:
        return _Line(value, moment, off)
    normal = weighted @ ds
    if some:
        normal = normal + unused[..., None] * np.eye(unused.shape[-1])
    slope = np.asarray(np.linalg.solve(normal, moment), dtype=np.float64)
    return _Line(value - apply(transpose(slope), middle), slope, off - ds @ slope)
