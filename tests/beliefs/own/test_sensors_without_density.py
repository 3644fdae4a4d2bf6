"""Sensors without a density are refused where a family asks for one, and not before."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

import pgm
from tests.beliefs.own.ensemble import EnsembleKalman

x, z = pgm.variables("x z")


def model(cov=1.0, noise=None):
    return pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(x, 0.0, 1.0)],
        [pgm.LinearGaussianCPD(x, {x.previous: 1.0}, cov=1.0)],
        [pgm.LinearGaussianCPD(z, {x: 2.0}, cov=cov, noise=noise)],
    )


class Asking(EnsembleKalman):
    """It asks a question of its measurement."""

    def __init__(self, question):
        super().__init__(50)
        self.question = question

    def take(self, at, belief):
        (seen,) = at.measurements
        self.answer = self.question(seen, belief)
        return belief, 0.0


def asked(network, question):
    family = Asking(question)
    pgm.filter(network, {z: [[3.0]]}, belief=family)
    return family.answer


def test_an_exact_sensor_serves_an_ensemble():
    found = pgm.filter(model(0.0), {z: [[3.0]]}, belief=EnsembleKalman(4000))
    due = pgm.filter(model(0.0), {z: [[3.0]]})
    assert_allclose(found[x].mean, due[x].mean, atol=0.03)
    assert_allclose(found[x].cov[1], 0.0, atol=1e-12)
    assert_allclose(found.log_evidence, due.log_evidence, atol=0.05)
    robot = pgm.OnlineFilter(model(0.0), belief=EnsembleKalman(4000))
    belief = robot.update(robot.predict(robot.initial()), {z: [3.0]})
    assert_allclose(belief[x].mean, [1.5], atol=1e-9)


def test_its_density_is_refused():
    words = "no particle need agree with its measurement"
    with pytest.raises(pgm.ModelError, match=words):
        asked(model(0.0), lambda seen, points: seen.log_likelihood(points))
    with pytest.raises(pgm.ModelError, match=words):
        pgm.filter(model(0.0), {z: [[3.0]]}, belief=pgm.Particles(50, seed=0))


IMPROPER = model(noise=pgm.TruncatedLeastSquares(3.0))


def test_a_noise_without_density_has_a_centre_alone():
    centre = asked(IMPROPER, lambda seen, points: seen.mean(points) - 2.0 * points)
    assert_allclose(centre, 0.0, atol=1e-12)
    for question in (
        lambda seen, points: seen.log_likelihood(points),
        lambda seen, points: seen.log_density(points, points),
        lambda seen, points: seen.draw(points, [np.random.default_rng(0)]),
    ):
        with pytest.raises(pgm.ModelError, match="improper"):
            asked(IMPROPER, question)
    with pytest.raises(pgm.ModelError, match=r"has robust noise.*whose covariance is another"):
        asked(IMPROPER, lambda seen, points: seen.cov)


def test_a_robust_noise_with_a_density_has_it():
    robust = model(4.0, pgm.StudentT(3.0))
    found = asked(robust, lambda seen, points: (points, seen.log_likelihood(points)))
    due = robust.observation[0].log_density([3.0], {x: found[0][0]})
    assert_allclose(found[1][0], due, rtol=1e-12)
