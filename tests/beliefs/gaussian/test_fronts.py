"""Fronts: the joined clusters of a tree, by stacks and in machine code; flat priors."""

import warnings
from fractions import Fraction

import numpy as np
import pytest
from crossed import slow_after
from gaussian.draws import Conditioned, assert_dense, assert_moments, conditional, regular
from numpy.testing import assert_allclose
from textbooks import assert_log

import pgm
from pgm.beliefs.gaussian import front_stacks, solving
from pgm.beliefs.gaussian.fronts import Fronts
from pgm.beliefs.gaussian.layout import Layout


@pytest.fixture(params=["stacks", "padded", "machine"])
def way(request, monkeypatch):
    """Each way in which fronts are solved, of networks of any size."""
    if request.param == "machine":
        pytest.importorskip("llvmlite")
    monkeypatch.setattr(solving, "MANY", 1 if request.param == "machine" else 10**9)
    monkeypatch.setattr(front_stacks, "MANY", 1 if request.param == "padded" else 10**9)
    return request.param


def structured(graph, evidence):
    """The layout and fronts of a graph, and the components of each front."""
    layout = Layout(graph, frozenset(evidence), frozenset())
    fronts = Fronts.of(layout)
    blocks = fronts.blocks
    ends = zip(blocks.starts[:-1], blocks.starts[1:], strict=True)
    return layout, fronts, [blocks.components[a:b].tolist() for a, b in ends]


@pytest.mark.parametrize("seed", range(12))
def test_fronts_hold_what_clusters_hold(seed):
    drawn = regular(seed, 25, 3, reach=6)
    graph = pgm.compile(drawn.network())
    evidence, _ = drawn.observe(np.random.default_rng(seed), 0.2 * (seed % 3))
    layout, fronts, held = structured(graph, evidence)
    for cluster, scope in enumerate(layout.scopes):
        assert set(layout.components(scope)) <= set(held[fronts.of_cluster[cluster]])
    position = {place: k for k, place in enumerate(fronts.order.tolist())}
    pivots = []
    for front, parent in enumerate(fronts.parent.tolist()):
        own = fronts.pivots[front]
        pivots += held[front][:own]
        assert (np.diff([position[place] for place in held[front]]) > 0).all()
        if parent < 0:
            assert own == len(held[front])
            continue
        assert parent > front  # children come first
        begin = fronts.separators[:front].sum()
        above = fronts.above[begin : begin + len(held[front]) - own]
        assert [held[parent][column] for column in above] == held[front][own:]
    assert pivots == fronts.order.tolist()  # each leaves once, in this order
    assert len(fronts) < len(graph)
    assert fronts.of_cluster[fronts.tops].tolist() == list(range(len(fronts)))


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("reach", [1, 5, None])  # of a chain, a band, and of any shape
def test_moments_of_a_network(way, seed, reach):
    drawn = regular(seed, 20, 3, parents=1 if reach is None else 3, reach=reach)
    graph, dense, rng = pgm.compile(drawn.network()), drawn.dense(), np.random.default_rng(seed)
    evidence, hidden = drawn.observe(rng, 0.3)
    assert_dense(pgm.infer(graph, evidence), dense, evidence, hidden, rng)


@pytest.mark.parametrize("compiled", [False, True])
def test_log_evidence_of_a_field(compiled):
    if compiled:
        pytest.importorskip("llvmlite")
    side, rng = 25, np.random.default_rng(0)
    x = [pgm.Variable(f"x{k}") for k in range(side * side)]
    cpds, precise, evidence = [pgm.GaussianCPD(x[0], 0.0, 1.0)], np.zeros((len(x), len(x))), {}
    precise[0, 0] = 1.0
    for k in range(1, len(x)):
        before = [k - side] * (k >= side) + [k - 1] * (k % side > 0)
        given = dict.fromkeys([x[j] for j in before], 0.49)
        cpds.append(pgm.LinearGaussianCPD(x[k], given=given, cov=1.0))
        row = np.zeros(len(x))
        row[k], row[before] = 1.0, -0.49
        precise += np.outer(row, row)
    read = np.arange(0, len(x), 7)
    for k in read.tolist():
        z = pgm.Variable(f"z{k}")
        cpds.append(pgm.LinearGaussianCPD(z, given={x[k]: 1.0}, cov=0.01))
        evidence[z] = rng.normal()
    posterior = pgm.infer(pgm.compile(pgm.BayesianNetwork(cpds), compiled=compiled), evidence)
    cov = np.linalg.inv(precise)[np.ix_(read, read)] + 0.01 * np.eye(len(read))
    values = np.array(list(evidence.values()))
    square = values @ np.linalg.solve(cov, values)
    due = -0.5 * (square + np.linalg.slogdet(2.0 * np.pi * cov)[1])
    assert_log(posterior.log_evidence, due)


