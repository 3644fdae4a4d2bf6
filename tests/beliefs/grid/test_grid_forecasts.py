"""Beliefs of a grid's measurements: against linear models, quadrature, runs without a reading."""

import pickle

import numpy as np
import pytest
from beliefs.grid.sighted import evidence, m, robot, u
from beliefs.grid.sighted import z as seen
from numpy.testing import assert_allclose, assert_array_equal
from scipy.stats import norm

import pgm
from pgm.examples import walk, x, z
from pgm.results import PointMixture

CELLS = pgm.Grid({"x": (-20.0, 20.0, 400)})
ZS = np.array([[1.0], [0.5], [np.nan], [2.0], [2.5]])
STEPS = 7


def near(found, due, atol=1e-9):
    assert isinstance(found, PointMixture)
    assert_allclose(found.mean, due.mean, atol=atol)
    assert_allclose(found.cov, due.cov, atol=atol)


def test_linear_models():
    """Sums over centres of normal densities of two cells or more are integrals to rounding."""
    found, due = (pgm.smooth(walk, {z: ZS}, steps=STEPS, belief=b) for b in (CELLS, None))
    near(found.predicted[z], due.predicted[z])
    assert_array_equal(found.predicted[z].steps, np.arange(1, STEPS + 1))
    near(found.predicted[z.at(6)], due.predicted[z.at(6)])
    near(found.left_out[z], due.left_out[z])
    near(found[z.at(3)], due[z.at(3)])
    near(found.filtered[z.at(7)], pgm.filter(walk, {z: ZS}, steps=STEPS)[z.at(7)])
    assert_allclose(found.predicted[x].mean, due.predicted[x].mean, atol=1e-9)
    assert str(found.predicted.kind) == "predicted"
    assert_allclose(found.predicted.filtered[x].mean, due.filtered[x].mean, atol=1e-9)
    values = np.linspace(-3.0, 3.0, STEPS)[:, None]
    exact = norm.logpdf(values, due.predicted[z].mean, due.predicted[z].std)[:, 0]
    assert_allclose(found.predicted[z].log_density(values), exact, atol=1e-9)
    drawn = found.predicted[z].sample(40_000, rng=0)
    assert_allclose(drawn.mean(axis=0), due.predicted[z].mean, atol=0.05)
    assert_allclose(drawn.std(axis=0), due.predicted[z].std, atol=0.05)
    again = pickle.loads(pickle.dumps(found.predicted[z]))
    assert_array_equal(again.mean, found.predicted[z].mean)


def test_runs():
    runs = np.stack([ZS, ZS + 1.0])
    found = pgm.smooth(walk, {z: runs}, steps=STEPS, belief=CELLS)
    alone = pgm.smooth(walk, {z: runs[1]}, steps=STEPS, belief=CELLS)
    assert found.predicted[z].lead == (2, STEPS)
    for ask in (lambda p: p.predicted[z], lambda p: p.left_out[z], lambda p: p[z.at(7)]):
        one, other = ask(found), ask(alone)
        assert_allclose(one.mean[1], other.mean, atol=1e-12)
        assert_allclose(one.effective[1], other.effective)
    values = np.zeros((2, STEPS, 1)) + np.array([0.0, 1.0])[:, None, None]
    both = found.predicted[z].log_density(values)
    assert_allclose(both[1], alone.predicted[z].log_density(1.0), atol=1e-12)


def test_a_robot_left_out_as_if_run_again():
    """Nonlinear, with an angle, several sightings a step, and an outlier."""
    model = robot(plane=0.3, turn=0.2, cov=[0.4, 0.4, 0.2], reach=0.5, bearing=0.3)
    asked = evidence(model, 4)
    values, step = np.array(asked[seen].values), asked[seen].step
    values[5, 0] += 2.0
    given = asked[seen].given
    cells = pgm.Grid({"heading": 36, "east": (0.0, 8.0, 32), "north": (0.0, 8.0, 32)})

    def smoothed(values):
        read = pgm.sightings(values, step=step, given=given)
        return pgm.smooth(model, {u: asked[u], seen: read}, belief=cells)

    found = smoothed(values)
    every = found.left_out[seen]
    assert_array_equal(every.steps, step)
    for row in (0, 5, 9):
        without = values.copy()
        without[row] = np.nan
        less = smoothed(without)
        # A row of several at its step: the belief of the whole sensor is by sighting.
        same = less.left_out[seen]
        assert_allclose(every.mean[row], same.mean[row], atol=1e-9)
        assert_allclose(every.cov[row], same.cov[row], atol=1e-9)
        density = every.log_density(values)[row]
        assert_allclose(found.log_evidence - less.log_evidence, density, atol=1e-6)


