"""Trajectories drawn on a grid: against the Kalman smoother's joints, and Bayes' rule by cell."""

import numpy as np
import pytest
from grid.sighted import evidence, grid, robot
from numpy.testing import assert_array_equal
from scipy.stats import norm

import pgm
from tests.beliefs.grid.test_robot_grids import motions, slices

N = 20_000
X = pgm.Variable("x", components=("place", "speed"))
Z, U, COMMAND = pgm.variables("z u command")
PLANE = pgm.Grid({"place": (-8, 9, 90), "speed": (-4, 4, 64)})
READ = {Z: [[0.4], [np.nan], [1.5], [1.2]]}


def far(drawn, mean, cov):
    """The largest difference of draws' moments from N(mean, cov), in standard errors."""
    count = len(drawn)
    var = np.diagonal(cov)
    errors = [np.abs(drawn.mean(axis=0) - mean) / np.sqrt(var / count)]
    spread = np.sqrt((np.outer(var, var) + cov**2) / count)
    errors.append((np.abs(np.cov(drawn.T) - cov) / spread).ravel())
    return float(np.concatenate(errors).max())


def plane(matrix=((1.0, 0.4), (0.0, 0.9)), noise=((0.2, 0.0), (0.0, 0.1)), motion=None):
    motion = motion or [pgm.LinearGaussianCPD(X, {X.previous: matrix}, cov=noise)]
    return pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(X, [0.1, 0.2], [0.5, 0.2])],
        motion,
        [pgm.LinearGaussianCPD(Z, {X: [[1.0, 0.0]]}, cov=0.3)],
    )


CONTROL = [
    pgm.LinearGaussianCPD(U, {COMMAND: 1.0}, cov=0.2),
    pgm.LinearGaussianCPD(X, {X.previous: 1.0, U: [[1.0], [0.4]]}, cov=[0.15, 0.08]),
]
GIVEN = READ | {COMMAND: np.full((4, 1), 0.1)}


@pytest.mark.parametrize(
    ("net", "given", "split"),
    [
        (plane(), READ, False),
        (plane(noise=((0.2, 0.08), (0.08, 0.15))), READ, False),
        (plane(matrix=((0.8, -0.6), (0.6, 0.8))), READ, True),
        (plane(motion=CONTROL), GIVEN, False),
    ],
    ids=["along axes", "correlated noise", "split", "hidden control"],
)
def test_trajectories_have_the_joints_of_the_kalman_smoother(net, given, split):
    found = pgm.smooth(net, given, belief=PLANE)
    assert bool(found.status.split) == split
    drawn = found.sample(N, rng=1)[X]
    assert drawn.shape == (N, 5, 2)
    joint = pgm.smooth(net, given).joint(*(X.at(k) for k in range(5)))
    assert far(drawn.reshape(N, 10), joint.mean, joint.cov) < 5.5


LINE = pgm.Grid({"w": (-6.0, 6.0, 90)})
W = pgm.Variable("w")
STILL = pgm.LinearGaussianCPD(W, {W.previous: 0.9}, cov=0.3)


@pytest.mark.parametrize(
    "motion",
    [
        pgm.SampledCPD(
            W,
            W.previous,
            log_density=lambda y, b: norm.logpdf((y - 0.9 * b)[..., 0], scale=0.3**0.5),
        ),
        pgm.MixtureCPD([STILL, STILL], [0.3, 0.7]),
    ],
    ids=["density", "mixture"],
)
def test_densities_and_mixtures_are_the_gaussian_that_they_say(motion):
    net = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(W, 0.3, 0.6)], [STILL], [pgm.LinearGaussianCPD(Z, {W: 1.0}, cov=0.4)]
    )
    joint = pgm.smooth(net, READ).joint(*(W.at(k) for k in range(5)))
    drawn = pgm.smooth(net.replace(transition=[motion]), READ, belief=LINE).sample(N, rng=2)[W]
    assert far(drawn[..., 0], joint.mean, joint.cov) < 5.5


def test_a_mixture_of_jumps_has_steps_of_either_part():
    """What no Gaussian is: of two steps, the walker went one way or the other."""
    ways = [pgm.LinearGaussianCPD(W, {W.previous: 1.0}, cov=0.01, offset=b) for b in (-1.0, 1.0)]
    net = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(W, 0.0, 0.04)],
        [pgm.MixtureCPD(ways, [0.25, 0.75])],
        [pgm.LinearGaussianCPD(Z, {W: 1.0}, cov=4.0)],
    )
    found = pgm.smooth(net, {Z: [[np.nan], [0.0]]}, belief=pgm.Grid({"w": (-4.0, 4.0, 320)}))
    steps = np.diff(found.sample(N, rng=0)[W][..., 0], axis=1)
    assert (np.abs(np.abs(steps) - 1.0) < 0.6).all()
    went = (steps > 0.0).sum(axis=1)
    # p(k ups) ∝ binomial × N(0; 2 k − 2, 4 + 0.04 + 2 × 0.01)
    due = np.array([1, 6, 9]) / 16 * norm.pdf([-2.0, 0.0, 2.0], scale=4.06**0.5)
    due /= due.sum()
    shares = np.bincount(went, minlength=3) / N
    assert (np.abs(shares - due) < 5.5 * np.sqrt(due * (1.0 - due) / N)).all()


