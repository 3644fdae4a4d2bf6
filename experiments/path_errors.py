"""Errors of filtered and smoothed places, whose beliefs may be mixtures."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

import pgm
from pgm import consistency

PLACE = ("east", "north")


def gaussian(belief: pgm.Gaussian | pgm.GaussianMixture) -> pgm.Gaussian:
    """A belief, or of a mixture the Gaussian of its moments."""
    return belief.gaussian() if isinstance(belief, pgm.GaussianMixture) else belief


def place_error(belief: Any, truth: npt.NDArray[np.float64]) -> float:
    """The root mean square error of places."""
    return float(consistency.rmse(gaussian(belief), truth, components=PLACE))


def errors(filtered: Any, smoothed: Any, truth: npt.NDArray[np.float64]) -> dict[str, float]:
    """Errors of beliefs at all steps: of places, filtered and smoothed, and the smoother's NEES.

    The keys are `filter`, `smoother` and `nees`, which is divided by the number of components.
    """
    return {
        "filter": place_error(filtered, truth),
        "smoother": place_error(smoothed, truth),
        "nees": float(np.mean(consistency.nees(gaussian(smoothed), truth))) / truth.shape[-1],
    }
