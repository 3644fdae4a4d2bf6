"""Questions to beliefs on grids that have no answer."""

import numpy as np
import pytest
from grid.sighted import grid, m, robot, u, x, z

import pgm
from pgm.errors import EvidenceError, ModelError

MODEL = robot(cov=np.diag([0.1, 0.1, 0.05]))


def test_an_online_belief_is_of_its_own_grid():
    """One of as many cells elsewhere was taken, and read as if it stood there."""
    here, there = (pgm.OnlineFilter(MODEL, belief=grid(shift)) for shift in ((0.0, 0.0), (3.0, 0)))
    seen = {z: pgm.sightings([[3.0, 1.0]], given={m: [[1.0, 1.0]]})}
    with pytest.raises(ModelError, match="belief of this filter's model and grid"):
        there.update(here.initial(), seen)
    with pytest.raises(ModelError, match="belief of this filter's model and grid"):
        there.predict(here.initial(), {u: [0.1, 0.1]})
    again = pgm.OnlineFilter(MODEL, belief=grid())
    assert again.predict(here.initial(), {u: [0.1, 0.1]}).step == 1


def test_names_that_are_none():
    found = pgm.filter(MODEL, {u: [[0.1, 0.0]]}, belief=grid())
    for names in ((["north"],), (3,), (x,)):
        with pytest.raises(ModelError, match="by name"):
            found[x].marginal(*names)
    with pytest.raises(EvidenceError, match="joint takes states"):
        found.joint()


def test_a_step_of_several_runs_is_of_runs():
    place, read = pgm.variables("place read")
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(place, 0.0, 1.0)],
        [pgm.LinearGaussianCPD(place, {place.previous: 1.0}, cov=0.1)],
        [pgm.LinearGaussianCPD(read, {place: 1.0}, cov=0.5)],
    )
    grid = pgm.Grid({"place": (-4, 4, 80)})
    readings = np.array([[[0.1], [0.2], [0.3]], [[-0.4], [0.5], [0.6]]])
    belief = pgm.filter(model, {read: readings}, belief=grid)[place]
    for index, lead, steps in (
        (np.s_[:, 2], (2,), None),
        (np.s_[0:1, 2], (1,), None),
        (np.s_[0], (4,), [0, 1, 2, 3]),
        (np.s_[:, 1:3], (2, 2), [1, 2]),
        (np.s_[0, 1], (), None),
    ):
        found = belief[index]
        assert found.lead == lead
        assert (None if found.steps is None else found.steps.tolist()) == steps
        np.testing.assert_allclose(found.mean, belief.mean[index], rtol=1e-12)
    assert belief[..., 2].steps is None
