"""Calibrated trees of Gaussian networks against dense conditioning."""

import numpy as np
import pytest
from gaussian.draws import assert_dense, assert_moments, regular
from numpy.testing import assert_allclose

import pgm
from tests.dags import grid

NONE, SOME, MOST = 0.0, 0.3, 0.8


def check(drawn, graph, share, seed):
    rng = np.random.default_rng(seed)
    evidence, hidden = drawn.observe(rng, share)
    posterior = pgm.infer(graph, evidence)
    assert_dense(posterior, drawn.dense(), evidence, hidden, rng)
    assert posterior.log_evidence_kind == "exact"
    assert posterior.status.converged.all()
    assert posterior.graph is graph


@pytest.mark.parametrize("share", [NONE, SOME, MOST])
@pytest.mark.parametrize(
    ("count", "most", "reach"),
    [(1, 1, None), (2, 2, None), (10, 3, None), (25, 3, 6), (60, 2, 5), (120, 3, 4), (200, 1, 4)],
)
def test_random_networks(count, most, reach, share):
    for seed in range(6 if count <= 10 else 1):
        drawn = regular(seed, count, most, reach=reach)
        check(drawn, pgm.compile(drawn.network(np.random.default_rng(seed))), share, seed)


def test_the_networks_drawn_have_trees_of_several_components():
    graph = pgm.compile(regular(0, 120, 3, reach=4).network())
    assert len(graph.sepsets) < len(graph) - 1
    assert graph.width >= 4


def test_a_joint_across_components_has_no_covariance_between_them():
    a, b, c, d = pgm.variables("a b c d")
    net = pgm.BayesianNetwork(
        [
            pgm.GaussianCPD(a, 1.0, 2.0),
            pgm.LinearGaussianCPD(b, {a: 1.0}, cov=1.0),
            pgm.GaussianCPD(c, -1.0, 3.0),
            pgm.LinearGaussianCPD(d, {c: 2.0}, cov=1.0),
        ]
    )
    joint = pgm.infer(pgm.compile(net), {d: 0.5}).joint(c, b, a)
    gain = 6.0 / 13.0
    assert_allclose(joint.mean, [-1.0 + gain * 2.5, 1.0, 1.0], rtol=1e-14)
    assert_allclose(joint.cov, [[3.0 / 13.0, 0, 0], [0, 3, 2], [0, 2, 2]], atol=1e-14)


ORDERS = {
    "min-fill": pgm.JunctionTree(order=pgm.MinFill()),
    "weighted min-fill": pgm.JunctionTree(order=pgm.WeightedMinFill()),
    "nested dissection": pgm.JunctionTree(order=pgm.NestedDissection()),
    "as declared": pgm.JunctionTree(order=lambda net: net.variables),
    "in reverse": pgm.JunctionTree(order=lambda net: net.variables[::-1]),
}


@pytest.mark.parametrize("order", ORDERS)
def test_elimination_orders(order):
    drawn = regular(3, 18, 2, reach=5)
    check(drawn, pgm.compile(drawn.network(), method=ORDERS[order]), SOME, 3)


def junction(drawn):
    return [set(cluster.scope) for cluster in pgm.compile(drawn.network())]


BY_HAND = {
    "one cluster for all": lambda drawn: [set(drawn.variables)],
    "every cluster twice": lambda drawn: [c for c in junction(drawn) for _ in range(2)],
    "and one for each variable": lambda drawn: junction(drawn) + [{v} for v in drawn.variables],
    "and one for each family": lambda drawn: junction(drawn) + [set(c.scope) for c in drawn.cpds],
    "the later ones wider": lambda drawn: [
        set(drawn.variables[:k]) for k in range(1, len(drawn.variables) + 1)
    ],
}


@pytest.mark.parametrize("share", [NONE, SOME, MOST])
@pytest.mark.parametrize("clusters", BY_HAND)
def test_trees_made_by_hand(clusters, share):
    drawn = regular(4, 9, 3)
    graph = pgm.ClusterGraph(drawn.network(), BY_HAND[clusters](drawn))
    assert graph.is_tree
    check(drawn, graph, share, 4)


