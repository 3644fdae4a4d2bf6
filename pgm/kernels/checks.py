"""What the public boundary asks of arrays that users give."""

from __future__ import annotations

import numpy as np

from pgm.kernels.arrays import Array, transpose


def covariance_fault(cov: Array) -> str | None:
    """What keeps stacked square matrices from being covariances, in words; None if nothing."""
    if not np.isfinite(cov).all():
        return "has entries that are NaN or infinite"
    variances = np.diagonal(cov, axis1=-2, axis2=-1)
    if (variances < 0.0).any():
        return f"has the negative variance {variances.min():.3g}"
    # Components have units of their own: each is judged in its own standard deviation.
    std = np.sqrt(np.where(variances > 0.0, variances, 1.0))
    scaled = cov / (std[..., None] * std[..., None, :])
    if np.abs(scaled - transpose(scaled)).max(initial=0.0) > 1e-9:
        return "is not symmetric"
    smallest = np.linalg.eigvalsh(scaled).min(initial=0.0)
    if smallest < -1e-10:
        return (
            f"is indefinite: scaled to unit variances it has the negative eigenvalue {smallest:.3g}"
        )
    return None
