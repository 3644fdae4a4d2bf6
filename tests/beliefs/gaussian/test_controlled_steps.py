"""Damped steps of trees without time, against Levenberg–Marquardt on dense matrices and SciPy."""

from io import StringIO

import numpy as np
import pytest
from gaussian.maps import Map, Motions, controlled
from numpy.testing import assert_allclose
from scipy.optimize import least_squares

import pgm
from models.pose_graphs import pose_graph_network, squared_errors
from pgm.recordings import read_pose_graph
from tests.models.test_pose_graphs import residuals, written

LM = pgm.LevenbergMarquardt()
TIGHT = {"xtol": 1e-15, "ftol": 1e-15, "gtol": 1e-14}
a, b, c, s, y, z = pgm.variables("a b c s y z")


def solve(cpds, evidence, damping=LM, iterations=60, tolerance=1e-9, **options):
    schedule = pgm.Calibration(iterations, tolerance, damping)
    return pgm.infer(pgm.compile(pgm.BayesianNetwork(cpds)), evidence, schedule=schedule, **options)


def nonlinear(child, given, function, cov=0.0, **options):
    return pgm.NonlinearGaussianCPD(child, given, function, cov, **options)


# ---- maps


@pytest.mark.filterwarnings("ignore::pgm.errors.ConvergenceWarning")
@pytest.mark.parametrize("rule", [LM, pgm.LevenbergMarquardt(0.3, 4.0, 3)], ids=repr)
@pytest.mark.parametrize(("seed", "turn"), [(0, 0.3), (1, 0.8), (4, 0.8)])
def test_each_step_from_dead_reckoning_is_that_of_dense_matrices(seed, turn, rule):
    drawn = Map(seed=seed, turn=turn)
    tree = pgm.compile(drawn.network)
    costs = [np.sum(drawn.residual(drawn.reckoned()) ** 2)]
    for iterations in (1, 2, 3, 5):
        schedule = pgm.Calibration(iterations, 0.0, rule)
        found = drawn.means(pgm.infer(tree, drawn.evidence, schedule=schedule))
        due = controlled(drawn.residual, drawn.reckoned(), iterations, rule)
        assert_allclose(found, due, atol=2e-6)
        costs.append(np.sum(drawn.residual(found) ** 2))
    assert (np.diff(costs) <= 1e-9 * costs[0]).all()


@pytest.mark.parametrize("seed", [1, 2, 5])
def test_the_optimum_is_that_of_least_squares(seed):
    drawn = Map(seed=seed, turn=0.8)
    schedule = pgm.Calibration(60, 1e-9, LM)
    posterior = pgm.infer(pgm.compile(drawn.network), drawn.evidence, schedule=schedule)
    found = drawn.means(posterior)
    best = least_squares(drawn.residual, found + 1e-3, **TIGHT).x
    assert posterior.status.converged
    assert posterior.log_evidence_kind == "laplace"
    assert_allclose(found, best, atol=1e-6)


def test_steps_that_are_not_controlled_wander():
    """A flat function and a wide prior: a full step goes from one side to the other."""
    cpds = [pgm.GaussianCPD(a, 10.0, 100.0), nonlinear(z, a, np.arctan, 1e-2)]
    with pytest.warns(pgm.ConvergenceWarning, match="LevenbergMarquardt"):
        wild = solve(cpds, {z: 0.2}, damping=0.0, iterations=12)
    found = solve(cpds, {z: 0.2}, iterations=12)
    assert not wild.status.converged
    assert found.status.converged
    mean = found[a].mean[0]
    gradient = (mean - 10.0) / 100.0 - (0.2 - np.arctan(mean)) / 1e-2 / (1.0 + mean**2)
    assert gradient == pytest.approx(0.0, abs=1e-6)


def test_a_share_of_the_old_point_is_kept():
    """With a share d, an affine map of the mean is (1 − d) as fast: a geometric series."""
    cpds = [pgm.GaussianCPD(a, 1.0, 1.0), nonlinear(z, a, lambda x: x**2, 1.0)]
    x = 1.0
    for iterations in (1, 2, 3, 4):
        with pytest.warns(pgm.ConvergenceWarning) if iterations > 1 else np.errstate():
            found = solve(cpds, {z: 3.0}, 0.4, iterations, 1e-12)
        step = 1.0 + 2.0 * x * (3.0 - x**2 - 2.0 * x * (1.0 - x)) / (1.0 + 4.0 * x**2)
        assert found[a].mean[0] == pytest.approx(step, abs=1e-12)
        x = 0.4 * x + 0.6 * step


