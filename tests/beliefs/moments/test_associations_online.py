"""Sightings without identity one step at a time: with several sensors, as offline."""

import copy
import pickle

import numpy as np
import pytest
from numpy.testing import assert_allclose

import pgm

x, z, near, m = (pgm.Variable(n, components=("east", "north")) for n in ("x", "z", "near", "m"))
gps = pgm.Variable("gps")
EYE = np.eye(2)
MARKS = np.array([[2.0, 0.0], [2.6, 0.4], [0.0, 3.0]])
STEPS = 4


def robot():
    """A robot that reads one coordinate, and sees landmarks by two sensors."""
    away = {x: -EYE, m: EYE}
    return pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(x, [0.0, 0.0], EYE)],
        [pgm.LinearGaussianCPD(x, {x.previous: EYE}, cov=0.1 * EYE)],
        [
            pgm.LinearGaussianCPD(z, away, cov=0.05 * EYE),
            pgm.LinearGaussianCPD(gps, {x: [[1.0, 0.0]]}, cov=0.01),
            pgm.LinearGaussianCPD(near, away, cov=0.05 * EYE),
        ],
    )


def drawn(runs, rng):
    """Sightings of marks that are easily taken for others, two a step and one; some missing."""
    far = MARKS[rng.integers(3, size=(*runs, 2 * STEPS))] + rng.normal(0, 0.5, (*runs, 8, 2))
    close = MARKS[rng.integers(3, size=(*runs, STEPS))] + rng.normal(0, 0.5, (*runs, 4, 2))
    if runs:
        far[(0,) * len(runs) + (5,)] = np.nan
    return far, close, rng.normal(0, 0.3, (*runs, STEPS, 1))


@pytest.mark.parametrize("sensors", [(z,), (z, gps), (near, z), (gps, near, z)])
@pytest.mark.parametrize("runs", [(), (3,), (2, 2)])
@pytest.mark.parametrize("named", [{}, {"spurious": 0.2, "volume": 50.0, "gate": 0.95}])
def test_every_step_is_associated_as_offline(sensors, runs, named):
    far, close, read = drawn(runs, np.random.default_rng(3))
    given = {m: pgm.unknown(MARKS, **({"association": "likelihood"} | named))}

    def at(step):
        """The measurements of one step, of the sensors in question."""
        two = slice(2 * step - 2, 2 * step)
        every = {
            z: pgm.sightings(far[..., two, :], given=given),
            near: pgm.sightings(close[..., step - 1 : step, :], given=given),
            gps: pgm.sightings(read[..., step - 1 : step, :]),
        }
        return {v: every[v] for v in sensors}

    one, two = np.arange(1, STEPS + 1), np.repeat(np.arange(1, STEPS + 1), 2)
    whole = {
        z: pgm.sightings(far, step=two, given=given),
        near: pgm.sightings(close, step=one, given=given),
        gps: pgm.sightings(read, step=one),
    }
    offline = pgm.filter(robot(), {v: whole[v] for v in sensors}, steps=STEPS)
    online = pgm.OnlineFilter(robot())
    belief = online.initial()
    for step in range(1, STEPS + 1):
        belief = online.update(online.predict(belief), at(step))
        found = offline.associations[z].probability[..., 2 * step - 2 : 2 * step, :]
        assert_allclose(belief.associations[z].probability, found, atol=1e-12)
        assert_allclose(belief[x].mean, offline[x].mean[..., step, :], atol=1e-12)
    assert_allclose(belief.log_evidence, offline.log_evidence, rtol=1e-10)


def test_a_sensor_that_is_known_decides_what_was_seen():
    """Between two marks by the prior; the coordinate that is read tells which."""
    marks = pgm.unknown([[2.0, 0.0], [4.0, 0.0]], association="likelihood")
    online = pgm.OnlineFilter(robot())
    for place, which in ((-0.9, 0), (0.9, 1)):
        belief = online.predict(online.initial())
        seen = pgm.sightings([[3.0, 0.0]], given={m: marks})
        assert online.update(belief, {z: seen, gps: place}).associations[z].candidate == which


def test_no_sightings_are_no_associations():
    online = pgm.OnlineFilter(robot())
    none = pgm.sightings(np.zeros((0, 2)), given={m: pgm.unknown(MARKS, association="likelihood")})
    belief = online.update(online.initial(), {z: none, gps: 0.4})
    assert_allclose(belief[x].mean, online.update(online.initial(), {gps: 0.4})[x].mean)


@pytest.mark.parametrize("belief", [None, pgm.Particles(100)])
def test_no_sightings_offline(belief):
    evidence = {
        z: pgm.sightings(
            np.zeros((0, 2)), step=[], given={m: pgm.unknown(MARKS, association="likelihood")}
        )
    }
    found = pgm.filter(robot(), evidence, steps=2, belief=belief)
    assert found.associations[z].probability.shape == (0, 5)
    assert found.log_evidence == 0.0


@pytest.mark.parametrize("keep", [None, [x]])
def test_posteriors_with_associations_are_pickled(keep):
    evidence = {
        z: pgm.sightings(
            [[1.0, 1.0]], step=[1], given={m: pgm.unknown(MARKS, association="likelihood")}
        )
    }
    found = pgm.filter(robot(), evidence, steps=1, keep=keep)
    for again in (pickle.loads(pickle.dumps(found)), copy.deepcopy(found)):
        expected = found.associations[z].probability
        assert_allclose(again.associations[z].probability, expected, atol=0)


def test_weights_of_any_size():
    """Their sum may be more than a float holds."""
    wide = pgm.unknown(MARKS, weights=[1e308, 1e308, 1e-308], association="likelihood")
    assert_allclose(np.exp(wide.log_shares[:3]), [0.5, 0.5, 0.0])
    assert_allclose(
        pgm.unknown(MARKS, weights=[5e-324, 0, 0], association="likelihood").log_shares[0], 0.0
    )
