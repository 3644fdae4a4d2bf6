"""What the audit says of beliefs whose KL from the exact posterior is known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

import pgm
from experiments.nonlinear_measurement.cases import Array, Integers

# A belief further than WRONG from exact [nats] should be suspect; one nearer than RIGHT should not.
WRONG, RIGHT = 2.0, 0.2


@dataclass(frozen=True)
class Audited:
    """How an audit's verdicts agree with the KL of the pose after the step.

    Attributes
    ----------
    wrong, right : int
        Simulations with a KL of 2 nats or more, and below 0.2.
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


def audited(found: pgm.Audit, kept: Integers, kl: Array) -> Audited:
    """Compare the verdicts on the simulations that were kept with their KL."""
    suspect, trusted = found.suspect[kept], found.trusted[kept]
    wrong, right = kl >= WRONG, kl < RIGHT
    return Audited(
        wrong=int(wrong.sum()),
        right=int(right.sum()),
        caught=int((wrong & suspect).sum()),
        alarms=int((right & suspect).sum()),
        missed=int((wrong & ~suspect & trusted).sum()),
        trusted=float(np.mean(trusted)),
    )