def test_a_mixture_a_sampler_and_a_density():
    """Moments of mixtures are those of fine quadrature; of a sampler there are none."""
    y, w = pgm.Variable("y", angles=("y",)), pgm.Variable("w")
    parts = [
        pgm.NonlinearGaussianCPD(y, x, lambda x: 0.4 * x, cov=0.04),
        pgm.NonlinearGaussianCPD(y, x, lambda x: 0.4 * x + 2 * np.pi + 0.5, cov=0.25),
    ]
    laplace = pgm.SampledCPD(
        w,
        x,
        sample=lambda x, size, rng: x + rng.laplace(size=(*size, 1)),
        log_density=lambda w, x: -np.abs(w - x)[..., 0] - np.log(2.0),
    )
    model = walk.replace(
        observation=[*walk.observation, pgm.MixtureCPD(parts, [0.7, 0.3]), laplace]
    )
    found = pgm.filter(model, {z: ZS[:1]}, belief=CELLS)
    ahead = found.predicted[y.at(1)]
    prior = np.linspace(-15.0, 15.0, 4001)
    weights = norm.pdf(prior, 0.0, np.sqrt(2.0))
    weights /= weights.sum()
    mean = weights @ (0.4 * prior + 0.3 * 0.5)
    square = weights @ (0.7 * (0.4 * prior) ** 2 + 0.3 * (0.4 * prior + 0.5) ** 2)
    due = square - mean**2 + 0.7 * 0.04 + 0.3 * 0.25
    assert_allclose((ahead.mean[0], ahead.cov[0, 0]), (mean, due), atol=1e-3)
    ahead = found.predicted[w.at(1)]
    with pytest.raises(pgm.EvidenceError, match=r"SampledCPD.*moments.*belief.sample\(1000"):
        ahead.mean  # noqa: B018
    assert "SampledCPD" in str(ahead)
    assert abs(ahead.sample(20_000, rng=1).std() - 2.0) < 0.05
    density = weights @ np.exp(-np.abs(0.7 - prior)) / 2.0
    assert_allclose(ahead.log_density(0.7), np.log(density), atol=1e-3)
    with pytest.raises(pgm.ModelError, match=r"shape \(3, 1\)"):
        ahead.log_density(np.zeros((3, 1)))


def test_online():
    robot_ = pgm.OnlineFilter(walk, belief=CELLS)
    belief = robot_.predict(robot_.initial())
    assert_allclose(belief.predicted[z].std, [2.0], atol=1e-9)
    assert belief.predicted[z].lead == ()
    belief = robot_.update(belief, {z: [4.0]})
    with pytest.raises(pgm.EvidenceError, match="knows measurements of its step"):
        belief.predicted[z]
    sighted = robot(cov=[0.4, 0.4, 0.2])
    cells = pgm.Grid({"heading": 36, "east": (0.0, 8.0, 32), "north": (0.0, 8.0, 32)})
    start = pgm.OnlineFilter(sighted, belief=cells).initial()
    with pytest.raises(pgm.EvidenceError, match=r"given=\{m: \.\.\.\}"):
        start.predicted[seen]
    marks = [[1.0, 1.0], [9.0, 5.5]]
    found = start.predicted.of(seen, given={m: marks})
    assert found.mean.shape == (2, 2)
    asked = {
        u: np.empty((0, 2)),
        seen: pgm.sightings(np.full((2, 2), np.nan), step=[0, 0], given={m: marks}),
    }
    due = pgm.filter(sighted, asked, belief=cells)
    assert_allclose(found.mean, due.predicted[seen].mean, atol=1e-12)


def test_what_is_refused():
    found = pgm.filter(walk, {z: ZS}, steps=STEPS, belief=CELLS)
    with pytest.raises(pgm.EvidenceError, match=r"take pgm\.smooth"):
        found.left_out  # noqa: B018
    with pytest.raises(pgm.EvidenceError, match=r"z\[1\] has evidence there"):
        found[z.at(1)]
    with pytest.raises(pgm.EvidenceError, match="there is no row of it"):
        found.predicted[z.at(8)]
    stiff = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(x, -6.0, 0.01)],
        [pgm.LinearGaussianCPD(x, {x.previous: 1.0}, cov=0.01)],
        [pgm.LinearGaussianCPD(z, {x: 1.0}, cov=0.01)],
    )
    with pytest.warns(pgm.GridWarning, match="so far from what was believed"):
        smoothed = pgm.smooth(stiff, {z: [[-6.0], [6.0]]}, belief=pgm.Grid({"x": (-8.0, 8.0, 400)}))
    with pytest.raises(pgm.NumericalError, match=r"left_out\[z\].*NaN in its place"):
        smoothed.left_out[z]
