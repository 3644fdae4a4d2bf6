"""Hidden noise variables: integrated out before a tree is solved, and read back afterwards."""

import warnings

import numpy as np
import pytest
from gaussian.draws import Drawn, assert_dense, assert_moments, conditional, regular
from numpy.testing import assert_allclose
from textbooks import assert_log

import pgm
from pgm.beliefs.gaussian import front_stacks, prior, solving, tree


@pytest.fixture(params=["stacks", "padded", "machine"])
def way(request, monkeypatch):
    """Each way in which fronts are solved; noise is integrated out of networks of any size."""
    if request.param == "machine":
        pytest.importorskip("llvmlite")
    else:
        monkeypatch.setattr(solving, "find_spec", lambda name: None)
    monkeypatch.setattr(solving, "MANY", 1)
    monkeypatch.setattr(front_stacks, "MANY", 1 if request.param == "padded" else 10**9)
    monkeypatch.setattr(prior, "LARGE", 1)
    return request.param


@pytest.fixture
def read_back(monkeypatch):
    """How many noise variables are read back, in each solution."""
    counts, own = [], tree.read_back

    def counted(plan, noise, done, given, *, exact):
        counts.append(sum(len(pairs.clusters) for pairs in noise.pairs))
        return own(plan, noise, done, given, exact=exact)

    monkeypatch.setattr(solving, "read_back", counted)
    return counts


def noisy(drawn, seed, extra=0, share=0.7):
    """A network in which noise of some CPDs is a variable, of `extra` components more than y."""
    rng = np.random.default_rng(seed)
    cpds, values, noises = [], dict(drawn.values), []
    for k, cpd in enumerate(drawn.cpds):
        if not cpd.given or rng.random() > share or cpd.child.dimension + extra < 1:
            cpds.append(cpd)
            continue
        size = cpd.child.dimension + extra
        u = pgm.Variable(f"u{k}", tuple(f"u{k}_{part}" for part in range(size)))
        matrix = rng.normal(size=(cpd.child.dimension, size)) + np.eye(cpd.child.dimension, size)
        root = np.tril(0.3 * rng.normal(size=(size, size)), -1) + np.eye(size)
        cpds.append(pgm.GaussianCPD(u, rng.normal(size=size), root @ root.T))
        zero = np.zeros((cpd.child.dimension, cpd.child.dimension))
        given = dict(cpd.matrices) | {u: matrix}
        if rng.random() < 0.5:  # among the parents first
            given = {u: matrix} | dict(cpd.matrices)
        cpds.append(conditional(cpd.child, given, cpd.offset, zero))
        noises.append(u)
    return Drawn(tuple(cpds), values), noises


def assert_network(drawn, noises, seed):
    rng = np.random.default_rng(seed)
    graph, dense = pgm.compile(drawn.network()), drawn.dense()
    evidence = {}
    for cpd in drawn.cpds:  # by which no noise variable is certain
        own = [v for v in cpd.given if v not in noises]
        known = len(own) < len(cpd.given) and all(v in evidence for v in own)
        if cpd.child not in noises and not known and rng.random() < 0.3:
            evidence[cpd.child] = drawn.values[cpd.child]
    hidden = [v for v in drawn.variables if v not in evidence]
    posterior = pgm.infer(graph, evidence)
    assert_dense(posterior, dense, evidence, hidden, rng)
    return posterior


@pytest.mark.parametrize("seed", range(12))
@pytest.mark.parametrize("extra", [0, 1])
def test_networks_with_noise_variables(way, read_back, seed, extra):
    drawn, noises = noisy(regular(seed, 14, 3, reach=(1, 5, None)[seed % 3]), seed, extra)
    posterior = assert_network(drawn, noises, seed)
    assert read_back == [len(noises)]
    compilation = posterior.status.compilation
    assert (compilation == "compiled") == (way == "machine")


@pytest.mark.parametrize("seed", range(6))
def test_noise_of_fewer_components_leaves_relations(way, seed):
    drawn, _ = noisy(regular(seed, 10, 3), seed, -1)
    posterior, rng = pgm.infer(pgm.compile(drawn.network()), {}), np.random.default_rng(seed)
    assert_dense(posterior, drawn.dense(), {}, drawn.variables, rng)