@pytest.mark.parametrize("damping", [0.4, LM], ids=["a share", "LM"])
def test_runs_that_settle_at_different_iterations_are_as_alone(damping):
    cpds = [pgm.GaussianCPD(a, 3.0, 1e4), nonlinear(z, a, np.arctan, 1e-2)]
    readings = np.array([[[1.2490457723982544]], [[1.2]], [[0.9]]])
    every = solve(cpds, {z: readings}, damping)
    assert every[a].mean.shape == (3, 1, 1)
    counts = []
    for k, reading in enumerate(readings):
        alone = solve(cpds, {z: reading[0]}, damping)
        counts.append(alone.status.iterations)
        assert_allclose(every[a].mean[k, 0], alone[a].mean, atol=1e-9)
        assert_allclose(every[a].cov[k, 0], alone[a].cov, rtol=1e-7)
        assert every.log_evidence[k, 0] == pytest.approx(alone.log_evidence, abs=1e-7)
    assert len(set(counts)) > 1


def test_a_try_outside_the_domain_has_failed():
    cpds = [pgm.GaussianCPD(a, 1.0, 9.0), nonlinear(z, a, np.log, 1e-2)]
    value = solve(cpds, {z: np.array([[-3.0], [0.1]])})[a].mean[:, 0]
    gradient = (value - 1.0) / 9.0 + (np.log(value) - [-3.0, 0.1]) / (0.01 * value)
    assert_allclose(gradient, 0.0, atol=1e-5)
    with pytest.raises(pgm.LinearisationError, match="NaN or infinite"):
        solve(cpds, {z: np.array([[-3.0], [0.1]])}, damping=0.0)


@pytest.mark.parametrize("lineariser", [pgm.GaussHermite(5), pgm.Unscented()], ids=repr)
@pytest.mark.parametrize("start", [None, {a: 2.0}])
def test_rules_of_points_end_where_plain_iterations_do(lineariser, start):
    cpds = [pgm.GaussianCPD(a, 1.5, 0.5), nonlinear(z, a, lambda x: x**2, 0.3)]
    plain, held = (
        solve(cpds, {z: 4.0}, damping, lineariser=lineariser, start=start, tolerance=1e-4)
        for damping in (0.0, LM)
    )
    assert_allclose(held[a].mean, plain[a].mean, atol=1e-3)


def test_a_network_of_twice_the_digits_is_controlled_alike():
    """So sharp that float64 keeps few digits: solved in decimals, and anchored in them."""
    sharp = [
        pgm.GaussianCPD(a, 0.0, 1e4),
        pgm.LinearGaussianCPD(b, {a: 1.0}, cov=1e-12),
        pgm.LinearGaussianCPD(y, {b: 1.0}, cov=1e10),
        nonlinear(z, b, np.arctan, 1e-2),
    ]
    found = solve(sharp, {z: 0.2, y: 3.0}, start={a: 3.0, b: 3.0})
    assert found.status.digits is not None

    def gradient(x):
        return x / 1e4 - (3.0 - x) / 1e10 - (0.2 - np.arctan(x)) / 1e-2 / (1.0 + x**2)

    assert found.status.converged
    assert gradient(found[b].mean[0]) == pytest.approx(0.0, abs=1e-6)


def test_missing_components_have_no_cost():
    p = pgm.Variable("p", components=("one", "other"))
    cpds = [
        pgm.GaussianCPD(a, 3.0, 1e4),
        nonlinear(p, a, lambda x: np.concatenate([np.arctan(x), x**3], axis=-1), 0.01 * np.eye(2)),
    ]
    alone = [pgm.GaussianCPD(a, 3.0, 1e4), nonlinear(z, a, np.arctan, 1e-2)]
    found = solve(cpds, {p: [0.2, np.nan]})
    assert_allclose(found[a].mean, solve(alone, {z: 0.2})[a].mean, rtol=1e-9)


# ---- relations without noise


@pytest.mark.parametrize("damping", [0.0, 0.4, LM], ids=["none", "a share", "LM"])
def test_a_start_need_not_obey_an_exact_sum(damping):
    cpds = [
        pgm.GaussianCPD(a, 0.0, 1.0),
        pgm.GaussianCPD(b, 0.0, 1.0),
        pgm.LinearGaussianCPD(y, {a: 1.0, b: 2.0}, cov=0.0),
        nonlinear(z, (a, b), lambda a, b: np.sin(a) + b**2, 0.04),
    ]
    found = solve(cpds, {y: 3.0, z: 2.2}, damping, start={a: 5.0, b: 5.0})
    one, other = found[a].mean[0], found[b].mean[0]
    assert one + 2.0 * other == pytest.approx(3.0, abs=1e-12)

    def residual(v):
        first = 3.0 - 2.0 * v[0]
        return np.array([first, v[0], (2.2 - np.sin(first) - v[0] ** 2) / 0.2])

    best = least_squares(residual, [other + 1e-3], **TIGHT).x[0]
    assert found.status.converged
    assert other == pytest.approx(best, abs=1e-6)