def test_a_path_through_clusters_that_share_one_variable():
    """Sepsets smaller than what clusters share, where running intersection allows it."""
    drawn = regular(5, 6, 2, parents=0)
    a, b, c, d, e, f = drawn.variables
    clusters = [{a, b}, {b, c}, {c, d}, {e}, {d, e, f}]
    sepsets = {(0, 1): {b}, (1, 2): {c}, (2, 4): {d}, (3, 4): {e}}
    check(drawn, pgm.ClusterGraph(drawn.network(), clusters, sepsets), SOME, 5)


def test_sepsets_without_variables():
    """Two components, joined by an empty sepset to one tree."""
    drawn = regular(6, 4, 2, parents=0)
    a, b, c, d = drawn.variables
    graph = pgm.ClusterGraph(drawn.network(), [{a, b}, {c, d}], {(0, 1): set()})
    assert graph.is_tree
    for share in (NONE, SOME, MOST):
        check(drawn, graph, share, 6)


def test_a_cluster_whose_variables_are_all_observed():
    drawn = regular(7, 12, 2, reach=4)
    graph = pgm.compile(drawn.network())
    rng = np.random.default_rng(7)
    for cluster in graph:
        evidence = {v: drawn.values[v] for v in cluster.scope}
        hidden = [v for v in drawn.variables if v not in evidence]
        assert_dense(pgm.infer(graph, evidence), drawn.dense(), evidence, hidden, rng)


def test_a_grid():
    parents = grid(5)
    v = pgm.variables(" ".join(f"v{k}" for k in range(25)))
    cpds = [
        pgm.LinearGaussianCPD(v[k], {v[j]: 0.75 for j in places}, offset=0.1 * k, cov=0.5)
        if places
        else pgm.GaussianCPD(v[k], 1.0, 2.0)
        for k, places in enumerate(parents)
    ]
    drawn = regular(0, 1)
    drawn = type(drawn)(tuple(cpds), {x: np.array([0.1 * k]) for k, x in enumerate(v)})
    check(drawn, pgm.compile(drawn.network()), SOME, 8)


def test_the_joint_of_everything_in_reverse():
    drawn = regular(9, 15, 2, reach=4)
    evidence, hidden = drawn.observe(np.random.default_rng(9), SOME)
    due, _ = drawn.dense().given(evidence)
    joint = pgm.infer(pgm.compile(drawn.network()), evidence).joint(*hidden[::-1])
    assert_moments(joint.mean, joint.cov, *due.marginal(*hidden[::-1]))


def test_noise_and_inputs_that_are_known():
    """Inputs shift means; noise may depend on them, and on an observed variable with a CPD."""
    a, b, c, u = pgm.variables("a b c u")
    net = pgm.BayesianNetwork(
        [
            pgm.GaussianCPD(a, 0.5, 2.0),
            pgm.LinearGaussianCPD(
                b, {a: 1.0, u: 3.0}, cov=pgm.noise(lambda u: u[..., None] ** 2, given=(u,))
            ),
            pgm.LinearGaussianCPD(
                c, {a: -1.0}, cov=pgm.noise(lambda b: 1 + b[..., None] ** 2, given=(b,))
            ),
        ]
    )
    posterior = pgm.infer(pgm.compile(net), {u: 0.5, b: 2.0, c: 1.0})
    # p(a) N(2; a + 1.5, 0.25) N(1; −a, 5)
    precision = 1 / 2.0 + 1 / 0.25 + 1 / 5.0
    mean = (0.5 / 2.0 + 0.5 / 0.25 - 1.0 / 5.0) / precision
    assert_allclose(posterior[a].mean, [mean], rtol=1e-14)
    assert_allclose(posterior[a].cov, [[1 / precision]], rtol=1e-14)

    def log_normal(x, mean, cov):
        return -0.5 * ((x - mean) ** 2 / cov + np.log(2 * np.pi * cov))

    due = log_normal(2.0, 0.5 + 1.5, 2.25)
    gain = 2.0 / 2.25
    due += log_normal(1.0, -0.5, 5.0 + 2.0 - gain * 2.0)
    assert_allclose(posterior.log_evidence, due, rtol=1e-14)