def test_variables_that_are_no_noise_stay(way, read_back):
    """One with two children, with a parent, with evidence, or whose child has noise."""
    x, y, u, v, w, o, z, read = pgm.variables("x y u v w o z read")
    cpds = [
        *(pgm.GaussianCPD(each, 0.5, 2.0) for each in (x, u, w, o)),
        pgm.LinearGaussianCPD(v, {w: 0.5}, cov=1.0),
        pgm.LinearGaussianCPD(y, {x: 1.0, u: 2.0, v: 1.0, o: 1.0}, cov=0.0),
        pgm.LinearGaussianCPD(z, {y: 1.0, u: 1.0, w: 1.0}, cov=0.3),
        pgm.LinearGaussianCPD(read, {z: 1.0, x: 0.3}, cov=0.2),
    ]
    drawn, evidence = Drawn(tuple(cpds), {}), {o: [0.7], read: [1.0]}
    rng = np.random.default_rng(0)
    posterior = pgm.infer(pgm.compile(drawn.network()), evidence)
    assert_dense(posterior, drawn.dense(), evidence, [x, y, u, v, w, z], rng)
    assert read_back == []  # x, the only one that could be, is also a parent of the reading


def test_runs_and_missing_components(way):
    drawn, _ = noisy(regular(5, 12, 2, reach=4), 5)
    graph, dense, rng = pgm.compile(drawn.network()), drawn.dense(), np.random.default_rng(5)
    used = {v for cpd in drawn.cpds for v in cpd.given}
    ends = [v for v in drawn.variables if v not in used and v.dimension > 1]
    evidence = {v: drawn.values[v] + 0.1 * rng.normal(size=(4, v.dimension)) for v in ends}
    for v in ends:
        evidence[v][1, 0] = np.nan
    posterior = pgm.infer(graph, evidence)
    assert ends
    hidden = [v for v in drawn.variables if v not in evidence]
    for run in range(4):
        due, log_evidence = dense.given({v: value[run] for v, value in evidence.items()})
        for v in hidden:
            moments = posterior[v].mean[run], posterior[v].cov[run]
            assert_moments(*moments, *due.marginal(v))
        assert_log(posterior.log_evidence[run], log_evidence)


def moved(x, u):
    c, s = np.cos(x[..., 2]), np.sin(x[..., 2])
    east = x[..., 0] + c * u[..., 0] - s * u[..., 1]
    north = x[..., 1] + s * u[..., 0] + c * u[..., 1]
    return np.stack([east, north, x[..., 2] + u[..., 2]], axis=-1)


def drive(rng, steps):
    """A drive of which positions are read, and the motions that are its noise variables."""
    x = [pgm.Variable(f"x{k}", ("e", "n", "h"), angles=("h",)) for k in range(steps)]
    u = [pgm.Variable(f"u{k}", ("f", "l", "t"), angles=("t",)) for k in range(1, steps)]
    cpds, evidence, here = [pgm.GaussianCPD(x[0], np.zeros(3), 0.01)], {}, np.zeros(3)
    start = {x[0]: here}
    for k, motion in enumerate(u):
        told = np.array([1.0, 0.0, 0.2])
        here = moved(here, told + [0.1, 0.1, 0.05] * rng.normal(size=3))
        cpds.append(pgm.GaussianCPD(motion, told, np.square([0.1, 0.1, 0.05])))
        given = (x[k], motion)
        cpds.append(pgm.NonlinearGaussianCPD(x[k + 1], given, moved, cov=np.zeros(3)))
        z = pgm.Variable(f"z{k}", ("e", "n"))
        cpds.append(pgm.NonlinearGaussianCPD(z, x[k + 1], lambda x: x[..., :2], cov=0.04))
        evidence[z] = here[:2] + 0.2 * rng.normal(size=2)
        start |= {motion: told, x[k + 1]: here}
    return pgm.BayesianNetwork(cpds), evidence, start, x, u


@pytest.mark.parametrize("damping", [0.0, 0.3, pgm.LevenbergMarquardt()])
@pytest.mark.parametrize("rule", [pgm.Taylor(), pgm.Unscented()])
def test_iterations_end_where_exact_rows_do(way, read_back, damping, rule, monkeypatch):
    if isinstance(rule, pgm.Unscented) and isinstance(damping, pgm.LevenbergMarquardt):
        pytest.skip("relations of the rule are of no function")
    network, evidence, start, x, u = drive(np.random.default_rng(1), 12)
    schedule = pgm.Calibration(iterations=200, tolerance=1e-12, damping=damping)
    options = {"schedule": schedule, "lineariser": rule}
    if isinstance(rule, pgm.Taylor):
        options["start"] = start
    found = pgm.infer(pgm.compile(network), evidence, **options)
    assert set(read_back) == {len(u)}
    monkeypatch.setattr(solving, "MANY", 10**9)
    monkeypatch.setattr(prior, "LARGE", 10**9)
    due = pgm.infer(pgm.compile(network), evidence, **options)
    for v in (*x, *u):
        std = due[v].std
        assert (np.abs(found[v].mean - due[v].mean) <= 1e-7 * std).all()
        assert_allclose(found[v].cov, due[v].cov, rtol=0, atol=1e-7 * (std**2).max())
    joint, other = found.joint(u[3], x[9], u[0]), due.joint(u[3], x[9], u[0])
    assert_allclose(joint.cov, other.cov, rtol=0, atol=1e-7 * (other.std**2).max())
    assert found.log_evidence == pytest.approx(due.log_evidence, abs=1e-6)