def test_runs_that_share_matrices_and_runs_that_do_not(way):
    drawn = regular(3, 20, 2, reach=5)
    graph, rng = pgm.compile(drawn.network()), np.random.default_rng(3)
    evidence, hidden = drawn.observe(rng, 0.4)
    many = {v: x + rng.normal(size=(5, x.size)) for v, x in evidence.items()}
    childless = next(v for v in many if not any(v in cpd.given for cpd in graph.network.cpds))
    gaps = many | {childless: np.where(np.arange(5)[:, None] == 2, np.nan, many[childless])}
    posterior, with_gaps = pgm.infer(graph, many), pgm.infer(graph, gaps)
    for run in range(5):
        own = {v: x[run] for v, x in many.items()}
        if run == 2:
            one = pgm.infer(graph, {v: x for v, x in own.items() if v != childless})
        else:
            one = pgm.infer(graph, own)
            for v in hidden:
                assert_allclose(posterior[v].mean[run], one[v].mean, rtol=0, atol=1e-12)
                assert_allclose(posterior[v].cov[run], one[v].cov, rtol=0, atol=1e-12)
            assert_allclose(posterior.log_evidence[run], one.log_evidence, atol=1e-10)
        for v in hidden:
            assert_allclose(with_gaps[v].mean[run], one[v].mean, rtol=0, atol=1e-12)
            assert_allclose(with_gaps[v].cov[run], one[v].cov, rtol=0, atol=1e-12)
        assert_allclose(with_gaps.log_evidence[run], one.log_evidence, atol=1e-10)


@pytest.mark.parametrize("seed", range(6))
def test_sharp_and_wide_deviations_keep_their_digits(way, seed):
    """From 10⁻⁸ to 10⁸, held to fractions; or told."""
    rng = np.random.default_rng(seed)
    drawn = regular(seed, 8, 2, std=(1e-8, 1e-8) if seed % 2 else (0.1, 0.1))
    wider = [10.0 ** rng.choice([0, 0, 8]) for _ in drawn.cpds]
    scaled = tuple(
        conditional(cpd.child, dict(cpd.matrices), cpd.offset, cpd.cov * factor)
        for cpd, factor in zip(drawn.cpds, wider, strict=True)
    )
    drawn = type(drawn)(scaled, drawn.values)
    evidence, hidden = drawn.observe(rng, 0.4)
    posterior = pgm.infer(pgm.compile(drawn.network()), evidence)
    due = Conditioned(drawn, evidence)
    digits = posterior.status.digits
    tolerance = 1e-9 if digits is None else 10.0 ** -float(np.min(digits))
    joint = posterior.joint(*hidden)
    assert_moments(joint.mean, joint.cov, *due[hidden], tolerance, digits=1e-14)
    assert_log(posterior.log_evidence, due.log_evidence, max(tolerance, 1e-9))


def test_disconnected_parts_and_one_variable(way):
    a, b, c, z = pgm.variables("a b c z")
    parts = [pgm.GaussianCPD(v, k, k + 1.0) for k, v in enumerate((a, b, c))]
    net = pgm.BayesianNetwork([*parts, pgm.LinearGaussianCPD(z, {c: 1.0}, cov=3.0)])
    posterior = pgm.infer(pgm.compile(net), {z: 5.0})
    assert_allclose([posterior[v].mean[0] for v in (a, b, c)], [0.0, 1.0, 3.5], atol=1e-14)
    assert_allclose([posterior[v].cov[0, 0] for v in (a, b, c)], [1.0, 2.0, 1.5], atol=1e-14)
    assert posterior.log_evidence == pytest.approx(-0.5 * (np.log(12.0 * np.pi) + 9.0 / 6.0))
    one = pgm.infer(pgm.compile(pgm.BayesianNetwork([parts[0]])), {})
    assert_allclose([one[a].mean[0], one[a].cov[0, 0]], [0.0, 1.0], atol=0)


