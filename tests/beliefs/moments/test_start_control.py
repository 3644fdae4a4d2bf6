"""Levenberg–Marquardt from a start: its cost is never exceeded, nor that of its projection."""

import numpy as np
import pytest
from crossed import slow_after
from scipy.optimize import least_squares

import pgm

LM = pgm.LevenbergMarquardt()
METHODS = pytest.mark.parametrize("method", [None, pgm.Balanced()], ids=["chain", "balanced"])
s, z = pgm.Variable("s"), pgm.Variable("z")
x = pgm.Variable("x", components=("place", "speed"))
y = pgm.Variable("y")
MOVE = np.array([[1.0, 0.5], [0.0, 1.0]])
PUSH = np.array([[0.125], [0.5]])
STEPS = 8


def smoothed(model, seen, steps, method, iterations, start):
    schedule = pgm.Smoothing(iterations, tolerance=0, damping=LM)
    return pgm.infer(pgm.compile(model, steps, method), seen, schedule=schedule, start=start)


@METHODS
def test_the_first_step_does_not_raise_the_cost(method):
    """From 2.5 the tangent of atan leads across zero and far beyond."""
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(s, 2.0, 9.0)],
        [pgm.LinearGaussianCPD(s, {s.previous: 1.0}, cov=1.0)],
        [pgm.NonlinearGaussianCPD(z, (s,), np.arctan, cov=1e-2)],
    )

    def cost(value):
        return (value - 2.0) ** 2 / 9.0 + np.arctan(value) ** 2 / 1e-3

    seen, start = {z: pgm.sightings([[0.0]], [0])}, {s: [[2.5]]}
    made = [smoothed(model, seen, 0, method, k, start)[s].mean[0, 0] for k in range(1, 7)]
    costs = np.array([cost(2.5), *map(cost, made)])
    assert (np.diff(costs) <= 1e-12 * costs[:-1]).all()
    assert costs[1] < 0.8 * costs[0]


def square(cov, left):
    """rᵀ Σ⁺ r of each run, summed over steps, after r was seen to lie in the range of Σ."""
    weighed = left @ np.linalg.pinv(cov, rcond=1e-10, hermitian=True)
    np.testing.assert_allclose(weighed @ cov, left, atol=1e-5)
    return np.einsum("rti,rti->r", left, weighed)


