"""The audit's verdicts on results whose distance from the exact posterior is known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

import pgm
from experiments.nonlinear_measurement.cases import Array, Integers
from experiments.nonlinear_measurement.truth import Truth
from models.networks import pose

# A result further than WRONG from exact [nats] should be suspect; one nearer than RIGHT should not.
WRONG, RIGHT = 2.0, 0.2


@dataclass(frozen=True)
class Audited:
    """How an audit's verdicts agree with the distance from exact; see `distance`.

    Attributes
    ----------
    wrong, right : int
        Simulations that are 2 nats or more off, and less than 0.2.
    caught, alarms : int
        How many of these are suspect.
    missed : int
        Wrong ones that are neither suspect nor told to be beyond the audit's trust.
    trusted : float
        The part of all simulations whose audit can be trusted.
    """

    wrong: int
    right: int
    caught: int
    alarms: int
    missed: int
    trusted: float


def distance(posterior: pgm.results.Posterior, truth: Truth) -> Array:
    """How far a result is from exact, (runs,) [nats], in what an audit judges.

    KL(exact moments ‖ belief) of the pose after the step, of a smoother that of both poses
    together, or how far the log-evidence is off, whichever is larger.
    """
    before, after = pose.at(0), pose.at(1)
    if posterior.kind != pgm.Kind(0):  # of a smoother
        exact = pgm.Gaussian((before, after), truth.poses_mean, truth.poses_cov)
        kl = exact.kl(posterior.joint(before, after))
    else:
        kl = pgm.Gaussian(after, truth.mean, truth.cov).kl(posterior[after])
    return np.maximum(kl, np.abs(posterior.log_evidence - truth.log_evidence))


def audited(found: pgm.results.Audit, kept: Integers, off: Array) -> Audited:
    """Compare the verdicts on the simulations that were kept with their distance from exact."""
    suspect, trusted, off = found.suspect[kept], found.trusted[kept], off[kept]
    wrong, right = off >= WRONG, off < RIGHT
    return Audited(
        wrong=int(wrong.sum()),
        right=int(right.sum()),
        caught=int((wrong & suspect).sum()),
        alarms=int((right & suspect).sum()),
        missed=int((wrong & ~suspect & trusted).sum()),
        trusted=float(np.mean(trusted)),
    )
