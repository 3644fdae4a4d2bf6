"""Scores of a rule's beliefs, over many simulations."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

import pgm
from experiments.nonlinear_measurement.cases import Array
from pgm import consistency


@dataclass(frozen=True)
class Score:
    """Of one rule in one case.

    Attributes
    ----------
    kl, kl_se, kl_median : float
        KL(exact moments ‖ approximation) over the pose: mean, its standard error, median [nats].
    nees, nees_se : float
        Mean normalised estimation error squared, 3 for a right belief, and its standard error.
    rmse, rmse_heading : float
        Of the position [m] and of the heading [rad].
    """

    kl: float
    kl_se: float
    kl_median: float
    nees: float
    nees_se: float
    rmse: float
    rmse_heading: float


def score(belief: pgm.Gaussian, kl: Array, truth: Array) -> Score:
    """The score of beliefs, whose KL are given, against the drawn poses."""
    nees = consistency.nees(belief, truth)
    return Score(
        kl=float(kl.mean()),
        kl_se=_error_of_mean(kl),
        kl_median=float(np.median(kl)),
        nees=float(nees.mean()),
        nees_se=_error_of_mean(nees),
        rmse=consistency.rmse(belief, truth, ("east", "north")),
        rmse_heading=consistency.rmse(belief, truth, ("heading",)),
    )


def _error_of_mean(values: Array) -> float:
    return float(values.std(ddof=1) / np.sqrt(values.size))
