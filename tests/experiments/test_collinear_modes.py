"""Ranges to two collinear beacons after one wide step: modes and pieces against exact moments."""

import numpy as np
import pytest

import pgm
from experiments.nonlinear_measurement import cases, truth
from models.networks import pose


@pytest.fixture(scope="module")
def case():
    drawn = cases.simulate(cases.SENSORS["collinear"], 0.6, 60, 0)
    return drawn, truth.posterior(drawn, 13, 500, 0)


def divergences(case, posterior):
    """KL of the Gaussian of the exact moments from that of the answer's, by simulation."""
    _, exact = case
    belief = posterior[pose.at(1)].gaussian()
    inverse = np.linalg.inv(belief.cov)
    off = belief.mean - exact.mean
    found = np.einsum("rij,rji->r", inverse, exact.cov) - pose.dimension
    found += np.einsum("ri,rij,rj->r", off, inverse, off)
    return 0.5 * (found + np.linalg.slogdet(belief.cov)[1] - np.linalg.slogdet(exact.cov)[1])


# Of a few simulations no start settles in 50 linearisations; draws put that right.
@pytest.mark.filterwarnings("ignore:starts=16:pgm.ConvergenceWarning")
def test_modes_that_draws_adapt(case):
    drawn, exact = case
    belief = pgm.Gaussians(4, starts=16, draws=4000)
    found = pgm.smooth(drawn.model, drawn.evidence, belief=belief)
    assert divergences(case, found).mean() < 0.02
    assert np.abs(found.log_evidence - exact.log_evidence).mean() < 0.05
    plain = pgm.smooth(drawn.model, drawn.evidence, belief=pgm.Gaussians(4, starts=16))
    assert divergences(case, plain).mean() > 5.0 * divergences(case, found).mean()


def test_a_filter_of_pieces(case):
    drawn, _ = case
    found = pgm.filter(drawn.model, drawn.evidence, belief=pgm.Gaussians(16, starts=256))
    assert divergences(case, found).mean() < 0.03