def flat_field(rng, n, prior=np.inf):
    """Unknowns with flat priors, of which sums are read; the rows, and what was read."""
    x = [pgm.Variable(f"x{k}", ("a", "b")) for k in range(n)]
    cpds, evidence, rows, right = [pgm.GaussianCPD(v, np.ones(2), prior) for v in x], {}, [], []
    for k in range(3 * n):
        i, j = rng.choice(n, 2, replace=False) if k >= n else (k, (k + 1) % n)
        one, other = rng.normal(size=(2, 2, 2))
        z, std = pgm.Variable(f"z{k}", ("c", "d")), rng.uniform(0.1, 2.0)
        value = rng.normal(size=2)
        cpds.append(pgm.LinearGaussianCPD(z, {x[i]: one, x[j]: other}, cov=std**2))
        evidence[z] = value
        row = np.zeros((2, 2 * n))
        row[:, 2 * i : 2 * i + 2], row[:, 2 * j : 2 * j + 2] = one / std, other / std
        rows.append(row)
        right.append(value / std)
    return x, pgm.BayesianNetwork(cpds), evidence, np.concatenate(rows), np.concatenate(right)


@pytest.mark.parametrize("seed", range(4))
def test_flat_priors_leave_least_squares(way, seed):
    x, network, evidence, rows, right = flat_field(np.random.default_rng(seed), 9)
    posterior = pgm.infer(pgm.compile(network), evidence)
    mean = np.linalg.lstsq(rows, right, rcond=None)[0]
    cov = np.linalg.inv(rows.T @ rows)
    assert_allclose(posterior.means(x).ravel(), mean, atol=1e-10)
    for k, v in enumerate(x):
        own = slice(2 * k, 2 * k + 2)
        assert_allclose(posterior[v].cov, cov[own, own], rtol=1e-9, atol=1e-12)
    # The integral over all unknowns of the readings' density, a flat prior being (2π)^(-1/2).
    stds = np.concatenate([np.sqrt(np.diagonal(c.cov)) for c in network.cpds if c.given])
    due = -0.5 * ((rows @ mean - right) ** 2).sum() + 0.5 * np.linalg.slogdet(cov)[1]
    due -= 0.5 * right.size * np.log(2 * np.pi) + np.log(stds).sum()
    assert posterior.log_evidence == pytest.approx(due, rel=1e-11)


def test_a_prior_flat_in_one_component(way):
    x, z = pgm.Variable("x", ("a", "b")), pgm.Variable("z")
    prior = pgm.GaussianCPD(x, [1.0, 2.0], np.diag([np.inf, 4.0]))
    net = pgm.BayesianNetwork([prior, pgm.LinearGaussianCPD(z, {x: [[1.0, 1.0]]}, cov=1.0)])
    posterior = pgm.infer(pgm.compile(net), {z: 7.0})
    assert_allclose(posterior[x].mean, [5.0, 2.0], atol=1e-13)
    assert_allclose(posterior[x].cov, [[5.0, -4.0], [-4.0, 4.0]], atol=1e-13)
    assert posterior.log_evidence == pytest.approx(-0.5 * np.log(2 * np.pi))


def test_evidence_of_a_chain_unrolled(way):
    """As of the chain itself, whose flat prior counts the same."""
    x, z = pgm.Variable("x", ("a", "b")), pgm.Variable("z")
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(x, [1.0, 2.0], np.diag([np.inf, 4.0]))],
        [pgm.LinearGaussianCPD(x, {x.previous: [[1.0, 0.5], [0.0, 1.0]]}, cov=[0.1, 0.2])],
        [pgm.LinearGaussianCPD(z, {x: [[1.0, 0.0]]}, cov=0.3)],
    )
    read = np.array([[0.3], [1.0], [2.5], [2.0]])
    due = pgm.smooth(model, {z: read})
    found = pgm.infer(
        pgm.compile(model.unroll(4)), {z.at(k + 1): value for k, value in enumerate(read)}
    )
    assert_allclose(found.log_evidence, due.log_evidence, rtol=1e-11)
    for k in range(5):
        assert_allclose(found[x.at(k)].mean, due[x.at(k)].mean, atol=1e-10)
        assert_allclose(found[x.at(k)].cov, due[x.at(k)].cov, atol=1e-10)


