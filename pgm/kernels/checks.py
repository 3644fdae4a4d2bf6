"""What the public boundary asks of arrays that users give."""

from __future__ import annotations

import numpy as np

from pgm.kernels.arrays import Array, transpose


def covariance_fault(cov: Array) -> str | None:
    """What keeps stacked square matrices from being covariances, in words; None if nothing."""
    if not np.isfinite(cov).all():
        return "has entries that are NaN or infinite"
    scale = np.abs(cov).max(initial=0.0)
    if np.abs(cov - transpose(cov)).max(initial=0.0) > 1e-9 * scale:
        return "is not symmetric"
    smallest = np.linalg.eigvalsh(cov).min(initial=np.inf) if cov.size else 0.0
    if smallest < -1e-10 * scale:
        return f"has the negative eigenvalue {smallest:.3g}"
    return None
