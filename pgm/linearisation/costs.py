"""The cost of a point by one CPD, by which a step control judges its steps.

The cost is −2 ln p of the point and the measurements, but for constants (`LevenbergMarquardt`). A
CPD adds rᵀ Q⁺ r for each of its *rows*: r is the child less the value that its parents' belief lets
expect, and Q the noise covariance as it was linearised. A child has d components.
"""

from __future__ import annotations

import numpy as np

from pgm.errors import NumericalError
from pgm.kernels.arrays import Array, components_last
from pgm.kernels.dense import Stack
from pgm.kernels.step import innovation
from pgm.linearisation.family import Family
from pgm.linearisers.lineariser import by_values


def expected(family: Family, rows: slice, mean: Array, cov: Array) -> Array:
    """E[f(X)] of a CPD at some rows, for its parents X ~ N(mean, cov), by its lineariser.

    `mean` is (rows, runs, n), `cov` (rows, runs, n, n), n being the parents' number of components;
    the result is (rows, runs, d), NaN where f is not defined.
    """
    if family.exact:
        return family.value(rows, mean)
    if family.plate and not by_values(family.lineariser):
        every = zip(range(family.step.size)[rows], mean[:, None], cov[:, None], strict=True)
        each = [expected(family.alone(row), slice(None), *at) for row, *at in every]
        return np.concatenate(each)
    function = family.bound(rows, mean.ndim - 1, mean.shape[:-1])
    return components_last(family.checked(function, mean, cov, finite=False).value, 1)


def weighted(family: Family, residual: Array, cov: Array) -> Array:
    """The sum of rᵀ C⁺ r over k residuals r of a CPD, with their covariances C, (runs,).

    `residual` has the r, (k, runs, d), `cov` the C, (k, runs, d, d). Components of infinite
    variance do not count, nor do those that the components before them determine, where C is
    singular. A C that is indefinite or not finite is refused with a NumericalError that names the
    CPD.
    """
    total = squares(residual, cov)
    if total is None:
        cpd = family.cpd
        if family.plate:
            rows = zip(family.plate, residual[:, None], cov[:, None], strict=True)
            cpd = next((c for c, *at in rows if squares(*at) is None), cpd)
        raise NumericalError(
            f"{cpd!r}: with {family.lineariser!r} its noise is indefinite, so that a step has no "
            "cost; use a rule with positive weights, or damping=0.5",
            variable=cpd.child,
            cpd=cpd,
        )
    return total


def squares(residual: Array, cov: Array) -> Array | None:
    """The sum of rᵀ C⁺ r over k residuals r with their covariances C, (runs,).

    `residual` has the r, (k, runs, d), `cov` the C, (k, runs, d, d). Components of infinite
    variance do not count, nor do those that the components before them determine. The result is
    None if any C is indefinite or not finite, apart from its infinite variances.
    """
    flat = np.isinf(np.einsum("...ii->...i", cov))
    if flat.any():
        residual = np.where(flat, 0.0, residual)
        cov = np.where(flat[..., None] | flat[..., None, :], np.eye(flat.shape[-1]), cov)
    found = innovation(Stack.column(residual), Stack(cov, True))
    if np.isnan(found.share).any():
        return None
    total: Array = found.square.sum(axis=0)
    return total