class Drawn:
    """A place and a speed, pushed or not, a bent sensor, maybe an exact one; three runs."""

    def __init__(self, seed):
        rng = np.random.default_rng(seed)
        self.prior = np.diag(rng.choice([0.0, 0.3, 2.0], 2))
        self.mean = rng.normal(0.0, 1.0, 2)
        self.noise = rng.choice([0.0, 0.3, 1.0]) * PUSH @ PUSH.T
        self.exact = bool(rng.integers(2)) and self.prior.trace() > 0.0
        self.bend = rng.choice([np.arctan, np.sinh, lambda place: place**3 / 4])
        self.cov = rng.choice([1e-3, 1e-1])
        bent = pgm.NonlinearGaussianCPD(z, (x,), lambda x: self.bend(x[..., :1]), cov=self.cov)
        told = pgm.LinearGaussianCPD(y, {x: [[1.0, -0.5]]}, cov=0.0)
        self.model = pgm.DynamicBayesianNetwork(
            [pgm.GaussianCPD(x, self.mean, self.prior)],
            [pgm.LinearGaussianCPD(x, {x.previous: MOVE}, cov=self.noise)],
            [bent, told],
        )
        self.read = sorted(rng.choice(STEPS + 1, 2, replace=False)) if self.exact else []
        self.truth = self.trajectories(rng)
        exact = self.truth[:, self.read] @ [1.0, -0.5]
        self.values = self.bend(self.truth[..., 0]) + rng.normal(0.0, 1.0, (3, STEPS + 1))
        self.evidence = {z: pgm.sightings(self.values[..., None], range(STEPS + 1))}
        if self.exact:
            self.evidence[y] = pgm.sightings(exact[..., None], self.read)
        self.told = exact
        self.feasible = self.alongside(rng)
        self.astray = self.feasible + rng.normal(0.0, 1.0, self.feasible.shape)

    def trajectories(self, rng):
        """Three of the model."""
        states = [self.mean + rng.normal(size=(3, 2)) @ np.sqrt(self.prior)]
        scale = np.sqrt(self.noise.trace() / (PUSH.T @ PUSH).item())
        for _ in range(STEPS):
            states.append(states[-1] @ MOVE.T + scale * rng.normal(size=(3, 1)) @ PUSH.T)
        return np.stack(states, axis=1)

    def relations(self):
        """All exact relations of a run, A x = b (b for each run), x its stacked states."""
        size = 2 * (STEPS + 1)
        rows, values = [], []

        def add(blocks, cov, value):
            values_, vectors = np.linalg.eigh(cov)
            for vector in vectors.T[values_ < 1e-12]:
                row = np.zeros(size)
                for step, matrix in blocks.items():
                    row[2 * step : 2 * step + 2] = vector @ matrix
                rows.append(row)
                values.append(np.broadcast_to(value @ vector, 3))

        add({0: np.eye(2)}, self.prior, self.mean)
        for step in range(1, STEPS + 1):
            add({step: np.eye(2), step - 1: -MOVE}, self.noise, np.zeros(2))
        for k, step in enumerate(self.read):
            add({step: np.array([[1.0, -0.5]])}, np.zeros((1, 1)), self.told[:, k, None])
        return np.array(rows), np.array(values)

    def projected(self, states, std):
        """The states that obey all relations, nearest in each component's largest deviation."""
        matrix, values = self.relations()
        out = []
        for run in range(3):
            largest = std[run].max(axis=0)
            unit = np.diag(np.tile(np.where(largest > 1e-7, largest, 1.0), STEPS + 1))
            left = values[:, run] - matrix @ states[run].ravel()
            step = unit @ np.linalg.lstsq(matrix @ unit, left, rcond=1e-10)[0]
            out.append(states[run] + step.reshape(-1, 2))
        return np.array(out)

    def alongside(self, rng):
        """States that obey all relations, some way from the truth."""
        away = self.truth + rng.normal(0.0, 2.0, self.truth.shape)
        return self.projected(away, np.ones_like(away))

    def costs(self, states):
        """What every CPD leaves unexplained, of each run."""
        np.testing.assert_allclose(states[:, self.read] @ [1.0, -0.5], self.told, atol=1e-5)
        moved = states[:, 1:] - states[:, :-1] @ MOVE.T
        left = self.values - self.bend(states[..., 0])
        total = square(self.prior, states[:, :1] - self.mean) + square(self.noise, moved)
        return total + (left**2).sum(axis=1) / self.cov


@METHODS
@pytest.mark.parametrize("seed", slow_after(3, range(8)))
def test_costs_never_rise_from_a_start(method, seed):
    drawn = Drawn(seed)
    if method is not None and drawn.exact and not drawn.noise.any():
        pytest.skip("exact measurements of an exact motion have no elements")
    for start in (drawn.feasible, drawn.astray):
        made = [
            smoothed(drawn.model, drawn.evidence, STEPS, method, k, {x: start}) for k in (1, 2, 4)
        ]
        first = drawn.projected(start, made[0][x].std)
        costs = np.array([drawn.costs(first), *(drawn.costs(found[x].mean) for found in made)])
        assert (np.diff(costs, axis=0) <= 1e-6 * costs[:-1] + 1e-9).all()


def test_a_start_that_obeys_exact_cpds_is_a_point_like_any_other():
    """Its projection would be itself: where no try helps, the means stay, to the last bit."""
    still = pgm.LevenbergMarquardt(start=1e-9, factor=1.001, tries=1)
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(x, [2.0, 0.0], np.diag([9.0, 0.0]))],
        [pgm.LinearGaussianCPD(x, {x.previous: MOVE}, cov=PUSH @ PUSH.T)],
        [pgm.NonlinearGaussianCPD(z, (x,), lambda x: np.arctan(x[..., :1]), cov=1e-3)],
    )
    start = np.array([[3.0, 0.0], [3.125, 0.5], [3.375, 0.5]])
    seen = {z: pgm.sightings([[0.0]], [0])}
    found = pgm.smooth(
        model, seen, steps=2, start={x: start}, iterations=3, tolerance=0, damping=still
    )
    np.testing.assert_array_equal(found[x].mean, start)


