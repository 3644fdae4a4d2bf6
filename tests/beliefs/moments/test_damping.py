"""Step control: the fixed points stay, costs never rise, and what diverged comes home."""

import numpy as np
import pytest
from robots import DRIVE, LANDMARKS, P0, SENSORS, controls, drive_along, drive_cpd, m, network, u, x
from robots import Q as NOISE
from scipy.optimize import least_squares, minimize_scalar
from textbooks import assert_same, wrapped

import pgm
from pgm.beliefs.moments.steps import cost
from pgm.beliefs.moments.steps.plan import ChainPlan
from pgm.factors.scope import positions
from pgm.schedules.binding import bind_chain
from pgm.schedules.iteration import Point

SIGHT = SENSORS["range_bearing"]
LM = pgm.LevenbergMarquardt()
TIMES = (1, 2, 3, 4, 5, 7, 10)
s, k, z = pgm.Variable("s"), pgm.Variable("k"), pgm.Variable("z")


def growth(s, k):
    return 0.9 * s + 10 * s / (1 + s**2) + 8 * np.cos(1.2 * k)


def growing(power=3):
    return pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(s, mean=5.0, cov=4.0)],
        transition=[pgm.NonlinearGaussianCPD(s, given=(s.previous, k), function=growth, cov=1.0)],
        observation=[
            pgm.NonlinearGaussianCPD(z, given=(s,), function=lambda s: s**power / 20, cov=1.0)
        ],
    )


@pytest.fixture(scope="module")
def grown():
    """Twelve runs of 20 steps."""
    return growing().sample({k: np.arange(1, 21.0)[:, None]}, runs=12, rng=3).evidence


def negative_log(states, readings):
    """Twice the negative log-density of a run's states, but for a constant."""
    moved = growth(states[:-1], np.arange(1, len(states)))
    left = states[0] - 5, states[1:] - moved, readings - states[1:] ** 3 / 20
    return left[0] ** 2 / 4 + left[1] @ left[1] + left[2] @ left[2]


def costs(posterior, evidence):
    seen = evidence[z]
    return np.array(
        [
            negative_log(mean[:, 0], reading[:, 0])
            for mean, reading in zip(posterior[s].mean, seen, strict=True)
        ]
    )


def test_costs_never_rise(grown):
    asked = {"tolerance": 0, "damping": LM}
    found = np.array(
        [costs(pgm.smooth(growing(), grown, iterations=n, **asked), grown) for n in TIMES]
    )
    assert (np.diff(found, axis=0) <= 1e-9 * found[:-1]).all()
    assert (found[-1] < 0.1 * found[0]).any()


def test_plain_iteration_raises_them(grown):
    """Else the test above would say nothing."""
    found = np.array(
        [costs(pgm.smooth(growing(), grown, iterations=n, tolerance=0), grown) for n in TIMES]
    )
    assert (np.diff(found, axis=0) > found[:-1]).any()


def test_it_ends_at_a_mode(grown):
    posterior = pgm.smooth(growing(), grown, iterations=100, tolerance=1e-3, damping=LM)
    assert posterior.status.converged.all()
    with pytest.warns(pgm.ConvergenceWarning, match="had not settled"):
        plain = pgm.smooth(growing(), grown, iterations=100, tolerance=1e-3)
    assert not plain.status.converged.all()
    for run, mean in enumerate(posterior[s].mean[..., 0]):
        reading = grown[z][run, :, 0]

        def left(states, reading=reading):
            moved = growth(states[:-1], np.arange(1, len(states)))
            return np.concatenate(
                [[(states[0] - 5) / 2], states[1:] - moved, reading - states[1:] ** 3 / 20]
            )

        due = least_squares(left, mean, xtol=1e-15, ftol=1e-15, gtol=1e-12).x
        np.testing.assert_allclose(mean, due, atol=1e-3)


def far_away():
    """z = atan s read where the tangent from the prior overshoots ever further."""
    known = pgm.NonlinearGaussianCPD(z, given=(s,), function=np.arctan, cov=1e-3)
    return pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(s, 2.0, 9.0)],
        [pgm.LinearGaussianCPD(s, {s.previous: 1.0}, cov=1.0)],
        [known],
    ), {z: pgm.sightings([[0.0]], [0])}


def test_a_filter_that_diverges_comes_home():
    model, seen = far_away()
    due = minimize_scalar(lambda a: (a - 2) ** 2 / 9 + np.arctan(a) ** 2 / 1e-3).x
    with pytest.warns(pgm.ConvergenceWarning, match="had not settled"):
        plain = pgm.filter(model, seen, steps=0, iterations=50)
    held = pgm.filter(model, seen, steps=0, iterations=50, damping=LM)
    assert held.status.converged
    assert held[s].mean[0, 0] == pytest.approx(due, abs=1e-8)
    assert not plain.status.converged
    assert abs(plain[s].mean[0, 0] - due) > 1.0
    smoothed = pgm.smooth(model, seen, steps=0, iterations=50, damping=LM)
    assert smoothed[s].mean[0, 0] == pytest.approx(due, abs=1e-8)