def test_what_flat_priors_leave_open_is_told(way):
    a, b, c, z = pgm.variables("a b c z")
    priors = [pgm.GaussianCPD(v, 0.0, np.inf) for v in (a, b, c)]
    net = pgm.BayesianNetwork(
        [
            *priors,
            pgm.LinearGaussianCPD(z, {a: 1.0, b: -2.0}, cov=1.0),
            pgm.LinearGaussianCPD(pgm.Variable("y"), {c: 1.0}, cov=1.0),
        ]
    )
    graph = pgm.compile(net)
    with pytest.raises(pgm.NumericalError, match=r"no proper belief.*0\.894 a \+ 0\.447 b open"):
        pgm.infer(graph, {z: 1.0, pgm.Variable("y"): 0.0})
    with pytest.raises(pgm.NumericalError, match=r"direction 0\.707 (c|y) \+ 0\.707 (c|y) open"):
        pgm.infer(graph, {z: 1.0, a: 0.5})


def test_an_audit_of_a_flat_prior_starts_from_what_is_linear():
    x, z = pgm.Variable("x"), pgm.Variable("z")
    net = pgm.BayesianNetwork(
        [pgm.GaussianCPD(x, 1.0, np.inf), pgm.LinearGaussianCPD(z, {x: 1.0}, cov=0.1)]
    )
    posterior = pgm.infer(pgm.compile(net), {z: 8.0})
    found = pgm.audit(posterior, rng=0)
    assert found.trusted
    assert_allclose(found.log_evidence, posterior.log_evidence, atol=1e-12)


def test_sigma_points_need_a_spread():
    x, z = pgm.Variable("x"), pgm.Variable("z")
    net = pgm.BayesianNetwork(
        [
            pgm.GaussianCPD(x, 1.0, np.inf),
            pgm.NonlinearGaussianCPD(z, given=x, function=lambda v: v**3, cov=0.1),
        ]
    )
    graph = pgm.compile(net)
    with pytest.raises(pgm.LinearisationError, match="no spread; give start="):
        pgm.infer(graph, {z: 8.0}, lineariser=pgm.Unscented())
    settled = pgm.Calibration(iterations=30)
    for options in ({}, {"lineariser": pgm.Unscented(), "start": {x: [2.0]}}):
        found = pgm.infer(graph, {z: 8.0}, schedule=settled, **options)
        assert found.status.converged.all()
        assert found[x].mean[0] == pytest.approx(2.0, abs=1e-2)


def test_steps_by_squares_end_in_rows(way, monkeypatch):
    """A solution is by rows, and equal to one of which all steps are."""
    rng = np.random.default_rng(0)
    x = [pgm.Variable(f"x{k}", ("a", "b")) for k in range(12)]
    truth = rng.normal(size=(12, 2)) * 3.0
    cpds = [pgm.GaussianCPD(v, at, 0.04) for v, at in zip(x, truth, strict=True)]
    evidence = {}
    for k in range(30):
        i, j = rng.choice(12, 2, replace=False)
        z = pgm.Variable(f"z{k}")
        cpds.append(pgm.NonlinearGaussianCPD(z, given=(x[i], x[j]), function=apart, cov=0.1**2))
        evidence[z] = apart(truth[i], truth[j]) + 0.3 * rng.normal(size=1)
    graph = pgm.compile(pgm.BayesianNetwork(cpds))
    settled = pgm.Calibration(iterations=50)
    fast = pgm.infer(graph, evidence, schedule=settled)
    assert (fast.status.compilation == "compiled") == (way == "machine")
    monkeypatch.setattr(solving, "CANCELLED", 2.0)  # which all pivots are
    slow = pgm.infer(graph, evidence, schedule=settled)
    assert fast.status.iterations > 2
    assert fast.status.iterations == slow.status.iterations
    assert_allclose(fast.means(x), slow.means(x), atol=1e-9)
    assert_allclose(fast.covs(x), slow.covs(x), atol=1e-9)
    assert_allclose(fast.log_evidence, slow.log_evidence, atol=1e-8)