def test_a_child_without_noise_is_carried_along():
    """As a function of its parent, in a chain of three, and a linear one in between."""
    cpds = [
        pgm.GaussianCPD(a, 1.0, 4.0),
        nonlinear(b, a, np.sinh),
        pgm.LinearGaussianCPD(c, {b: 0.5}, offset=0.1, cov=0.0),
        nonlinear(s, c, lambda c: c + 0.1 * c**3),
        nonlinear(z, s, np.arctan, 1e-3),
    ]
    found = solve(cpds, {z: -0.7})
    x = found[a].mean[0]

    def through(x):
        half = 0.5 * np.sinh(x) + 0.1
        return half + 0.1 * half**3

    def residual(v):
        return np.array([(v[0] - 1.0) / 2.0, (-0.7 - np.arctan(through(v[0]))) / 1e-3**0.5])

    assert found.status.converged
    assert x == pytest.approx(least_squares(residual, [x + 1e-3], **TIGHT).x[0], abs=1e-6)
    assert_allclose(found[b].mean, np.sinh(x), atol=1e-9)
    assert_allclose(found[s].mean, through(x), atol=1e-9)
    assert found[s].cov[0, 0] > 0.0


@pytest.mark.parametrize("runs", [(), (2,)])
@pytest.mark.parametrize("begin", ["reckoned", "far", "none"])
def test_exact_motions_of_a_pose_graph_are_obeyed(begin, runs):
    graph = read_pose_graph(StringIO(written()))
    poses, landmarks = pose_graph_network(graph).reckoned()
    made = Motions.of(graph)
    if begin == "far":  # where the motions do not lead
        poses[1:] += np.random.default_rng(0).normal(0.0, 1.5, poses[1:].shape)
    start = None if begin == "none" else made.start(poses, landmarks)
    evidence = {
        v: np.broadcast_to(value, (*runs, len(value))) for v, value in made.evidence.items()
    }
    posterior = pgm.infer(
        pgm.compile(made.network), evidence, schedule=pgm.Calibration(60, 1e-9, LM), start=start
    )
    assert posterior.status.converged.all()
    found, marks = made.means(posterior)
    found, marks = (each[0] if runs else each for each in (found, marks))

    def placed(v):
        return np.concatenate([graph.poses[:1], v[:24].reshape(8, 3)]), v[24:].reshape(1, 2)

    best = least_squares(
        lambda v: residuals(graph, *placed(v)),
        np.concatenate([found[1:].ravel(), marks.ravel()]),
        **TIGHT,
    )
    assert squared_errors(graph, found, marks).sum() == pytest.approx(2.0 * best.cost, abs=1e-7)


def test_what_has_no_finite_cost_is_refused():
    root = pgm.GaussianCPD(a, 1.0, 1.0)
    for cpds, evidence, options, words in (
        ([root, nonlinear(z, a, np.sin)], {z: 0.5}, {}, "z | a.*nonlinear and its noise is sing"),
        (
            [
                *(root, nonlinear(b, a, np.sin)),
                pgm.LinearGaussianCPD(y, {b: 1.0}, cov=0.0),
                nonlinear(z, a, np.cos, 0.1),
            ],
            {y: 0.5, z: 0.6},
            {},
            "y | b.*measured without noise beside nonlinear",
        ),
        (
            [root, nonlinear(b, a, np.sin), nonlinear(z, b, np.cos, 0.1)],
            {z: 0.6},
            {"lineariser": pgm.Unscented()},
            "b | a.*nonlinear and its noise is singular",
        ),
    ):
        with pytest.raises(pgm.ModelError, match=r"damping=0\.5") as caught:
            solve(cpds, evidence, **options)
        assert all(word in str(caught.value) for word in words.split(".*"))
        assert caught.value.cpd in cpds


def test_tables_have_nothing_to_damp():
    rain = pgm.Discrete("rain", states=("no", "yes"))
    tree = pgm.compile(pgm.BayesianNetwork([pgm.TableCPD(rain, table=[0.8, 0.2])]))
    with pytest.raises(pgm.ModelError, match="nothing to iterate or damp"):
        pgm.infer(tree, {}, schedule=pgm.Calibration(damping=0.5))
    with pytest.raises(pgm.ModelError, match="damping is the share"):
        pgm.Calibration(damping=1.0)
