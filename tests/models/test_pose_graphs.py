"""Pose graphs as networks, beside least squares by SciPy over the same edges."""

from io import StringIO

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.linalg import qr, solve_triangular
from scipy.linalg.lapack import dtrtri
from scipy.optimize import least_squares

import pgm
from experiments.pose_graphs.given import find
from models import motion
from models.pose_graphs import pose_graph_network, squared_errors
from pgm.recordings import read_pose_graph
from tests.models.test_motion import central_jacobian

CALIBRATION = pgm.Calibration(iterations=30, tolerance=1e-9)


def written(fixed=(), lost=()):
    """A square driven twice, some edges told backwards, a landmark seen three times."""
    rng = np.random.default_rng(3)
    turn = np.pi / 2
    true = [np.array([0.3, -0.2, 2.9])]
    for _ in range(8):
        true.append(motion.increment(true[-1], np.array([2.0, 0.1, turn])))
    true, mark = np.array(true), np.array([1.0, 1.5])
    lines = []
    for k, pose in enumerate(true):
        east, north, heading = pose + rng.normal(0.0, 0.2, 3)
        heading = (heading + np.pi) % (2.0 * np.pi) - np.pi
        lines.append(f"VERTEX_SE2 {10 * k} {east} {north} {heading}")
    lines.append(f"VERTEX_XY 7 {mark[0]} {mark[1]}")
    ends = [(k, k + 1) if k != 3 else (4, 3) for k in range(8)] + [(0, 4), (5, 1), (8, 0), (2, 6)]
    for one, other in ends:
        if (one, other) in lost:
            continue
        told = motion.relative(true[one], true[other]) + rng.normal(0.0, [0.1, 0.1, 0.05])
        told[2] = (told[2] + np.pi) % (2.0 * np.pi) - np.pi
        numbers = " ".join(map(str, told))
        lines.append(f"EDGE_SE2 {10 * one} {10 * other} {numbers} 120 30 5 60 -8 400")
    for k in (1, 2, 6):
        forward, left = motion.relative(true[k], mark) + rng.normal(0.0, 0.1, 2)
        lines.append(f"EDGE_SE2_XY {10 * k} 7 {forward} {left} 100 20 50")
    lines += [f"FIX {10 * k}" for k in fixed]
    return "\n".join(lines) + "\n"


def residuals(graph, poses, landmarks):
    """Weighted residuals of g2o: what is measured, and from there what is true."""
    found = []
    for edges, ends in ((graph.edges, poses), (graph.sightings, landmarks)):
        for one, other, told, information in zip(
            edges.first, edges.second, edges.motions, edges.information, strict=True
        ):
            c, s = np.cos(poses[one, 2]), np.sin(poses[one, 2])
            back = np.array([[c, s], [-s, c]])
            away = back @ (ends[other, :2] - poses[one, :2]) - told[:2]
            if len(told) == 3:
                c, s = np.cos(told[2]), np.sin(told[2])
                turn = ends[other, 2] - poses[one, 2] - told[2]
                turn = (turn + np.pi) % (2.0 * np.pi) - np.pi
                away = np.append(np.array([[c, s], [-s, c]]) @ away, turn)
            found.append(np.linalg.cholesky(information).T @ away)
    return np.concatenate(found)


