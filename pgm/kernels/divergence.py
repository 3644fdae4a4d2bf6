"""The divergence of a Gaussian from another one."""

from __future__ import annotations

import numpy as np

from pgm.kernels import roots, solving
from pgm.kernels.arrays import Array, symmetric, transpose


def from_gaussian(lower: Array, offset: Array, cov: Array) -> Array:
    """The divergence KL(N(m, C) ‖ N(0, L Lᵀ)) in nats, (...).

    m is `offset` (..., n), C `cov` (..., n, n), and L the lower triangular root `lower`
    (..., n, n). With the eigenvalues a of L⁻¹ C L⁻ᵀ the divergence is

        ½ (Σ (a − 1 − ln a) + |L⁻¹ m|²).

    It is infinite where C is not positive definite. Components that are functions of others under
    L, where its diagonal is zero, are not compared.
    """
    fixed = roots.determined(lower)
    white = solving.whiten(lower, offset)
    inner = solving.solve_lower(lower, transpose(solving.solve_lower(lower, cov)))
    alone = fixed[..., :, None] | fixed[..., None, :]
    inner = np.where(alone, fixed[..., None] * np.eye(fixed.shape[-1]), symmetric(inner))
    values = np.linalg.eigvalsh(inner)
    proper = (values > 0.0).all(axis=-1)
    logs = np.log(np.where(values > 0.0, values, 1.0))
    total = (values - 1.0 - logs).sum(axis=-1) + (white * white).sum(axis=-1)
    return np.where(proper, 0.5 * total, np.inf)
