"""Beliefs of particles' measurements: against linear models, grids and runs without a reading."""

import pickle
import warnings

import numpy as np
import pytest
from beliefs.particles.clouds import mark, move, pose, robot, robot_evidence, seen
from numpy.testing import assert_allclose, assert_array_equal
from scipy.stats import norm

import pgm
from pgm.examples import walk, x, z
from pgm.results import PointMixture

MANY = pgm.Particles(20_000, seed=1)
ZS = np.array([[1.0], [0.5], [np.nan], [2.0], [2.5]])
STEPS = 7


@pytest.fixture(scope="module")
def smoothed():
    return [pgm.smooth(walk, {z: ZS}, steps=STEPS, belief=b) for b in (MANY, None)]


def near(found, due):
    """Within five standard errors of 5,000 particles that are effective at least."""
    assert isinstance(found, PointMixture)
    assert (found.effective > 5000).all()
    assert_allclose(found.mean, due.mean, atol=0.14)
    assert_allclose(found.std, due.std, rtol=0.05)


def test_linear_models(smoothed):
    found, due = smoothed
    ahead = found.predicted[z]
    near(ahead, due.predicted[z])
    assert_array_equal(ahead.steps, np.arange(1, STEPS + 1))
    near(found.predicted[z.at(6)], due.predicted[z.at(6)])
    near(found[z.at(3)], due[z.at(3)])
    near(found.left_out[z], due.left_out[z])
    assert_allclose(found.predicted[x].mean, due.predicted[x].mean, atol=0.1)
    assert str(found.predicted.kind) == "predicted"
    assert_array_equal(found.predicted.filtered[x].mean, found.filtered[x].mean)
    filtered = pgm.filter(walk, {z: ZS}, steps=STEPS, belief=MANY)
    assert_array_equal(filtered.predicted[z].mean, ahead.mean)
    values = np.linspace(-3.0, 3.0, STEPS)[:, None]
    exact = norm.logpdf(values, due.predicted[z].mean, due.predicted[z].std)[:, 0]
    assert_allclose(ahead.log_density(values), exact, atol=0.1)
    # The log-evidence is the sum of the readings' densities before they are taken.
    read = [0, 1, 3, 4]
    total = ahead.log_density(np.nan_to_num(np.pad(ZS, ((0, 2), (0, 0)))))[read].sum()
    assert_allclose(total, filtered.log_evidence, rtol=1e-9)
    again = pickle.loads(pickle.dumps(ahead))
    assert_array_equal(again.mean, ahead.mean)


def test_left_out_tells_its_shape(smoothed):
    found = smoothed[0].left_out[z]
    assert np.isnan(found.pareto[2])
    assert (found.pareto[[0, 1, 3, 4]] < 0.7).all()
    assert smoothed[0].predicted[z].pareto is None
    sharp = pgm.DynamicBayesianNetwork(
        walk.prior, walk.transition, [pgm.LinearGaussianCPD(z, {x: 1.0}, cov=0.02)]
    )
    found = pgm.smooth(sharp, {z: [[2.0], [-1.0]]}, belief=pgm.Particles(8000, seed=1))
    with pytest.warns(pgm.ParticleWarning, match=r"left_out\[z\]: .*NaN in its place"):
        found = found.left_out[z]
    assert (found.pareto > 0.7).all()


def test_runs_of_a_robot():
    """Nonlinear sightings of landmarks with an angle, in two runs of other readings and gaps."""
    model, asked = robot(), robot_evidence(4, runs=(2,), rng=5)
    asked[seen].values[1, 3] = np.nan
    asked[seen].values[0, 2, 0] = np.nan
    cloud = pgm.Particles(4000, seed=3)
    found = pgm.smooth(model, asked, belief=cloud)
    ahead = found.predicted[seen]
    assert ahead.mean.shape == (2, 8, 2)
    points = found.predicted[pose.at(2)]
    weights, states = points.weights, points.states
    away = asked[seen].given[mark][3] - states[..., :2]
    expected = np.hypot(away[..., 0], away[..., 1])
    assert_allclose(ahead.mean[:, 3, 0], (weights * expected).sum(axis=1), rtol=1e-12)
    bearing = np.arctan2(away[..., 1], away[..., 0]) - states[..., 2]
    middle = np.angle((weights * np.exp(1j * bearing)).sum(axis=1))
    assert_allclose(ahead.mean[:, 3, 1], middle, atol=0.02)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", pgm.ParticleWarning)
        every = found.left_out[seen]
        without = asked[seen].values.copy()
        without[:, 5] = np.nan
        read = pgm.sightings(without, step=asked[seen].step, given=asked[seen].given)
        less = pgm.smooth(model, {move: asked[move], seen: read}, belief=cloud)
        same = less.left_out[seen]
    assert_allclose(every.mean[:, 5], same.mean[:, 5], atol=0.08)
    assert_allclose(every.std[:, 5], same.std[:, 5], rtol=0.12)
    assert np.isnan(every.pareto[1, 3])
    assert not np.isnan(every.pareto[0, 2])


def test_ignored_readings_have_nothing_to_remove():
    cut = pgm.SampledCPD(
        z,
        x,
        log_density=lambda z, x: np.where(np.abs(z - x)[..., 0] < 3.0, -np.log(6.0), -np.inf),
    )
    model = walk.replace(observation=[cut])
    cloud = pgm.Particles(3000, seed=1, impossible="ignore")
    with pytest.warns(pgm.ParticleWarning):
        found = pgm.smooth(model, {z: [[0.5], [90.0], [1.0]]}, belief=cloud)
    out = found.left_out[z]
    assert_allclose(out.effective[1], 3000)
    assert np.isfinite(out.log_density(0.0)).all()
    with pytest.raises(pgm.ModelError, match="cannot be drawn from"):
        out.sample(3, rng=0)


def test_online():
    loop = pgm.OnlineFilter(walk, belief=MANY)
    belief = loop.predict(loop.initial())
    offline = pgm.filter(walk, {z: [[4.0]]}, belief=MANY).predicted[z]
    assert_array_equal(belief.predicted[z].mean, offline.mean[0])
    belief = loop.update(belief, {z: [4.0]})
    with pytest.raises(pgm.EvidenceError, match="knows measurements of its step"):
        belief.predicted[z]
    start = pgm.OnlineFilter(robot(), belief=pgm.Particles(2000, seed=1)).initial()
    with pytest.raises(pgm.EvidenceError, match=r"given=\{mark: \.\.\.\}"):
        start.predicted[seen]
    marks = [[9.0, 6.0], [2.0, 7.0]]
    found = start.predicted.of(seen, given={mark: marks})
    assert found.mean.shape == (2, 2)
    assert_allclose(found.mean[0, 0], 5.0, atol=0.1)


def test_what_is_refused(smoothed):
    with pytest.raises(pgm.EvidenceError, match=r"take pgm\.smooth"):
        smoothed[0].filtered.left_out  # noqa: B018
    with pytest.raises(pgm.EvidenceError, match=r"z\[1\] has evidence there"):
        smoothed[0][z.at(1)]
    with pytest.raises(pgm.EvidenceError, match="sightings"):
        pgm.filter(robot(), {move: np.zeros((2, 2))}, belief=MANY).predicted[seen]