@pytest.mark.parametrize("fixed", [(), (3, 7)])
@pytest.mark.parametrize("begin", ["file", "tree"])
def test_the_mode_is_that_of_least_squares(fixed, begin):
    graph = read_pose_graph(StringIO(written(fixed)))
    made = pose_graph_network(graph)
    held = list(fixed) or [0]
    free = np.setdiff1d(np.arange(9), held)

    def placed(v):
        poses = graph.poses.copy()
        poses[free] = v[:-2].reshape(-1, 3)
        return poses, v[None, -2:]

    first = np.append(graph.poses[free].ravel(), graph.landmarks[0])
    due = least_squares(lambda v: residuals(graph, *placed(v)), first, xtol=1e-15, ftol=1e-15)
    at = (graph.poses, graph.landmarks) if begin == "file" else made.reckoned()
    posterior = pgm.infer(
        pgm.compile(made.network), made.evidence, schedule=CALIBRATION, start=made.start(*at)
    )
    assert posterior.status.converged.all()
    poses, landmarks = made.means(posterior)
    away = poses - placed(due.x)[0]
    away[:, 2] = (away[:, 2] + np.pi) % (2.0 * np.pi) - np.pi
    assert_allclose(away, 0.0, atol=1e-7)
    assert_allclose(landmarks, placed(due.x)[1], atol=1e-7)
    errors = squared_errors(graph, poses, landmarks)
    assert errors.size == len(graph.edges) + 3
    assert errors.sum() == pytest.approx(2.0 * due.cost, rel=1e-9)
    # Linearised at the mode, the posterior has the inverse of the normal matrix there.
    cov = np.linalg.inv(due.jac.T @ due.jac)
    covs, _ = made.covs(posterior)
    for k, row in enumerate(free):
        own = cov[3 * k : 3 * k + 3, 3 * k : 3 * k + 3]
        assert_allclose(posterior[made.poses[row]].cov, own, rtol=1e-4, atol=1e-8)
        assert_allclose(covs[row], posterior[made.poses[row]].cov, atol=0.0)
    assert_allclose(posterior[made.landmarks[0]].cov, cov[-2:, -2:], rtol=1e-4)
    assert not covs[held].any()


def directed(graph, made):
    """The same graph in CPDs: flat priors of all vertices, and edges that are measured."""
    vertices = [*made.poses, *made.landmarks]
    cpds = [pgm.GaussianCPD(v, np.zeros(v.dimension), np.inf) for v in vertices]
    evidence = dict(made.evidence)
    for k, factor in enumerate((*made.edges, *made.sightings)):
        kind = ("forward", "left", "turn")[: len(factor.value)]
        z = pgm.Variable(f"z{k}", kind, angles=kind[2:])
        cpds.append(
            pgm.NonlinearGaussianCPD(
                z, factor.scope, motion.relative, factor.cov, noise=factor.noise
            )
        )
        evidence[z] = factor.value
    return pgm.BayesianNetwork(cpds), evidence


@pytest.mark.parametrize("noise", [None, pgm.Cauchy(2.0)], ids=["Gaussian", "robust"])
@pytest.mark.parametrize("fixed", [(), (3, 7)])
def test_the_posterior_is_that_of_measured_flat_priors(noise, fixed):
    """Residual factors alone, with the derivatives given, and CPDs whose own are traced."""
    graph = read_pose_graph(StringIO(written(fixed)))
    made = pose_graph_network(graph, noise)
    assert all(isinstance(f, pgm.NonlinearGaussianFactor) for f in made.network.factors)
    assert len(made.network.factors) == len(graph.edges) + len(graph.sightings)
    schedule = pgm.Calibration(iterations=200, tolerance=1e-12)
    found, due = (
        pgm.infer(pgm.compile(network), evidence, schedule=schedule, start=made.start())
        for network, evidence in ((made.network, made.evidence), directed(graph, made))
    )
    for one, other in zip(made.means(found), made.means(due), strict=True):
        assert_allclose(one, other, rtol=0.0, atol=1e-9)
    for one, other in zip(made.covs(found), made.covs(due), strict=True):
        assert_allclose(one, other, rtol=0.0, atol=1e-9)
    weights = {v.name: weight for v, weight in due.weights.items()}
    read = [weights[f"z{k}"] for k in range(len(made.network.factors))]
    assert_allclose(made.weights(found), read, atol=1e-8)
    assert (min(read) < 0.95) == (noise is not None)