def test_a_filter_with_an_exact_sensor_never_raises_the_cost():
    """The predicted place contradicts the exact reading; the belief given that alone does not."""
    place = pgm.Variable("p", components=("east", "north"))
    known, line = np.array([[4.0, 0.5], [0.5, 9.0]]), np.array([[1.0, 0.3]])
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(place, [1.0, 2.5], known)],
        [pgm.LinearGaussianCPD(place, {place.previous: np.eye(2)}, cov=np.eye(2))],
        [
            pgm.LinearGaussianCPD(y, {place: line}, cov=0.0),
            pgm.NonlinearGaussianCPD(z, (place,), lambda p: np.arctan(p[..., 1:]), cov=1e-3),
        ],
    )
    told = np.linspace(1.4, 3.0, 6)
    seen = {
        y: pgm.sightings(told[:, None, None], [0]),
        z: pgm.sightings(np.zeros((6, 1, 1)), [0]),
    }

    def cost(mean):
        np.testing.assert_allclose(mean @ line[0], told, atol=1e-9)
        left = mean - [1.0, 2.5]
        return np.einsum("ri,ij,rj->r", left, np.linalg.inv(known), left) + (
            np.arctan(mean[:, 1]) ** 2 / 1e-3
        )

    asked = {"steps": 0, "tolerance": 0, "damping": LM}
    made = [pgm.filter(model, seen, iterations=k, **asked)[place] for k in range(1, 9)]
    pull = known @ line[0]
    left = (told - line[0] @ [1.0, 2.5]) / (pull @ line[0])
    first = np.array([1.0, 2.5]) + left[:, None] * pull
    costs = np.array([cost(first), *(cost(found.mean[:, 0]) for found in made[1:])])
    assert (np.diff(costs, axis=0) <= 1e-9 * costs[:-1]).all()
    assert (costs[1] < cost(made[0].mean[:, 0])).any()


def test_hidden_controls_and_missing_exact_readings_are_projected_too():
    """A place moved by what a hidden control says, without noise; a reading of it, missing once."""
    push, told = pgm.Variable("u"), pgm.Variable("c")
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(s, 0.0, 4.0)],
        [
            pgm.LinearGaussianCPD(push, {told: 1.0}, cov=0.5),
            pgm.LinearGaussianCPD(s, {s.previous: 1.0, push: 1.0}, cov=0.0),
        ],
        [
            pgm.NonlinearGaussianCPD(z, (s,), np.arctan, cov=1e-3),
            pgm.LinearGaussianCPD(y, {s: 2.0}, cov=0.0),
        ],
    )
    commands, read = np.array([[1.0], [-0.5], [0.3]]), np.array([[5.0], [np.nan]])
    seen = {told: commands, z: np.zeros((3, 1)), y: pgm.sightings(read[..., None], [2])}
    start = {s: [[2.5], [1.0], [4.0], [3.0]], push: [[1.0], [2.0], [3.0]]}

    def cost(found):
        place, moved = found[s].mean[..., 0], found[push].mean[..., 0]
        np.testing.assert_allclose(np.diff(place), moved, atol=1e-9)
        assert place[0, 2] == pytest.approx(2.5, abs=1e-9)
        left = ((moved - commands[:, 0]) ** 2).sum(axis=1) / 0.5
        return place[:, 0] ** 2 / 4.0 + left + (np.arctan(place[:, 1:]) ** 2).sum(axis=1) / 1e-3

    asked = {"start": start, "tolerance": 0, "damping": LM}
    costs = [cost(pgm.smooth(model, seen, iterations=k, **asked)) for k in (1, 2, 3, 5)]
    assert (np.diff(costs, axis=0) <= 1e-9 * np.array(costs[:-1])).all()
    assert abs(pgm.smooth(model, seen, iterations=1, **asked)[s].mean[1, 2] - 2.5) > 0.1