@pytest.mark.parametrize("net", motions())
def test_sources_are_by_bayes_rule_cell_by_cell(net):
    """p(source | target) ∝ p(source) p(target | source), the latter by the transposed motion."""
    chain = slices(net, evidence(robot(), 3), grid())
    belief = chain.prior()
    belief = chain.forward(1, belief)
    belief /= belief.sum()
    after = chain.forward(2, belief)
    source, target = chain.windows[2]
    made = chain.model.motion.at(2, 0, source)
    lattice, rng = chain.lattice, np.random.default_rng(0)
    before, part = lattice.cut(belief, source), lattice.cut(after, target)
    for flat in np.argsort(part, axis=None)[[-1, -400]]:
        place = np.unravel_index(flat, part.shape)
        unit = np.zeros(part.shape)
        unit[place] = 1.0
        due = before * made.backward(unit)
        due /= due.sum()
        places = np.tile(np.array(place)[:, None], (1, N))
        drawn = made.sources(before, places, rng)
        found = np.zeros(before.shape)
        np.add.at(found, tuple(drawn), 1.0 / N)
        many = due * N > 5.0
        assert (np.abs(found - due)[many] < 5.5 * np.sqrt(due[many] / N)).all()
        assert found[~many].sum() == pytest.approx(due[~many].sum(), abs=1e-3)
        assert (found[due == 0.0] == 0.0).all()


def test_a_heading_across_the_cut():
    heading = pgm.Variable("heading", angles=("heading",))
    seen = pgm.Variable("seen", angles=("seen",))
    net = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(heading, 3.0, 0.02)],
        [pgm.LinearGaussianCPD(heading, {heading.previous: 1.0}, cov=0.02, offset=0.1)],
        [pgm.LinearGaussianCPD(seen, {heading: 1.0}, cov=0.05)],
    )
    given = {seen: [[3.1], [-3.0], [-2.9]]}
    found = pgm.smooth(net, given, belief=pgm.Grid({"heading": 120}))
    drawn = found.sample(N, rng=0)[heading][..., 0]
    assert (np.abs(drawn) <= np.pi + 1e-9).all()
    assert drawn.min() < -3.0 < 3.0 < drawn.max()
    joint = pgm.smooth(net, given).joint(*(heading.at(k) for k in range(4)))
    near = joint.mean + (drawn - joint.mean + np.pi) % (2 * np.pi) - np.pi
    assert far(near, joint.mean, joint.cov) < 6.0


def test_runs_float32_and_one_step():
    values = np.random.default_rng(0).normal(size=(2, 3, 4, 1))
    on = pgm.Grid(PLANE.cells, dtype=np.float32)
    found = pgm.smooth(plane(), {Z: values}, belief=on)
    drawn = found.sample((4, 500), rng=3)[X]
    assert drawn.shape == (4, 500, 2, 3, 5, 2)
    assert_array_equal(drawn, found.sample((4, 500), rng=3)[X])
    exact = pgm.smooth(plane(), {Z: values})[X]
    flat = drawn.reshape(2000, 2, 3, 5, 2)
    assert (np.abs(flat.mean(axis=0) - exact.mean) < 5.5 * exact.std / np.sqrt(2000)).all()
    centres = found[X].centres
    assert np.isin(drawn[..., 0], centres[0]).all()
    assert np.isin(drawn[..., 1], centres[1]).all()
    alone = pgm.smooth(plane(), {Z: pgm.sightings([[0.4]], step=[0])}, steps=0, belief=PLANE)
    assert alone.sample(3, rng=0)[X].shape == (3, 1, 2)
    moments = alone[X][0]
    own = alone.sample(N, rng=0)[X][:, 0]
    assert far(own, moments.mean, moments.cov) < 5.5


def test_filters_and_fixed_lags_have_none():
    with pytest.raises(pgm.EvidenceError, match=r"this posterior is filtered: take pgm\.smooth"):
        pgm.filter(plane(), READ, belief=PLANE).sample(2, rng=0)
    with pytest.raises(pgm.EvidenceError, match="fixed-lag"):
        pgm.smooth(plane(), READ, lag=1, belief=PLANE).sample(2, rng=0)
    with pytest.raises(pgm.ModelError, match="draw fewer at a time"):
        pgm.smooth(plane(), READ, belief=PLANE).sample(10**12, rng=0)