def test_what_edges_leave_open_is_refused_until_a_pose_is_held():
    """By evidence, which knows it exactly, or by an anchor: a factor of that pose alone."""
    graph = read_pose_graph(StringIO(written()))
    made = pose_graph_network(graph)
    first, cov = made.poses[0], np.diag([0.04, 0.09, 0.01])
    start = made.start() | {first: graph.poses[0]}
    with pytest.raises(pgm.NumericalError, match=r"has no proper belief .* direction .* open"):
        pgm.infer(pgm.compile(made.network), {}, schedule=CALIBRATION, start=start)
    anchor = pgm.NonlinearGaussianFactor(
        first, lambda x: x, cov, value=graph.poses[0], angles=(False, False, True)
    )
    network = pgm.MarkovNetwork([*made.network.factors, anchor])
    posterior = pgm.infer(pgm.compile(network), {}, schedule=CALIBRATION, start=start)
    held = pgm.infer(
        pgm.compile(made.network), made.evidence, schedule=CALIBRATION, start=made.start()
    )
    # Edges say nothing of the first pose, whose marginal is the anchor, and all else hangs on it.
    assert_allclose(posterior[first].mean, graph.poses[0], atol=1e-9)
    assert_allclose(posterior[first].cov, cov, rtol=1e-9, atol=1e-12)
    joint = posterior.joint(first, made.poses[4])
    slope = joint.cov[3:, :3] @ np.linalg.inv(cov)
    given = joint.cov[3:, 3:] - slope @ joint.cov[:3, 3:]
    assert_allclose(given, held[made.poses[4]].cov, rtol=1e-6, atol=1e-10)
    poses = made.poses[1:]
    assert_allclose(posterior.means(poses), held.means(poses), atol=1e-7)


def test_edges_that_may_be_wrong():
    """By default all but the first edge between each pose and the next."""
    edge = "EDGE_SE2 {} {} 1 0 0 9 0 0 9 0 9"
    lines = [f"VERTEX_SE2 {k} {k} 0 0" for k in range(3)] + ["VERTEX_XY 7 1 1"]
    lines += [edge.format(*ends) for ends in ((0, 1), (1, 0), (2, 1), (0, 2))]
    graph = read_pose_graph(StringIO("\n".join([*lines, "EDGE_SE2_XY 0 7 1 1 9 0 9"])))
    noise = pgm.Huber(1.345)

    def robust(*asked):
        made = pose_graph_network(graph, *asked)
        return [f.noise is not None for f in (*made.edges, *made.sightings)]

    assert robust() == [False] * 5
    assert robust(noise) == [False, True, False, True, True]
    assert robust(noise, [0, 4]) == [True, False, False, False, True]
    assert robust(noise, []) == [False] * 5
    assert robust(noise, range(5)) == [True] * 5
    for asked in ([5], [-1], [0.5], [[0]], [True]):
        with pytest.raises(pgm.EvidenceError, match=r"doubted are rows of the edges, .* 0 to 4"):
            pose_graph_network(graph, noise, asked)
    with pytest.raises(pgm.EvidenceError, match="robust noise=, and none is given"):
        pose_graph_network(graph, None, [0])


def test_a_tree_is_followed_without_a_residual():
    tree = "\n".join(
        line for line in written().split("\n") if not line.endswith("400") or "EDGE" not in line
    )
    steps = [f"EDGE_SE2 {10 * k + 10} {10 * k} 1 2 0.3 9 0 0 9 0 9" for k in range(8)]
    graph = read_pose_graph(StringIO("\n".join([tree, *steps])))
    made = pose_graph_network(graph)
    errors = squared_errors(graph, *made.reckoned())
    assert_allclose(errors[:8], 0.0, atol=1e-18)


@pytest.mark.parametrize(
    ("name", "other", "size"),
    [("relative", "other", 2), ("relative", "other", 3), ("place", "sight", 2)],
)
def test_derivatives_of_sights(name, other, size):
    rng = np.random.default_rng(0)
    x, y = rng.normal(size=(5, 3)), rng.normal(size=(5, size))
    function = getattr(motion, name)
    by_state, by_other = (getattr(motion, f"{name}_by_{of}") for of in ("state", other))
    assert_allclose(by_state(x, y), central_jacobian(lambda s: function(s, y), x), atol=1e-9)
    assert_allclose(by_other(x, y), central_jacobian(lambda p: function(x, p), y), atol=1e-9)