def test_a_fixed_share_calms_it_too():
    model, seen = far_away()
    due = minimize_scalar(lambda a: (a - 2) ** 2 / 9 + np.arctan(a) ** 2 / 1e-3).x
    held = pgm.filter(model, seen, steps=0, iterations=200, damping=0.9, tolerance=1e-7)
    assert held.status.converged
    assert held[s].mean[0, 0] == pytest.approx(due, abs=1e-6)


@pytest.fixture(scope="module")
def drive():
    """The network with known landmarks, and a drive's evidence."""
    rng = np.random.default_rng(21)
    commands = controls(rng, 15)
    states = drive_along(commands, rng)
    step = np.sort(rng.integers(0, 16, 30))
    which = rng.integers(0, 3, step.size)
    values = SIGHT.draw(states[step], LANDMARKS[which], rng)
    seen = pgm.sightings(values, step, {m: LANDMARKS[which]})
    return commands, states, step, which, values, {u: commands, SIGHT.z: seen}


@pytest.mark.parametrize("rule", [pgm.Taylor(), pgm.Cubature(), pgm.MonteCarlo(50)], ids=str)
@pytest.mark.parametrize("damping", [0.4, LM], ids=["a share", "Levenberg–Marquardt"])
def test_the_fixed_point_is_that_of_plain_iteration(drive, rule, damping):
    asked = {"lineariser": rule, "tolerance": 1e-11, "iterations": 150}
    model, seen = network(SIGHT.cpd()), drive[-1]
    plain = pgm.smooth(model, seen, **asked)
    held = pgm.smooth(model, seen, damping=damping, **asked)
    assert plain.status.converged
    assert held.status.converged
    assert_same(held[x], plain[x], 1e-8)
    assert held.log_evidence == pytest.approx(float(plain.log_evidence), abs=1e-8)


def test_a_share_is_kept_of_moments():
    """Two linearisations of one scalar, by hand."""
    model, seen = far_away()
    at = {s: [[2.0]]}
    mean, point = [], 2.0
    for _ in range(4):
        slope, value = 1 / (1 + point**2), np.arctan(point)
        gain = 9 * slope / (9 * slope**2 + 1e-3)
        mean.append(2 + gain * (0.0 - value - slope * (2 - point)))
        point = 0.75 * point + 0.25 * mean[-1]
    posterior = pgm.smooth(model, seen, steps=0, iterations=4, tolerance=0, damping=0.75, start=at)
    assert posterior[s].mean[0, 0] == pytest.approx(mean[-1], rel=1e-12)


def test_held_means_are_one_joint(grown):
    """Where means were held back, marginals, joints and beliefs tell the same ones."""
    posterior = pgm.smooth(growing(), grown, iterations=8, tolerance=0, damping=LM)
    solved = pgm.smooth(growing(), grown, iterations=8, tolerance=0)
    assert np.abs(posterior[s].mean - solved[s].mean).max() > 1.0
    mean = posterior[s].mean[..., 0]
    joint = posterior.joint(*(s.at(t) for t in (3, 0, 20, 4)))
    np.testing.assert_allclose(joint.mean, mean[:, [3, 0, 20, 4]], rtol=1e-9)
    np.testing.assert_allclose(posterior.belief(4).gaussian().mean, mean[:, [3, 4]], rtol=1e-6)


def test_the_cost_is_the_density():
    """With Taylor, the cost is twice the negative log-density: sightings, a hidden control."""
    rng = np.random.default_rng(2)
    told = pgm.Variable("c", components=("v", "omega"))
    steer = pgm.LinearGaussianCPD(u, {told: 1.0}, cov=np.diag([0.1, 0.2]))
    model = network(SIGHT.cpd()).replace(transition=[steer, drive_cpd()])
    commands = controls(rng, 6)
    step, landmarks = np.array([0, 2, 2, 5]), LANDMARKS[[0, 1, 2, 0]]
    values = rng.normal([6.0, 3.0], 1.0, (2, 4, 2))
    values[1, 2] = np.nan
    seen = {told: commands, SIGHT.z: pgm.sightings(values, step, {m: landmarks})}
    bound = bind_chain(model, seen, None)
    graph = pgm.compile(model, 6)
    plan = ChainPlan.make(graph, bound, pgm.Taylor())
    states, driven = rng.normal(size=(7, 2, 3)), rng.normal(size=(7, 2, 2))
    mean = np.zeros((7, 2, 5))
    for variable, value in ((x, states), (u, driven)):
        mean[..., positions(graph.layout.slice, [variable])] = value
    spread = np.zeros((7, 2, 5, 5)), np.zeros((6, 2, 8, 8))
    found = cost.trajectory(plan, Point(mean, *spread))
    for run in range(2):
        path, steering = states[:, run], driven[1:, run]
        due = path[0] @ np.linalg.solve(P0, path[0])
        for left in wrapped(path[1:] - DRIVE(path[:-1], steering), x.angle_mask):
            due += left @ np.linalg.solve(NOISE, left)
        due += ((steering - commands) ** 2 / [0.1, 0.2]).sum()
        for j in range(3 if run else 4):
            j = 3 if run and j == 2 else j
            value = SIGHT.function(path[step[j]], landmarks[j])
            left = wrapped(values[run, j] - value, SIGHT.z.angle_mask)
            due += left @ np.linalg.solve(SIGHT.cov, left)
        assert found[run] == pytest.approx(due, rel=1e-12)


