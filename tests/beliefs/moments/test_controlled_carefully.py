"""Step control where a model is solved in twice the digits, against the same model in float64."""

import numpy as np
import pytest

import pgm
from pgm.beliefs.moments.digits import certificate

s, z = pgm.Variable("s"), pgm.Variable("z")
HELD = {"iterations": 3, "tolerance": 0, "damping": pgm.LevenbergMarquardt()}
STEPS = 5


def arctan(tolerance=0.01):
    """A sensor on which plain iteration from afar overshoots."""
    return pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(s, 3.0, 4.0)],
        [pgm.LinearGaussianCPD(s, {s.previous: 1.0}, cov=4.0)],
        [pgm.NonlinearGaussianCPD(z, s, np.arctan, cov=tolerance)],
    )


READINGS = {z: np.array([[-0.2], [0.9], [-1.1], [0.3], [-0.8]])}
RULES = pytest.mark.parametrize("rule", [pgm.Taylor(), pgm.Unscented()], ids=repr)


@pytest.fixture
def both(monkeypatch):
    """A question in float64, and in twice the digits."""

    def asked(question):
        ordinary = question()
        with monkeypatch.context() as patch:
            patch.setattr(certificate, "suffices", lambda *_, **__: False)
            careful = question()
        assert ordinary._outcome._careful is None
        assert careful._outcome._careful is not None
        return ordinary, careful

    return asked


@RULES
def test_a_filter(both, rule):
    """The anchor is that of the step."""
    ordinary, careful = both(lambda: pgm.filter(arctan(), READINGS, lineariser=rule, **HELD))
    np.testing.assert_allclose(careful[s].mean, ordinary[s].mean, rtol=0, atol=1e-9)
    np.testing.assert_allclose(careful[s].cov, ordinary[s].cov, rtol=1e-9)
    np.testing.assert_array_equal(careful.status.converged, ordinary.status.converged)


@RULES
def test_joints_have_the_means_that_were_kept(both, rule):
    ordinary, careful = both(lambda: pgm.smooth(arctan(), READINGS, lineariser=rule, **HELD))
    np.testing.assert_allclose(careful[s].mean, ordinary[s].mean, rtol=0, atol=1e-9)
    at = [s.at(step) for step in (4, 0, 3)]
    ours, due = careful.joint(*at), ordinary.joint(*at)
    np.testing.assert_allclose(ours.mean, careful[s].mean[[4, 0, 3], 0], rtol=0, atol=1e-12)
    np.testing.assert_allclose(ours.mean, due.mean, rtol=0, atol=1e-9)
    np.testing.assert_allclose(ours.cov, due.cov, rtol=0, atol=1e-9)