def apart(one, other):
    return np.sqrt(((one - other) ** 2).sum(axis=-1, keepdims=True) + 0.1)


def solved(matrix, right):
    """The solution of A X = B in fractions, None if A is singular."""
    rows = [[*map(Fraction, a), *map(Fraction, b)] for a, b in zip(matrix, right, strict=True)]
    for k in range(len(rows)):
        pivot = max(range(k, len(rows)), key=lambda i: abs(rows[i][k]))
        if not rows[pivot][k]:
            return None
        rows[k], rows[pivot] = rows[pivot], rows[k]
        rows[k] = [x / rows[k][k] for x in rows[k]]
        for i in range(len(rows)):
            if i != k and rows[i][k]:
                rows[i] = [x - rows[i][k] * y for x, y in zip(rows[i], rows[k], strict=True)]
    return [row[len(rows) :] for row in rows]


@pytest.mark.parametrize("seed", slow_after(12, range(500)))
def test_drawn_networks_with_flat_priors_against_fractions(way, seed):
    """Of any scale and connection: right to 10⁻⁹ deviations, told, or refused where nothing is."""
    rng = np.random.default_rng([seed, 7])
    n = int(rng.integers(1, 7))
    x = [pgm.Variable(f"x{k}", ("a", "b", "c")[: rng.integers(1, 4)]) for k in range(n)]
    first = np.cumsum([0, *(v.dimension for v in x)])
    priors = rng.choice([np.inf, np.inf, 1.0, 1e16], size=n)
    cpds = [pgm.GaussianCPD(v, np.zeros(v.dimension), p) for v, p in zip(x, priors, strict=True)]
    evidence, rows, right, weights = {}, [], [], []
    for k, prior in enumerate(priors):
        if np.isfinite(prior):
            for place in range(first[k], first[k + 1]):
                rows.append(np.eye(first[-1])[place])
                right.append(0.0)
                weights.append(1 / Fraction(prior))
    for k in range(int(rng.integers(n, 3 * n + 1))):
        some = rng.choice(n, min(n, int(rng.integers(1, 4))), replace=False)
        z = pgm.Variable(f"z{k}", ("d", "e", "f")[: rng.integers(1, 4)])
        given = {x[j]: rng.integers(-8, 9, size=(z.dimension, x[j].dimension)) / 4.0 for j in some}
        variance = float(rng.choice([1.0, 1e-2, 1e-2, 1e-16]))
        cpds.append(pgm.LinearGaussianCPD(z, given, cov=variance))
        evidence[z] = rng.integers(-8, 9, size=z.dimension) / 8.0
        block = np.zeros((z.dimension, first[-1]))
        for j in some:
            block[:, first[j] : first[j + 1]] = given[x[j]]
        rows += list(block)
        right += evidence[z].tolist()
        weights += [1 / Fraction(variance)] * z.dimension
    exact = [[Fraction(value) for value in row] for row in rows]
    size = int(first[-1])
    information = [
        [sum(w * a[i] * a[j] for a, w in zip(exact, weights, strict=True)) for j in range(size)]
        for i in range(size)
    ]
    pulled = [
        sum(w * a[i] * Fraction(r) for a, w, r in zip(exact, weights, right, strict=True))
        for i in range(size)
    ]
    unit = np.eye(size)
    due = solved(information, [[p, *e] for p, e in zip(pulled, unit, strict=True)])
    graph = pgm.compile(pgm.BayesianNetwork([cpds[k] for k in rng.permutation(len(cpds))]))
    if due is None:
        with pytest.raises(pgm.NumericalError, match="no proper belief"):
            pgm.infer(graph, evidence)
        return
    mean, cov = np.array([d[0] for d in due]), np.array([d[1:] for d in due])
    known = max(float(information[k][k] * cov[k, k]) for k in range(size)) ** 0.5
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", pgm.PrecisionWarning)
        try:
            posterior = pgm.infer(graph, evidence)
        except pgm.NumericalError:
            assert known > 1e10
            return
    digits = posterior.status.digits
    tolerance = 1e-9 if digits is None else max(1e-9, 10.0 ** -float(np.min(digits)))
    joint = posterior.joint(*x)
    assert_moments(joint.mean, joint.cov, mean.astype(float), cov.astype(float), tolerance, 1e-15)


