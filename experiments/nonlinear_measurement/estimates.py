"""What `pgm.estimate` makes of the same readings, and whether what it vouches for is right."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

import pgm
from experiments.nonlinear_measurement.cases import Case, Integers
from experiments.nonlinear_measurement.truth import Truth
from models.networks import pose


@dataclass(frozen=True)
class Estimated:
    """Estimates of the pose after the step, beside the exact posterior's moments.

    Attributes
    ----------
    kl, kl_se : float
        KL(exact moments ‖ the estimate's), mean over simulations and its standard error [nats].
    vouched : float
        The part of simulations that are vouched for.
    within : float
        The median of the bounds on their divergence [nats]; 0 where none is.
    beyond : float
        The part of these whose KL is above the bound.
    draws : float
        Mean number of draws.
    """

    kl: float
    kl_se: float
    vouched: float
    within: float
    beyond: float
    draws: float


def estimated(case: Case, truth: Truth, kept: Integers, seed: int) -> Estimated:
    """Estimate all simulations of a case, and judge those whose truth is known well enough."""
    found = pgm.estimate(case.model, case.evidence, steps=1, rng=seed)
    before, after, verdict = found[pose.at(0)], found[pose.at(1)], found.verdict
    assert verdict is not None
    exact = pgm.Gaussian(pose.at(1), truth.mean[kept], truth.cov[kept])
    kl = exact.kl(_unturned(before, after, kept))
    sure, within = verdict.vouched[kept], verdict.within[kept]
    some = bool(sure.any())
    return Estimated(
        kl=float(kl.mean()),
        kl_se=float(kl.std(ddof=1) / np.sqrt(len(kl))),
        vouched=float(sure.mean()),
        within=float(np.median(within[sure])) if some else 0.0,
        beyond=float((kl > within)[sure].mean()) if some else 0.0,
        draws=float(verdict.draws[kept].mean()),
    )


def _unturned(
    before: pgm.GaussianMixture, after: pgm.GaussianMixture, kept: Integers
) -> pgm.Gaussian:
    """The moments of the poses after the step, headings not wrapped, as the truth's are not.

    A mode's headings are known but for whole turns, which are those of both poses: the first
    heading is put within half a turn of the prior's mean, zero.
    """
    mean, weights = after.components.mean[kept].copy(), after.weights[kept, :, None]
    mean[..., 2] -= 2.0 * np.pi * np.round(before.components.mean[kept, :, 2] / (2.0 * np.pi))
    centre = (weights * mean).sum(axis=1)
    off = mean - centre[:, None]
    spread = after.components.cov[kept] + off[..., :, None] * off[..., None, :]
    return pgm.Gaussian(after.scope[0], centre, (weights[..., None] * spread).sum(axis=1))
