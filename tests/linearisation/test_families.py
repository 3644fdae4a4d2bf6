"""Parts of a family of CPDs, linearised by themselves."""

import numpy as np
from numpy.testing import assert_array_equal
from robots import LANDMARKS, SENSORS, controls, m, network, u

import pgm


def test_a_part_of_the_runs_is_linearised_by_itself():
    """The audit smooths single runs of a posterior, which goes on with its own linearisations."""
    model, rng = network(SENSORS["range_bearing"].cpd()), np.random.default_rng(0)
    inputs = {u: controls(rng, 5), m: pgm.constant(LANDMARKS[0])}
    evidence = model.sample(inputs, runs=3, rng=rng).evidence
    posterior = pgm.smooth(model, evidence, lineariser=pgm.Cubature(), compiled=False)
    families = [family for family in posterior._outcome._plan.families if family.approximate]
    assert families
    for family in families:
        whole, part = family.noise.copy(), family.of(slice(0, 2))
        steps, size = len(family.step), family.shape[-1]
        mean, cov = np.ones((steps, 2, size)), np.broadcast_to(np.eye(size), (steps, 2, size, size))
        part.linearise(slice(0, steps), mean, cov)
        assert_array_equal(family.noise, whole)
        assert (part.noise != whole[:, :2]).any()
