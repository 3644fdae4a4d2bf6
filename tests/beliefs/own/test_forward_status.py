"""A smoother of a user's own family has the status of its forward pass, too."""

import warnings

import numpy as np
import pytest
from numpy.testing import assert_allclose

import pgm
from pgm.examples import walk, x, z
from tests.beliefs.own.kalman import Kalman

READINGS = {z: [[4.0], [3.0], [np.nan], [5.0]]}


class Told(Kalman):
    """Its figure is the variance."""

    def __init__(self, limit=np.inf):
        self.limit = limit

    @property
    def warns(self):
        return {"variance": pgm.Threshold(self.limit)}

    def numbers(self, belief):
        return {"variance": belief[1][:, 0, 0]}


@pytest.mark.parametrize("lag", [None, 1])
def test_each_pass_has_its_figures(lag):
    posterior = pgm.smooth(walk, READINGS, lag=lag, belief=Told())
    assert_allclose(posterior.status.variance, posterior[x].cov[:, 0, 0], rtol=1e-12)
    forward = posterior.filtered
    assert_allclose(forward.status.variance, forward[x].cov[:, 0, 0], rtol=1e-12)
    assert forward.kind == pgm.Kind(0)
    assert (posterior.status.variance < forward.status.variance).any()
    assert forward.filtered is forward


def warned(call, limit):
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        call(walk, READINGS, belief=Told(limit))
    return [str(each.message) for each in found]


def test_the_forward_pass_warns_and_nothing_is_told_twice():
    """Variances are at most 2 forward, and 1.2 back."""
    for limit in (1.5, 1.1):
        (told,) = warned(pgm.smooth, limit)
        assert "in the forward pass (posterior.filtered): variance is 2 at its worst" in told
        (told,) = warned(pgm.filter, limit)
        assert "forward" not in told
    assert warned(pgm.smooth, 2.5) == []


def test_a_smoother_warns_of_what_its_forward_pass_has_not():
    class Counted(Told):
        def numbers(self, belief):
            return {"variance": -belief[1][:, 0, 0]}

    with pytest.warns(pgm.BeliefWarning, match=r"limit=-0.69\): variance is -0.675 at"):
        pgm.smooth(walk, READINGS, belief=Counted(-0.69))


def test_predicted_marginals_are_marginals_alone():
    found = pgm.smooth(walk, READINGS, belief=Kalman()).predicted
    due = pgm.smooth(walk, READINGS).predicted
    assert_allclose(found[x].mean, due[x].mean, rtol=1e-12)
    assert str(found.kind) == "predicted"
    assert repr(found).startswith("Marginals(predicted, Kalman(), steps 0..4)\n  step ")
    assert not hasattr(found, "status")
    with pytest.raises(TypeError):
        len(found)
    with pytest.raises(pgm.errors.ArrayError, match="an OwnMarginals is no array"):
        np.asarray(found)