def test_noise_that_is_much_sharper_than_all_else_keeps_its_digits(way):
    """A sum of many steps of 1e-9 that is read to 1e-10: u is a small difference of large ones."""
    x, u = pgm.variables([f"x{k}" for k in range(30)]), pgm.variables([f"u{k}" for k in range(29)])
    cpds = [pgm.GaussianCPD(x[0], 0.0, 1.0)]
    for k in range(29):
        cpds.append(pgm.GaussianCPD(u[k], 0.0, 1e-18))
        cpds.append(pgm.LinearGaussianCPD(x[k + 1], {x[k]: 1.0, u[k]: 1.0}, cov=0.0))
    z = pgm.Variable("z")
    cpds.append(pgm.LinearGaussianCPD(z, {x[-1]: 1.0}, cov=1.0))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        posterior = pgm.infer(pgm.compile(pgm.BayesianNetwork(cpds)), {z: 1.0})
    assert_allclose(posterior[x[3]].mean, 0.5, rtol=1e-9)
    assert_allclose(posterior[u[3]].std, 1e-9, rtol=1e-9)
    assert_allclose(posterior[u[3]].mean / 1e-9, 0.5e-9, rtol=1e-5)


def test_readings_without_noise_that_were_not_taken(way):
    x, u, y = pgm.variables("x u y")
    cpds = [*(pgm.GaussianCPD(v, 0.5, 1.0) for v in (x, u))]
    cpds.append(pgm.LinearGaussianCPD(y, {x: 1.0, u: 1.0}, cov=0.0))
    found = pgm.infer(pgm.compile(pgm.BayesianNetwork(cpds)), {y: [[np.nan], [2.0]]})
    assert_allclose(found[u].mean, [[0.5], [1.0]], atol=1e-14)
    assert_allclose(found[u].cov[:, 0, 0], [1.0, 0.5], atol=1e-14)
    alone = pgm.infer(pgm.compile(pgm.BayesianNetwork(cpds)), {y: [np.nan]})
    assert_allclose([alone[x].mean[0], alone.log_evidence], [0.5, 0.0], atol=1e-14)


def test_relations_that_are_left_keep_the_units_of_the_prior(way):
    """Noise of 1e-9 is lost beside 1e8: the relation stays, and is as exact as ever."""
    q, y = (pgm.Variable(name, ("a", "b")) for name in "qy")
    u, z = pgm.Variable("u", ("a", "b")), pgm.Variable("z")
    slope = np.array([[1.0, 0.5], [-2.0, -1.0]])  # of rank one
    cpds = [
        pgm.GaussianCPD(q, np.zeros(2), 1e16),
        pgm.GaussianCPD(u, np.zeros(2), 1e-18),
        pgm.LinearGaussianCPD(y, {q: slope, u: np.eye(2)}, cov=np.zeros(2)),
        pgm.LinearGaussianCPD(z, {q: np.array([[0.3, 0.4]])}, cov=1e14),
    ]
    found = pgm.infer(pgm.compile(pgm.BayesianNetwork(cpds)), {z: 1e8})
    row = np.array([0.3, 0.4])
    gain = 1e16 * row / (1e16 * row @ row + 1e14)
    spread = 1e16 * np.eye(2) - np.outer(gain, 1e16 * row)
    assert_moments(found[y].mean, found[y].cov, slope @ gain * 1e8, slope @ spread @ slope.T, 1e-9)


def test_contradictions_are_refused(way):
    x, u, y, z = pgm.variables("x u y z")
    cpds = [
        pgm.GaussianCPD(x, 0.0, 1.0),
        pgm.GaussianCPD(u, 0.0, 1.0),
        pgm.LinearGaussianCPD(y, {u: 1.0, x: 1.0}, cov=0.0),
        pgm.LinearGaussianCPD(z, {x: 1.0}, cov=0.0),
    ]
    graph = pgm.compile(pgm.BayesianNetwork(cpds))
    found = pgm.infer(graph, {z: 2.0, y: 2.5})
    assert_allclose([found[x].mean[0], found[u].mean[0]], [2.0, 0.5], atol=1e-12)
    assert_allclose([found[x].std[0], found[u].std[0]], [0.0, 0.0], atol=1e-12)
    with pytest.raises(pgm.NumericalError):
        pgm.infer(graph, {z: 2.0, x: 1.0})
