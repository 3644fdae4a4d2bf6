"""Forecasts and innovations under flat priors, against filters of a hundred digits.

The flat prior of these is wide, of variance 10⁴⁰: a variance above 10²⁰ is of what is not known.
"""

import mpmath
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import pgm

RNG = np.random.default_rng(11)
STEPS, LAST = 24, 17  # readings end at LAST
TIMES = np.arange(STEPS + 1)
ZS = np.cumsum(RNG.normal(size=STEPS + 1)) + np.sin(TIMES)
GAPS = (TIMES % 5 == 2) | (TIMES > LAST)
SEASON = np.zeros((4, 4))
SEASON[0, 0], SEASON[1, 1:], SEASON[2, 1], SEASON[3, 2] = 1.0, -1.0, 1.0, 1.0
X = np.column_stack([np.sin(TIMES), np.linspace(-1, 1, STEPS + 1)])
# The motion, its variances, and the row of a reading at each step.
MODELS = {
    "local level": (np.eye(1), [0.5], np.ones((STEPS + 1, 1))),
    "trend": (np.array([[1.0, 1.0], [0.0, 1.0]]), [0.5, 0.1], np.tile([1.0, 0.0], (STEPS + 1, 1))),
    "seasonal": (SEASON, [0.5, 0.2, 0.0, 0.0], np.tile([1.0, 1.0, 0.0, 0.0], (STEPS + 1, 1))),
    "regression": (np.eye(3), [0.5, 0.0, 0.0], np.column_stack([np.ones(STEPS + 1), X])),
}
NOISE = 1.5


def precise(move, noise, rows, gaps):
    """Predicted means and variances of the readings, by a plain Kalman filter of 120 digits."""
    with mpmath.workdps(120):
        size = len(move)
        F, Q = mpmath.matrix(move.tolist()), mpmath.diag(noise)
        mean, cov = mpmath.zeros(size, 1), mpmath.mpf(10) ** 40 * mpmath.eye(size)
        found = []
        for t in TIMES:
            if t:
                mean, cov = F * mean, F * cov * F.T + Q
            h = mpmath.matrix([rows[t].tolist()])
            value, spread = (h * mean)[0], (h * cov * h.T)[0] + NOISE
            unknown = spread > mpmath.mpf(10) ** 20
            found.append((np.nan, np.inf) if unknown else (float(value), float(spread)))
            if not gaps[t]:
                gain = cov * h.T / spread
                mean, cov = mean + gain * (mpmath.mpf(float(ZS[t])) - value), cov - gain * (h * cov)
        return np.array(found).T


@pytest.mark.parametrize("first", [0, 3])
@pytest.mark.parametrize("name", MODELS)
def test_forecasts_and_innovations_equal_the_limit_of_wide_priors(name, first):
    """Through gaps, at the start too, and beyond the last reading."""
    move, noise, rows = MODELS[name]
    gaps = GAPS | (first > TIMES) & (TIMES != 1)
    size = len(move)
    x = pgm.Variable("x", components=[f"x{k}" for k in range(size)])
    z, h = pgm.Variable("z"), pgm.Variable("h", components=[f"h{k}" for k in range(size)])
    sensor = pgm.LinearGaussianCPD(z, {x: rows[:1]}, NOISE)
    given = {}
    if name == "regression":
        sensor = pgm.NonlinearGaussianCPD(
            z,
            given=(x, h),
            function=lambda x, h: (x * h).sum(axis=-1, keepdims=True),
            cov=NOISE,
        )
        given = {h: rows}
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(x, np.zeros(size), np.inf)],
        [pgm.LinearGaussianCPD(x, {x.previous: move}, np.diag(noise))],
        [sensor],
    )
    zs = np.where(gaps, np.nan, ZS)[:, None]
    evidence = {z: pgm.sightings(zs, step=TIMES, given=given)}
    found = pgm.filter(model, evidence, steps=STEPS)
    mean, cov = precise(move, noise, rows, gaps)
    unknown = np.isinf(cov)
    assert unknown.any()
    ahead, innovation = found.predicted[z], found.innovations[z]
    assert_array_equal(np.isinf(ahead.cov[:, 0, 0]), unknown)
    assert_allclose(ahead.cov[:, 0, 0], cov, rtol=1e-9)
    assert_allclose(ahead.mean[~unknown, 0], mean[~unknown], rtol=1e-9, atol=1e-9)
    read = ~unknown & ~gaps
    assert_array_equal(~np.isnan(innovation.residual[:, 0]), read)
    assert_allclose(innovation.residual[read, 0], (ZS - mean)[read], rtol=1e-9, atol=1e-9)
    assert_allclose(innovation.nis[read], ((ZS - mean) ** 2 / cov)[read], rtol=1e-9, atol=1e-9)
    smoothed = pgm.smooth(model, evidence, steps=STEPS).predicted[z]
    assert_allclose(smoothed.cov, ahead.cov, rtol=1e-9)


def test_directions_are_known_where_components_are_not():
    """A difference of two unknown components is foretold, by the filter and where nothing is read.

    The difference of a level and its slope before the last step is the level before.
    """
    x, z, d = pgm.Variable("x", components=("p", "v")), pgm.Variable("z"), pgm.Variable("d")
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(x, [0.0, 0.0], np.inf)],
        [pgm.LinearGaussianCPD(x, {x.previous: [[1.0, 1.0], [0.0, 1.0]]}, [0.2, 0.1])],
        [
            pgm.LinearGaussianCPD(z, {x: [[1.0, 0.0]]}, 0.5),
            pgm.LinearGaussianCPD(d, {x: [[1.0, -1.0]]}, 0.25),
        ],
    )
    for how in (pgm.filter, pgm.smooth):
        found = how(model, {z: [[1.0], [np.nan], [np.nan]]})
        assert_allclose(found.predicted[d].cov.ravel(), [np.inf, np.inf, 1.05, np.inf])
        assert_allclose(found.predicted[d.at(2)].mean, 1.0)
        assert_allclose(found[d.at(2)].cov, 1.05)
        assert np.isinf(found[d.at(3)].cov)
        assert np.isinf(found[z.at(2)].cov)
