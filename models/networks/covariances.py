"""Covariances from standard deviations."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt


def diagonal(std: Sequence[float]) -> npt.NDArray[np.float64]:
    """The covariance of independent components with these standard deviations.

    Raises
    ------
    ValueError
        Where one of them is not a finite number, 0 or more.
    """
    return np.diag(variances(std))


def variances(std: npt.ArrayLike) -> npt.NDArray[np.float64]:
    """The squares of standard deviations, which must be finite and not negative."""
    values = np.asarray(std, dtype=float)
    if not (np.isfinite(values) & (values >= 0.0)).all():
        raise ValueError(f"standard deviations: found {std!r}; give finite numbers, 0 or more")
    return np.asarray(values**2)