def test_motions_there_and_back():
    x, u = np.random.default_rng(0).normal(size=(2, 5, 3))
    assert_allclose(motion.retreat(motion.increment(x, u), u), x, atol=1e-12)
    assert_allclose(motion.increment(x, motion.relative(x, u)), u, atol=1e-12)


def test_refusals():
    with pytest.raises(pgm.EvidenceError, match="hang on no edge that leads to a pose that is h"):
        pose_graph_network(read_pose_graph(StringIO("VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1 0 0\n")))
    two = "VERTEX_SE2 4 0 0 0\nVERTEX_SE2 5 1 0 0\nEDGE_SE2 4 5 1 0 0 9 0 0 9 0 "
    with pytest.raises(pgm.EvidenceError, match=r"edge from 4 to 5 has .* not positive definite"):
        pose_graph_network(read_pose_graph(StringIO(two + "0\n")))
    with pytest.raises(pgm.EvidenceError, match="landmark 8 is seen from no pose"):
        pose_graph_network(read_pose_graph(StringIO(two + "9\nVERTEX_XY 8 1 1\n")))


@pytest.mark.slow
def test_marginals_of_manhattan_are_those_of_dense_rows():
    """3,500 poses: one dense triangle of all rows, by LAPACK, linearised where the network was."""
    path = find("m3500")
    if path is None:
        pytest.skip("the pose graph m3500 is not here; PGM_DATA may name its folder's folder")
    graph = read_pose_graph(path)
    made = pose_graph_network(graph)
    every = pgm.Calibration(iterations=30, tolerance=0.0)
    start = made.start(graph.poses, graph.landmarks)
    posterior = pgm.infer(pgm.compile(made.network), made.evidence, schedule=every, start=start)
    poses, _ = made.means(posterior)
    assert squared_errors(graph, poses, graph.landmarks).sum() == pytest.approx(3549.0368, abs=1e-4)
    place = {row: 3 * k for k, row in enumerate(made.free)}
    edges, at = graph.edges, linearised_at(made, posterior)
    matrix, right = np.zeros((3 * len(edges), 3 * len(place))), np.zeros(3 * len(edges))
    one, other = at[edges.first], at[edges.second]
    slopes = motion.relative_by_state(one, other), motion.relative_by_other(one, other)
    away = edges.motions - motion.relative(one, other)
    away[:, 2] = (away[:, 2] + np.pi) % (2.0 * np.pi) - np.pi
    for k in range(len(edges)):
        lower = np.linalg.cholesky(made.edges[k].cov)
        own = slice(3 * k, 3 * k + 3)
        right[own] = solve_triangular(lower, away[k], lower=True)
        for row, slope in zip((edges.first[k], edges.second[k]), slopes, strict=True):
            if row in place:
                columns = slice(place[row], place[row] + 3)
                matrix[own, columns] = solve_triangular(lower, slope[k], lower=True)
    size = matrix.shape[1]
    triangle = qr(np.column_stack([matrix, right]), mode="r", overwrite_a=True, check_finite=False)[
        0
    ]
    step = solve_triangular(triangle[:size, :size], triangle[:size, size])
    inverse = dtrtri(triangle[:size, :size])[0]
    covs, _ = made.covs(posterior)
    for row, first in place.items():
        rows = inverse[first : first + 3]
        due = rows @ rows.T
        std = np.sqrt(np.diagonal(due))
        assert (np.abs(covs[row] - due) <= 1e-10 * np.outer(std, std)).all()
        assert (np.abs(at[row] + step[first : first + 3] - poses[row]) <= 1e-10 * std).all()


def linearised_at(made, posterior):
    """The poses where the measurements were linearised last."""
    model = posterior._outcome._model
    found = np.zeros(model.layout.size)
    for group, point in zip(model.layout.groups, model.points, strict=True):
        found[group.parents] = point.mean[:, 0]
    poses = made.graph.poses.copy()
    poses[made.free] = [found[model.layout.places[made.poses[row]]] for row in made.free]
    return poses
