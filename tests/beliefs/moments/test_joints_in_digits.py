"""Joints of steps where twice the digits were needed: in work that does not grow with the chain."""

import numpy as np
import pytest
from crossed import crossed
from precise import Reference

import pgm
from pgm.beliefs.moments.digits.adjoint_belief import Later

x = pgm.Variable("x", components=("now", "before"))
y, z = pgm.variables("y z")
STEPS = 30


def moving_average(cov=1.0, sensor=0.0):
    """z = e[t] + .2 e[t − 1], read exactly."""
    return pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(x, [0.0, 0.0], np.eye(2) if np.isfinite(cov) else cov)],
        [pgm.LinearGaussianCPD(x, {x.previous: [[0.0, 0.0], [1.0, 0.0]]}, cov=np.diag([1.0, 0.0]))],
        [pgm.LinearGaussianCPD(z, {x: [[1.0, 0.2]]}, cov=sensor)],
    )


def unstable(cov):
    """A wide prior that grows on the way to the only reading: beliefs come from the next ones."""
    return pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(y, 0.0, cov)],
        [pgm.LinearGaussianCPD(y, {y.previous: 1.5}, cov=1e-4)],
        [pgm.LinearGaussianCPD(z, {y: 1.0}, cov=0.01)],
    )


def readings(steps=STEPS):
    return np.random.default_rng(0).normal(size=(steps, 1))


def steps_taken(monkeypatch):
    """A list that grows by one at each step of a backward pass."""
    taken, plain = [], Later.before

    def before(self, components):
        taken.append(components)
        return plain(self, components)

    monkeypatch.setattr(Later, "before", before)
    return taken


@pytest.mark.parametrize("cov", [1.0, np.inf])
def test_neighbours_of_a_long_chain_take_no_sweep(monkeypatch, cov):
    found = pgm.smooth(moving_average(cov), {z: readings(60)})
    taken = steps_taken(monkeypatch)
    for k in range(20):
        found.joint(x.at(k), x.at(k + 1))
    assert len(taken) <= 61  # one sweep, for all of them
    behind = pgm.filter(moving_average(cov), {z: readings(60)})
    taken.clear()
    behind.joint(x.at(40), x.at(41))
    assert len(taken) == 2


CASES = {
    "exact readings": (moving_average(), x, list(range(1, STEPS + 1))),
    "flat, and all known": (moving_average(np.inf), x, list(range(1, STEPS + 1))),
    "back from the next": (unstable(1e8), y, [STEPS]),
}


@crossed(("infer", "name"), [pgm.smooth, pgm.filter], list(CASES))
def test_joints_near_and_far_are_those_of_300_digits(name, infer):
    model, v, seen = CASES[name]
    rows = readings()[[k - 1 for k in seen]]
    found = infer(model, {z: pgm.sightings(rows, step=seen)}, steps=STEPS)
    assert found.status.digits > 6
    wide = model
    if "flat" in name:  # of which 10⁶⁰ is not told apart from its limit
        wide = model.replace(prior=[pgm.GaussianCPD(x, [0.0, 0.0], np.eye(2) * 1e60)])
    for steps in ([0, 1], [0, STEPS], [14, 15], [STEPS - 1, STEPS], [3, 9, 10, 25], [12, 4]):
        known = [k for k in seen if infer is pgm.smooth or k <= max(steps)]
        last = STEPS if infer is pgm.smooth else max(steps)
        due = Reference(wide, last, {}, [(z, k, readings()[k - 1], {}) for k in known])
        mean, cov = due.joint(*(v.at(k) for k in steps))
        joint = found.joint(*(v.at(k) for k in steps))
        lost = np.diagonal(cov) > 1e50
        np.testing.assert_array_equal(np.isinf(np.diagonal(joint.cov)), lost)
        std = np.sqrt(np.maximum(np.diagonal(cov), 0.0))[~lost]
        edge = np.where(std > 0.0, std, 1.0)
        assert (np.abs(joint.mean - mean)[~lost] <= 1e-9 * edge).all()
        off = np.abs(joint.cov - cov)[~lost][:, ~lost]
        assert (off <= 1e-9 * edge[:, None] * edge).all()


def test_each_run_of_a_batch_has_its_own():
    """Some runs read at the end alone, and are found back from the next beliefs."""
    values = np.stack([np.full((STEPS, 1), np.nan), np.ones((STEPS, 1))])
    values[0, -1] = 1.0
    many = pgm.smooth(unstable(1e8), {z: values})
    for run in range(2):
        one = pgm.smooth(unstable(1e8), {z: values[run]})
        for steps in ([0, STEPS], [7, 8], [2, 20]):
            joint, due = (each.joint(*(y.at(k) for k in steps)) for each in (many, one))
            np.testing.assert_allclose(joint.cov[run], due.cov, rtol=1e-9)
            np.testing.assert_allclose(joint.mean[run], due.mean, rtol=1e-9)
