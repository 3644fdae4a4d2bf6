"""Gaussian networks on graphs with loops: means are exact wherever the messages converge.

For each variable its clusters and sepsets form a tree; a fixed point of the messages then has the
exact means, or with Taylor those of a stationary point of the MAP cost. Variances are approximate.
"""

from itertools import pairwise

import numpy as np
import pytest
from crossed import crossed, slow_after
from dense import linear_joint
from gaussian.loops import (
    bent,
    draw_evidence,
    errors,
    mixture_network,
    paths,
    random_network,
    solve,
    steepest,
)

import pgm
from pgm.beliefs.gaussian.layout import Layout
from pgm.beliefs.gaussian.model import Model
from pgm.evidence.static import bind_values

KINDS = (pgm.Flooding, pgm.Sequential, pgm.Residual)
kinds = pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
dampings = pytest.mark.parametrize("damping", [0.0, 0.7])
TOLERANCE = 1e-10


def observed(net, rng, share=0.35):
    found = [v for v in net.variables if rng.random() < share]
    return (found or [net.variables[-1]])[: len(net.variables) - 1]


def case(seed):
    """Draw a network, evidence, and a graph of it with loops, made by Bethe or by hand."""
    rng = np.random.default_rng(seed)
    while True:
        strength = seed % 5
        if strength < 4:
            sizes = rng.integers(1, 3, rng.integers(5, 10))
            gain, noise = [(1.0, 1.0), (0.5, 1e-3), (2.0, 0.1), (1.0, 0.1)][strength]
            net = random_network(rng, sizes, gain=gain, noise=noise)
            seen = observed(net, rng)
        else:
            spread, noise = [(0.1, 1e-4), (1.0, 0.1)][seed // 5 % 2]
            net, seen = mixture_network(rng, int(rng.integers(3, 6)), 3, spread, noise)
        graph = paths(net, rng) if seed // 2 % 2 else pgm.compile(net, method=pgm.Bethe())
        if not graph.is_tree:
            graph.check()
            return net, graph, draw_evidence(net, rng, seen)


def sweep(seeds, kind, damping, most):
    """Return the errors of runs that have converged, and what those that have not say."""
    exact, open_ = [], []
    for seed in seeds:
        net, graph, evidence = case(seed)
        schedule = kind(damping=damping, iterations=most)
        posterior = pgm.infer(graph, evidence, schedule=schedule)
        if posterior.status.converged:
            exact.append(errors(posterior, solve(net, evidence)))
        else:
            open_.append(posterior.status)
    return exact, open_


# Rounds are few here, and some networks are drawn whose messages diverge.
unsettled = pytest.mark.filterwarnings("ignore::pgm.ConvergenceWarning")
MOST = {pgm.Flooding: 150, pgm.Sequential: 150, pgm.Residual: 40}


@unsettled
@crossed(("kind", "damping"), KINDS, [0.0, 0.7])
def test_means_are_exact_wherever_messages_converge(kind, damping):
    """Each sweep is over graphs of its own; longer ones are below."""
    first = 1000 * KINDS.index(kind) + int(100 * damping)
    exact, open_ = sweep(range(first, first + 3), kind, damping, MOST[kind])
    assert exact, "a sweep in which nothing converges tests nothing"
    assert max(exact) <= 1e-6
    for status in open_:
        assert status.residuals[-1] > TOLERANCE
        diverged = status.residuals[-1] > 1e4 * status.residuals.min()
        assert diverged or status.iterations == MOST[kind]


@pytest.mark.slow
@unsettled
@kinds
@dampings
def test_means_are_exact_wherever_messages_converge_at_length(kind, damping):
    exact, open_ = sweep(range(5000, 5040), kind, damping, 5 * MOST[kind])
    assert len(exact) >= 20
    assert len(open_) >= 1
    assert max(exact) <= 1e-6


@unsettled
def test_at_least_half_converge_and_some_do_not():
    exact, open_ = sweep(range(20), pgm.Flooding, 0.0, 60)
    assert 10 <= len(exact) < 20
    assert max(exact) <= 1e-6
    assert all(status.residuals[-1] > TOLERANCE for status in open_)


@unsettled
def test_a_network_whose_messages_diverge():
    """Six sources in four precise readings, all alike: the loops amplify."""
    rng = np.random.default_rng(39)
    net, seen = mixture_network(rng, 6, 4, 0.5, 1e-4)
    graph = pgm.compile(net, method=pgm.Bethe())
    evidence = draw_evidence(net, rng, seen)
    # Far beyond, numbers would overflow: the run is stopped before, and says so.
    for schedule in (pgm.Flooding(iterations=5000), pgm.Sequential(iterations=5000)):
        found = pgm.infer(graph, evidence, schedule=schedule)
        residuals = found.status.residuals
        assert not found.status.converged
        assert found.status.iterations < 300
        assert residuals[-1] > 1e4 * residuals.min()
        assert residuals[-2] <= 1e4 * residuals.min()
        assert np.isfinite(found[net.variables[0]].mean).all()
    # Damping brings it to the exact means.
    damped = pgm.infer(graph, evidence, schedule=pgm.Sequential(damping=0.3))
    assert damped.status.converged
    assert errors(damped, solve(net, evidence)) <= 1e-6


@crossed(("kind", "damping", "method"), KINDS, [0.7, 0.0], [pgm.JunctionTree(), pgm.Bethe()])
def test_on_trees_every_schedule_is_exact(kind, damping, method):
    """A tree of variables: its Bethe graph is a tree of clusters as well."""
    rng = np.random.default_rng(4)
    net = random_network(rng, rng.integers(1, 3, 5), most=1)
    graph = pgm.compile(net, method=method)
    assert graph.is_tree
    evidence = draw_evidence(net, rng, observed(net, rng))
    due = pgm.infer(pgm.compile(net), evidence)
    tolerance = 1e-13 if damping else TOLERANCE
    found = pgm.infer(graph, evidence, schedule=kind(tolerance=tolerance, damping=damping))
    assert found.status.converged
    solved = solve(net, evidence)
    assert errors(found, solved) <= 1e-9
    for v in solved.places:
        np.testing.assert_allclose(found[v].cov, due[v].cov, atol=1e-9 * due[v].cov.max())
        np.testing.assert_allclose(found[v].cov, solved.cov(v), atol=1e-9 * due[v].cov.max())
    assert found.log_evidence == pytest.approx(due.log_evidence, rel=1e-9)
    assert found.log_evidence_kind == "exact"


def test_flooding_crosses_a_tree_in_its_diameter():
    v = [pgm.Variable(f"v{k}") for k in range(12)]
    cpds = [pgm.GaussianCPD(v[0], 0.0, 1.0)]
    cpds += [pgm.LinearGaussianCPD(b, {a: 0.9}, cov=0.5) for a, b in pairwise(v)]
    graph = pgm.ClusterGraph(pgm.BayesianNetwork(cpds), list(pairwise(v)))
    found = pgm.infer(graph, {v[0]: 1.0, v[-1]: -1.0}, schedule=pgm.Flooding())
    diameter = len(graph) - 1
    assert diameter <= found.status.iterations <= diameter + 2
    swept = pgm.infer(graph, {v[0]: 1.0, v[-1]: -1.0}, schedule=pgm.Sequential())
    assert swept.status.iterations <= 3


@kinds
def test_a_graph_without_edges(kind):
    a, b = pgm.variables("a b")
    net = pgm.BayesianNetwork(
        [pgm.GaussianCPD(a, 1.0, 1.0), pgm.NonlinearGaussianCPD(b, a, np.sin, 0.01)]
    )
    graph = pgm.ClusterGraph(net, [{a, b}])
    found = pgm.infer(graph, {b: 0.5}, schedule=kind())
    due = pgm.infer(graph, {b: 0.5}, schedule=pgm.Calibration(50, 1e-12))
    assert found.status.converged
    np.testing.assert_allclose(found[a].mean, due[a].mean, atol=1e-9)


def test_variances_and_evidence_of_loops_are_approximate():
    """Four variables in a ring: variances too small, the Bethe value of the evidence another."""
    a, b, c, d = pgm.variables("a b c d")
    net = pgm.BayesianNetwork(
        [
            pgm.GaussianCPD(a, 0.0, 1.0),
            pgm.LinearGaussianCPD(b, {a: 1.0}, cov=0.5),
            pgm.LinearGaussianCPD(c, {a: 1.0}, cov=0.5),
            pgm.LinearGaussianCPD(d, {b: 1.0, c: 1.0}, cov=0.5),
        ]
    )
    graph = pgm.compile(net, method=pgm.Bethe())
    found = pgm.infer(graph, {d: 3.0}, schedule=pgm.Flooding())
    due = pgm.infer(pgm.compile(net), {d: 3.0})
    assert found.status.converged
    for v in (a, b, c):
        np.testing.assert_allclose(found[v].mean, due[v].mean, atol=1e-9)
        assert abs(found[v].cov - due[v].cov).max() > 0.01 * due[v].cov.max()
    assert found.log_evidence_kind == "bethe"
    assert due.log_evidence_kind == "exact"
    assert abs(found.log_evidence - due.log_evidence) > 0.01


def test_the_bethe_value_is_that_of_the_beliefs():
    """Σ ln of the clusters' integrals less that of the sepsets', of canonical forms."""
    _, graph, evidence = case(3)
    found = pgm.infer(graph, evidence, schedule=pgm.Sequential(iterations=1000))
    assert found.status.converged
    total = sum(found.belief(k).log_integral for k in range(len(graph)))
    for (i, j), _ in graph.sepsets.items():
        both = found.message(i, j) * found.message(j, i)
        total -= both.log_integral if both.scope else both.g
    assert found.log_evidence == pytest.approx(total, rel=1e-8)


# ---- runs


def scaled(net, rng, runs):
    """Draw evidence of runs that are from nothing to far beside the prior."""
    scale = np.array([0.0, 1e-6, 1e-3, 1.0, 1e3, 1e5])[:runs, None]
    return {v: scale * rng.normal(size=v.dimension) for v in observed(net, rng)}


def signed(rng):
    """Draw a network of plain sums and differences: many messages are equal but for rounding."""
    sizes = rng.integers(1, 3, rng.integers(4, 9))
    net = random_network(rng, sizes)
    cpds = []
    for cpd in net.cpds:
        unit = np.eye(cpd.child.dimension)
        if cpd.given:
            given = {v: np.sign(a) for v, a in cpd.matrices.items()}
            cpds.append(pgm.LinearGaussianCPD(cpd.child, given, cov=unit))
        else:
            cpds.append(pgm.GaussianCPD(cpd.child, np.zeros(cpd.child.dimension), unit))
    return pgm.BayesianNetwork(cpds)


BATCHES = {pgm.Flooding: range(20), pgm.Sequential: range(40, 70), pgm.Residual: range(26, 30)}


@unsettled
@kinds
def test_batches_whose_runs_converge_at_different_times(kind):
    """Runs share matrices: the right sides of the first to converge must go on fitting them."""
    spread = 0
    for seed in BATCHES[kind]:
        rng = np.random.default_rng(seed)
        net = signed(rng)
        graph = paths(net, rng) if seed % 2 else pgm.compile(net, method=pgm.Bethe())
        if graph.is_tree:
            continue
        evidence = scaled(net, rng, 6)
        found = pgm.infer(graph, evidence, schedule=kind(iterations=60))
        off = errors(found, solve(net, evidence))
        assert off[found.status.converged].max(initial=0.0) <= 1e-6
        spread += len(set((found.status.residuals > TOLERANCE).sum(axis=0).tolist())) > 1
    assert spread >= 3 or kind is pgm.Residual


@pytest.mark.parametrize("kind", [pgm.Flooding, pgm.Sequential])
def test_a_batch_is_its_single_runs(kind):
    """Linear, to the tolerance of the matrices they share; nonlinear, to rounding."""
    for seed, bend, close in ((1, 0.0, 1e-8), (2, 0.4, 1e-12)):
        rng = np.random.default_rng(seed)
        net = random_network(rng, [1, 2, 1, 2, 1, 1])
        net = bent(net, bend) if bend else net
        sample = net.sample((2, 3), rng=rng)
        evidence = {v: sample[v] for v in (net.variables[-1], net.variables[3])}
        graph = pgm.compile(net, method=pgm.Bethe())
        schedule = kind(iterations=400)
        found = pgm.infer(graph, evidence, schedule=schedule)
        assert found.status.converged.shape == (2, 3)
        assert found.status.residuals.shape == (found.status.iterations, 2, 3)
        for run in np.ndindex(2, 3):
            alone = pgm.infer(graph, {v: x[run] for v, x in evidence.items()}, schedule=schedule)
            assert alone.status.converged == found.status.converged[run]
            for v in net.variables:
                if v in evidence:
                    continue
                np.testing.assert_allclose(
                    found[v].mean[run], alone[v].mean, atol=close * alone[v].std.max(), rtol=close
                )
                np.testing.assert_allclose(found[v].cov[run], alone[v].cov, rtol=1e-8, atol=1e-12)


@unsettled
def test_a_run_that_diverges_spoils_no_other():
    """Its beliefs leave the domain of a function, at which they are not linearised."""
    rng = np.random.default_rng(1)
    x, z = pgm.variables("x0 x1 x2 x3"), pgm.variables("z0 z1 z2")
    w = pgm.Variable("w")
    cpds = [pgm.GaussianCPD(v, 0.0, 1.0) for v in x]
    cpds += [pgm.LinearGaussianCPD(s, {v: 1 + 0.1 * rng.normal() for v in x}, cov=1e-4) for s in z]
    cpds += [pgm.NonlinearGaussianCPD(w, x[0], lambda a: np.log(5.0 + a), 0.01)]
    net = pgm.BayesianNetwork(cpds)
    graph = pgm.compile(net, method=pgm.Bethe())
    evidence = {s: [[0.0], [20.0]] for s in z} | {w: np.full((2, 1), np.log(5.0))}
    found = pgm.infer(graph, evidence, schedule=pgm.Sequential())
    assert found.status.converged.tolist() == [True, False]
    alone = pgm.infer(
        graph, {v: np.array(e)[0] for v, e in evidence.items()}, schedule=pgm.Sequential()
    )
    np.testing.assert_allclose(found[x[0]].mean[0], alone[x[0]].mean, atol=1e-12)


# ---- nonlinear CPDs


def bent_case(seed):
    rng = np.random.default_rng(seed)
    while True:
        sizes = rng.integers(1, 3, rng.integers(4, 7))
        net = bent(random_network(rng, sizes, noise=[1.0, 0.1][seed % 2]), 0.4)
        graph = paths(net, rng) if seed // 2 % 2 else pgm.compile(net, method=pgm.Bethe())
        if not graph.is_tree:
            return net, graph, draw_evidence(net, rng, observed(net, rng))


@unsettled
@pytest.mark.parametrize(
    ("kind", "damping"),
    slow_after(
        2,
        [(pgm.Flooding, 0.3), (pgm.Sequential, 0.0), (pgm.Flooding, 0.0), (pgm.Sequential, 0.7)],
    ),
)
def test_relinearised_means_are_a_map(kind, damping):
    """At them the cost is level, and a junction tree iterated from there stays."""
    converged = 0
    for seed in range(3):
        net, graph, evidence = bent_case(seed)
        found = pgm.infer(graph, evidence, schedule=kind(damping=damping, iterations=300))
        assert bool(found.status.converged) == (found.status.residuals[-1] <= TOLERANCE)
        if not found.status.converged:
            continue
        converged += 1
        assert steepest(net, evidence, found) <= 1e-7
        hidden = [v for v in net.variables if v not in evidence]
        tree = pgm.infer(
            pgm.compile(net),
            evidence,
            schedule=pgm.Calibration(30, 1e-12),
            start={v: found[v].mean for v in hidden},
        )
        for v in hidden:
            np.testing.assert_allclose(found[v].mean, tree[v].mean, atol=1e-6 * tree[v].std.min())
    assert converged >= 3


@unsettled
def test_nothing_is_linearised_before_messages_have_settled():
    """A relinearisation calls the function of each CPD; iterations of messages do not."""
    net, graph, evidence = bent_case(6)
    calls = []

    def counted(cpd):
        def function(*given):
            calls.append(1)
            return cpd.function(*given)

        slopes = {
            v: lambda *given, k=k: cpd.function.slopes(*given)[k] for k, v in enumerate(cpd.given)
        }
        return pgm.NonlinearGaussianCPD(cpd.child, cpd.given, function, cpd.cov, jacobian=slopes)

    counting = pgm.BayesianNetwork([counted(c) if c.given else c for c in net.cpds])
    method = pgm.ClusterGraph(
        counting, [c.scope for c in graph.clusters], {e: set(s) for e, s in graph.sepsets.items()}
    )
    few = pgm.infer(method, evidence, schedule=pgm.Flooding(iterations=1))
    start = len(calls)
    calls.clear()
    found = pgm.infer(method, evidence, schedule=pgm.Flooding(iterations=500))
    assert few.status.iterations == 1
    nonlinear = sum(bool(c.given) for c in net.cpds)
    relinearised = (len(calls) - start) / nonlinear
    assert found.status.converged
    assert 1 <= relinearised < found.status.iterations


# ---- CPDs without noise


def exact_case(seed, least=4, most=7):
    """Draw a network in which some CPDs have no noise, or singular noise."""
    rng = np.random.default_rng(seed)
    while True:
        net = random_network(rng, rng.integers(1, 3, rng.integers(least, most + 1)))
        cpds = []
        for cpd in net.cpds:
            d = cpd.child.dimension
            if cpd.given and rng.random() < 0.5:
                root = rng.normal(size=(d, d)) * (np.arange(d) < rng.integers(0, d))
                cpd = pgm.LinearGaussianCPD(
                    cpd.child, cpd.matrices, offset=cpd.offset, cov=root @ root.T
                )
            cpds.append(cpd)
        net = pgm.BayesianNetwork(cpds)
        nodes = [(c.child, dict(getattr(c, "matrices", {})), c.offset, c.cov) for c in net.cpds]
        graph = paths(net, rng) if seed % 2 else pgm.compile(net, method=pgm.Bethe())
        if not graph.is_tree:
            return net, graph, linear_joint(nodes), draw_evidence(net, rng, observed(net, rng))


@unsettled
@kinds
def test_exact_relations_in_loops_are_right_or_honest(kind):
    converged = 0
    for seed in range(8):
        net, graph, joint, evidence = exact_case(seed)
        posterior, _ = joint.given(evidence)
        schedule = kind(iterations=MOST[kind], damping=[0.0, 0.3][seed % 3 % 2])
        try:
            found = pgm.infer(graph, evidence, schedule=schedule)
        except pgm.NumericalError:
            continue
        if not found.status.converged:
            assert found.status.residuals[-1] > TOLERANCE
            continue
        converged += 1
        for v in net.variables:
            if v in evidence:
                continue
            # Where evidence determines a value, the prior's deviation is the unit.
            unit = np.sqrt(np.diagonal(posterior.marginal(v)[1]).clip(0))
            unit = np.maximum(unit, 1e-2 * np.sqrt(np.diagonal(joint.marginal(v)[1])))
            off = np.abs(found[v].mean - posterior.marginal(v)[0]) / unit
            assert off.max() <= 1e-6, f"seed {seed}, {v}"
    assert converged >= 5


def copies(noise):
    """Return a ring of copies that is closed by a sum: y = x, z = x, w = y + z."""
    x, y, z, w = pgm.variables("x y z w")
    return (x, y, z, w), pgm.BayesianNetwork(
        [
            pgm.GaussianCPD(x, 1.0, 2.0),
            pgm.LinearGaussianCPD(y, {x: 1.0}, cov=noise),
            pgm.LinearGaussianCPD(z, {x: 1.0}, cov=noise),
            pgm.LinearGaussianCPD(w, {y: 1.0, z: 1.0}, cov=noise),
        ]
    )


@unsettled
@crossed(("kind", "noise"), KINDS, [0.0, 1e-12, 1e-6])
def test_a_ring_of_copies_gives_no_false_certainty(kind, noise):
    """Information goes round and adds up: it settles slowly or never, and must not say it has."""
    (x, y, z, w), net = copies(noise)
    graph = pgm.compile(net, method=pgm.Bethe())
    found = pgm.infer(graph, {w: 6.0}, schedule=kind(iterations=60))
    if found.status.converged:
        for v in (x, y, z):
            np.testing.assert_allclose(found[v].mean, 3.0, atol=1e-5)
    else:
        assert found.status.residuals[-1] > TOLERANCE


@kinds
def test_a_contradiction_round_a_ring(kind):
    (x, _, _, w), net = copies(0.0)
    graph = pgm.compile(net, method=pgm.Bethe())
    with pytest.raises(pgm.NumericalError, match="contradicts an exact model"):
        pgm.infer(graph, {x: 1.0, w: 6.0}, schedule=kind())


@unsettled
@pytest.mark.parametrize("kind", [pgm.Flooding, pgm.Sequential])
def test_certainties_that_loops_feed_back_stay_what_they_are(kind):
    """Round the ring a rounding error grows; it must not come to a contradiction."""
    y, a, b, c, w, s, t = pgm.variables("y a b c w s t")
    net = pgm.BayesianNetwork(
        [
            pgm.GaussianCPD(a, 0.3, 1.7),
            pgm.LinearGaussianCPD(y, {a: 0.7}, cov=0.0),
            pgm.LinearGaussianCPD(b, {a: 3.1}, offset=0.1, cov=0.0),
            pgm.LinearGaussianCPD(c, {b: -5.3}, offset=0.7, cov=0.0),
            pgm.LinearGaussianCPD(w, {a: 1.9, c: -1.3}, cov=0.0),
            pgm.LinearGaussianCPD(s, {a: 1.0, c: 0.3}, cov=0.5),
            pgm.LinearGaussianCPD(t, {b: 1.0, s: 0.3}, cov=0.5),
        ]
    )
    truth = {a: 1.234567}
    truth[b] = 3.1 * truth[a] + 0.1
    truth[c] = -5.3 * truth[b] + 0.7
    evidence = {y: 0.7 * truth[a], w: 1.9 * truth[a] - 1.3 * truth[c], t: 2.0}
    graph = pgm.compile(net, method=pgm.Bethe())
    assert not graph.is_tree
    found = pgm.infer(graph, evidence, schedule=kind(tolerance=0.0, iterations=80))
    for v, value in truth.items():
        np.testing.assert_allclose(found[v].mean, value, rtol=1e-9)


def test_runs_that_are_not_linearised_anew_keep_their_charts():
    """A run in between, whose heading is far from what its motion says, is not turned round."""
    x = pgm.Variable("x", angles=("x",))
    y = pgm.Variable("y", angles=("y",))
    net = pgm.BayesianNetwork(
        [pgm.GaussianCPD(x, 0.0, 1.0), pgm.NonlinearGaussianCPD(y, x, np.sin, 1.0)]
    )
    graph = pgm.ClusterGraph(net, [{x, y}])
    layout = Layout(graph, frozenset(), frozenset())
    model = Model.make(layout, bind_values(net.cpds, {}, lead=(2,)), pgm.Taylor(), None)
    before = [np.array(family.offset) for family in model.families]
    mean, active = np.array([[0.0, 7.0], [0.0, 7.0]]), np.array([True, False])
    parents = [None, (np.zeros((1, 2, 1)), np.ones((1, 2, 1, 1)))]
    model.relinearise(mean, parents, active)
    after = [np.array(family.offset) for family in model.families]
    np.testing.assert_allclose(after[1][0, 0], before[1][0, 0] + 2 * np.pi)
    np.testing.assert_array_equal(after[1][0, 1], before[1][0, 1])
