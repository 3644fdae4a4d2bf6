"""Covariances from standard deviations."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt


def diagonal(std: Sequence[float]) -> npt.NDArray[np.float64]:
    """The covariance of independent components with these standard deviations."""
    return np.diag(np.square(std))