def test_singular_noise_of_a_nonlinear_cpd_has_no_cost(drive):
    model = network(SIGHT.cpd(), transition=drive_cpd(cov=np.diag([0.1, 0.1, 0.0])))
    thrice = {"iterations": 3, "tolerance": 0}
    advice = "x.* is nonlinear and its noise is singular.*use damping=0.5"
    with pytest.raises(pgm.ModelError, match=advice) as caught:
        pgm.smooth(model, drive[-1], **thrice, damping=LM)
    assert caught.value.variable == x
    assert pgm.smooth(model, drive[-1], **thrice, damping=0.5).status.iterations == 3
    pgm.filter(model, drive[-1], **thrice, damping=LM)  # the motion is not iterated there
    exact = network(SIGHT.cpd(cov=np.diag([0.1, 0.0])))
    with pytest.raises(pgm.ModelError, match="its noise is singular"):
        pgm.filter(exact, drive[-1], **thrice, damping=LM)


def test_singular_linear_noise_is_no_obstacle():
    """Position and speed, the noise on the speed alone, ranges of a point."""
    x = pgm.Variable("x", components=("place", "speed"))
    move = np.array([[1.0, 1.0], [0.0, 1.0]])
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(x, [0.0, 1.0], np.diag([1.0, 0.0]))],
        [pgm.LinearGaussianCPD(x, {x.previous: move}, cov=np.diag([0.0, 0.01]))],
        [pgm.NonlinearGaussianCPD(z, (x,), lambda x: np.hypot(x[..., :1] - 5.0, 0.5), cov=0.01)],
    )
    evidence = model.sample(steps=10, rng=0, runs=4).evidence
    asked = {"iterations": 60, "tolerance": 1e-9}
    plain, held = (pgm.smooth(model, evidence, damping=d, **asked) for d in (0.0, LM))
    assert held.status.converged.all()
    assert plain.status.converged.all()
    assert_same(held[x], plain[x], 1e-7)


def test_indefinite_noise_has_no_cost():
    wild = pgm.Unscented(alpha=0.1, beta=-60.0)
    with pytest.raises(pgm.NumericalError, match="indefinite"):
        pgm.smooth(
            growing(2),
            {z: np.ones((4, 1)), k: np.ones((4, 1))},
            lineariser=wild,
            iterations=3,
            damping=LM,
        )


@pytest.mark.parametrize("kind", [pgm.Filtering, pgm.Smoothing])
@pytest.mark.parametrize("odd", [-0.1, 1.0, np.nan, "half", None, True, pgm.LevenbergMarquardt])
def test_odd_dampings(kind, odd):
    with pytest.raises(pgm.ModelError, match=r"or pgm.LevenbergMarquardt\(\), not"):
        kind(damping=odd)


@pytest.mark.parametrize(
    ("argument", "odd", "words"),
    [
        *(("start", odd, "start is a positive number") for odd in (0.0, -1.0, np.inf, "a", None)),
        *(("factor", odd, "factor is a number above 1") for odd in (1.0, 0.5, np.inf, "a", True)),
        *(("tries", odd, "tries must be a whole number") for odd in (0, 1.5, "a", True)),
    ],
)
def test_odd_step_controls(argument, odd, words):
    with pytest.raises(pgm.ModelError, match=words):
        pgm.LevenbergMarquardt(**{argument: odd})


@pytest.mark.parametrize("runs", [(), (3,)])
def test_steps_are_controlled_under_a_flat_prior(runs):
    """Of which the cost knows nothing; the fixed point is that of plain iterations."""
    state, read, bent = pgm.variables("state read bent")
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(state, 0.0, np.inf)],
        [pgm.LinearGaussianCPD(state, {state.previous: 1.0}, cov=1.0)],
        [
            pgm.LinearGaussianCPD(read, {state: 1.0}, cov=1.0),
            pgm.NonlinearGaussianCPD(bent, state, lambda s: s + 0.01 * s**2, cov=1.0),
        ],
    )
    evidence = {
        read: np.broadcast_to([[5.0], [6.0]], (*runs, 2, 1)),
        bent: np.broadcast_to([[5.3], [6.3]], (*runs, 2, 1)),
    }
    plain = pgm.filter(model, evidence, iterations=20)
    found = pgm.filter(model, evidence, iterations=20, damping=pgm.LevenbergMarquardt())
    assert found.status.converged.all()
    np.testing.assert_allclose(found[state].mean, plain[state].mean, rtol=1e-6)
