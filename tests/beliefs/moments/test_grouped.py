"""A grouped sensor against one sensor that reads everything as one vector."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

import pgm
from models import motion, sensors

x = pgm.Variable("x", components=("east", "north", "heading"), angles=("heading",))
u = pgm.Variable("u", components=("v", "omega", "dt"))
m = pgm.Variable("m", components=("east", "north"))
z = pgm.Variable("z", components=("range", "bearing"), angles=("bearing",))
pair = pgm.Variable("pair", components=("r1", "b1", "r2", "b2"), angles=("b1", "b2"))
both = pgm.Variable("both", components=("e1", "n1", "e2", "n2"))
NOISE = np.diag([0.1, 0.01])
T = 12


def sees_both(x, m):
    halves = (sensors.range_bearing(x, m[..., :2]), sensors.range_bearing(x, m[..., 2:]))
    return np.concatenate(halves, axis=-1)


def model(sensor):
    return pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(x, [0, 0, 0], np.diag([0.3, 0.3, 0.2]))],
        transition=[
            pgm.NonlinearGaussianCPD(
                x, (x.previous, u), motion.velocity, np.diag([0.01, 0.01, 0.005])
            )
        ],
        observation=[sensor],
    )


GROUPED = pgm.NonlinearGaussianCPD(z, (x, m), sensors.range_bearing, NOISE, grouped=True)
SINGLE = pgm.NonlinearGaussianCPD(z, (x, m), sensors.range_bearing, NOISE)
STACKED = pgm.NonlinearGaussianCPD(pair, (x, both), sees_both, np.kron(np.eye(2), NOISE))


@pytest.fixture(scope="module")
def evidence():
    controls = np.tile([1.0, 0.3, 0.5], (T, 1))
    landmarks = np.random.default_rng(0).uniform(-5, 5, (T, 2, 2))
    seen = pgm.sightings(
        step=np.repeat(np.arange(1, T + 1), 2), given={m: landmarks.reshape(-1, 2)}
    )
    drawn = model(GROUPED).sample({u: controls, z: seen}, runs=3, rng=1)
    stacked = {u: controls, both: landmarks.reshape(T, 4), pair: drawn[z].reshape(3, T, 4)}
    return drawn.evidence, stacked


@pytest.mark.parametrize("iterations", [1, 3])
@pytest.mark.parametrize("rule", [pgm.Unscented(), pgm.Cubature(), pgm.Taylor()])
def test_it_is_the_stacked_sensor(evidence, rule, iterations):
    asked = {"lineariser": rule, "iterations": iterations, "tolerance": 0}
    found = pgm.smooth(model(GROUPED), evidence[0], **asked)
    due = pgm.smooth(model(STACKED), evidence[1], **asked)
    assert_allclose(found[x].mean, due[x].mean, atol=1e-9)
    assert_allclose(found[x].cov, due[x].cov, atol=1e-10)
    assert_allclose(found.log_evidence, due.log_evidence, atol=1e-8)
    assert_allclose(found.innovations[z].nis, due.innovations[pair].nis, atol=1e-8)


def test_the_cross_terms_matter_for_a_rule_but_not_for_taylor(evidence):
    def gap(rule):
        one = pgm.filter(model(GROUPED), evidence[0], lineariser=rule)
        other = pgm.filter(model(SINGLE), evidence[0], lineariser=rule)
        return np.abs(one[x].mean - other[x].mean).max()

    assert gap(pgm.Taylor()) < 1e-10
    assert gap(pgm.Unscented()) > 1e-6


def test_missing_readings_of_a_group(evidence):
    """Per run; the twin leaves them out, which with the cross terms is what it must equal."""
    lost = dict(evidence[0])
    values = np.array(lost[z].values)
    values[1, 5] = np.nan
    lost[z] = pgm.sightings(values, lost[z].step, lost[z].given)
    found = pgm.filter(model(GROUPED), lost, lineariser=pgm.Unscented())
    whole = pgm.filter(model(GROUPED), evidence[0], lineariser=pgm.Unscented())
    assert_allclose(found[x].mean[0], whole[x].mean[0], atol=1e-12)
    kept = np.delete(np.arange(2 * T), 5)
    one = {
        u: lost[u],
        z: pgm.sightings(
            values[1, kept], np.array(lost[z].step)[kept], {m: np.array(lost[z].given[m])[kept]}
        ),
    }
    alone = pgm.filter(model(GROUPED), one, lineariser=pgm.Unscented())
    assert_allclose(found[x].mean[1], alone[x].mean, atol=1e-9)
    assert_allclose(found.log_evidence[1], alone.log_evidence, atol=1e-9)