def test_machine_code_is_chosen_and_told():
    pytest.importorskip("llvmlite")
    drawn = regular(2, 12, 2, reach=4)
    network = drawn.network()
    compiled, plain = (
        pgm.infer(pgm.compile(network, compiled=choice), {}) for choice in (True, False)
    )
    assert compiled.status.compilation == "compiled"
    assert "compiled" in repr(compiled.status)
    assert plain.status.compilation == ""
    for v in drawn.variables:
        assert_allclose(compiled[v].mean, plain[v].mean, atol=1e-12)
        assert_allclose(compiled[v].cov, plain[v].cov, atol=1e-12)
    x, y, z = pgm.variables("x y z")
    cpds = [pgm.GaussianCPD(x, 0.0, 1.0), pgm.LinearGaussianCPD(y, {x: 1.0}, cov=0.0)]
    noise = pgm.compile(pgm.BayesianNetwork(cpds), compiled=True)
    assert pgm.infer(noise, {}).status.compilation == "compiled"
    twice = [*cpds, pgm.LinearGaussianCPD(z, {x: 1.0}, cov=0.0)]
    told = pgm.infer(pgm.compile(pgm.BayesianNetwork(twice), compiled=True), {}).status.compilation
    assert told == "not compiled: CPDs without noise are left to NumPy"


def test_machine_code_is_of_trees_of_gaussians():
    pytest.importorskip("llvmlite")
    coin = pgm.Discrete("coin", states=2)
    tables = pgm.BayesianNetwork([pgm.TableCPD(coin, table=[0.5, 0.5])])
    with pytest.raises(pgm.ModelError, match="compiled= is for networks of Gaussian CPDs"):
        pgm.compile(tables, compiled=True)
    a, b, c, d = pgm.variables("a b c d")
    loop = pgm.BayesianNetwork(
        [
            pgm.GaussianCPD(a, 0.0, 1.0),
            pgm.LinearGaussianCPD(b, {a: 1.0}, cov=1.0),
            pgm.LinearGaussianCPD(c, {a: 1.0}, cov=1.0),
            pgm.LinearGaussianCPD(d, {b: 1.0, c: 1.0}, cov=1.0),
        ]
    )
    with pytest.raises(pgm.GraphError, match="solved in rounds by NumPy"):
        pgm.compile(loop, method=pgm.Bethe(), compiled=True)
    assert not pgm.infer(pgm.compile(loop, compiled=False), {}).status.compilation


def test_flat_priors_of_a_graph_with_loops():
    """Means are the tree's where messages settle, which they do where all is measured."""
    x = pgm.variables("x0 x1 x2 x3")
    cpds, evidence = [pgm.GaussianCPD(v, 0.0, np.inf) for v in x], {}
    for k, v in enumerate(x):
        own, apart = pgm.variables(f"r{k} z{k}")
        cpds.append(pgm.LinearGaussianCPD(own, {v: 1.0}, cov=1.0))
        cpds.append(pgm.LinearGaussianCPD(apart, {v: 1.0, x[(k + 1) % 4]: -1.0}, cov=1.0))
        evidence |= {own: float(k), apart: 0.5 * k}
    network = pgm.BayesianNetwork(cpds)
    graph, often = pgm.compile(network, method=pgm.Bethe()), pgm.Flooding(iterations=300)
    due = pgm.infer(pgm.compile(network), evidence)
    found = pgm.infer(graph, evidence, schedule=often)
    assert found.status.converged.all()
    assert_allclose(found.means(x), due.means(x), atol=1e-8)
    apart = {v: value for v, value in evidence.items() if v.name.startswith("z")}
    with pytest.warns(pgm.ConvergenceWarning):
        pgm.infer(graph, apart, schedule=often)