def test_a_relation_between_components_needs_both():
    """Readings with one error tell the difference of two places exactly, where both are seen."""
    pair, both = (pgm.Variable(name, components=("east", "north")) for name in "pb")
    shared = np.full((2, 2), 0.5)
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(pair, [0.0, 0.0], 4.0 * np.eye(2))],
        [pgm.LinearGaussianCPD(pair, {pair.previous: 1.0}, cov=np.eye(2))],
        [
            pgm.NonlinearGaussianCPD(z, pair, lambda p: np.arctan(p[..., :1]), cov=1e-3),
            pgm.LinearGaussianCPD(both, {pair: 1.0}, cov=shared),
        ],
    )
    read = np.array([[2.0, 3.0], [2.0, np.nan], [np.nan, 3.0], [np.nan, np.nan]])
    seen = {z: pgm.sightings(np.zeros((4, 1, 1)), [0]), both: pgm.sightings(read[:, None], [0])}
    asked = {"steps": 0, "start": {pair: [[2.5, 1.0]]}, "tolerance": 0, "damping": LM}

    def cost(mean):
        left = read - mean
        np.testing.assert_allclose(left[0, 1], left[0, 0], atol=1e-9)
        taken = np.nanmean(left[:3], axis=1) ** 2 / 0.5
        return (mean**2).sum(1) / 4.0 + np.arctan(mean[:, 0]) ** 2 / 1e-3 + np.append(taken, 0.0)

    iterations = (1, 2, 3, 4, 6, 9, 30)
    means = [pgm.smooth(model, seen, iterations=k, **asked)[pair].mean[:, 0] for k in iterations]
    costs = np.array([cost(mean) for mean in means])
    assert (np.diff(costs, axis=0) <= 1e-9 * costs[:-1]).all()
    for run in range(4):  # no step from the end is better, along the relation where there is one
        for move in np.array([[1, 1]] if run == 0 else [[1, 0], [0, 1]]) * 1e-3:
            moved = means[-1].copy()
            for sign in (1.0, -1.0):
                moved[run] = means[-1][run] + sign * move
                assert cost(moved)[run] > costs[-1, run]


def test_a_start_outside_a_domain_may_be_projected():
    """The projection of this start has no cost, so that whatever has one is better."""
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(s, 1.0, 1.0)],
        [pgm.LinearGaussianCPD(s, {s.previous: -1.0}, cov=0.0)],
        [pgm.NonlinearGaussianCPD(z, (s,), np.log, cov=0.1)],
    )
    seen = {z: pgm.sightings([[0.0]], [0])}
    start = {s: [[0.5], [3.0]]}
    found = pgm.smooth(model, seen, steps=1, start=start, iterations=30, damping=LM)
    value = found[s].mean[0, 0]
    assert value - 1.0 + np.log(value) / (0.1 * value) == pytest.approx(0.0, abs=1e-6)


def test_singular_nonlinear_noise_is_refused_from_a_start_too():
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(s, 1.0, 1.0)],
        [pgm.NonlinearGaussianCPD(s, (s.previous,), np.sin, cov=0.0)],
        [pgm.LinearGaussianCPD(z, {s: 1.0}, cov=0.1)],
    )
    seen = {z: [[0.3]]}
    asked = {"damping": LM, "iterations": 1}
    assert pgm.smooth(model, seen, **asked).status.iterations == 1
    with pytest.raises(pgm.ModelError, match=r"s.* is nonlinear and its noise is singular"):
        pgm.smooth(model, seen, start={s: [[1.0], [0.8]]}, **asked)


@pytest.mark.parametrize("exact", [True, False])
def test_a_flat_prior_costs_nothing(exact):
    """The optimum is that of all other terms, which scipy finds too."""
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(s, 0.0, np.inf)],
        [pgm.LinearGaussianCPD(s, {s.previous: 1.0}, cov=0.1)],
        [
            pgm.NonlinearGaussianCPD(z, (s,), np.arctan, cov=0.01),
            pgm.LinearGaussianCPD(y, {s: 1.0}, cov=0.0 if exact else 0.2),
        ],
    )
    seen = {z: np.full((4, 1), 0.3), y: pgm.sightings([[1.0]], [2])}
    start = {s: np.full((5, 1), 2.5)}
    found = pgm.smooth(model, seen, start=start, iterations=50, tolerance=1e-10, damping=LM)[s]

    def left(free):
        place = np.insert(free, 2, 1.0) if exact else free
        read = [] if exact else [(place[2] - 1.0) / 0.2**0.5]
        return np.concatenate([np.diff(place) / 0.1**0.5, (np.arctan(place[1:]) - 0.3) / 0.1, read])

    best = least_squares(left, np.ones(4 if exact else 5), xtol=1e-14, ftol=1e-14, gtol=1e-14).x
    expected = np.insert(best, 2, 1.0) if exact else best
    np.testing.assert_allclose(found.mean[:, 0], expected, atol=1e-7)
