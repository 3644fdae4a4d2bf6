"""d-separation against every trail of random graphs, and against partial covariances."""

from itertools import pairwise

import networkx as nx
import numpy as np
import pytest

import pgm
from tests.dense import linear_joint

SIZE = 6
V = pgm.variables([f"v{k}" for k in range(SIZE)])


def random_network(rng):
    """Draw a network and its edges; the order of declaration is not that of the graph."""
    order = rng.permutation(SIZE)
    edges = [(order[i], order[j]) for j in range(SIZE) for i in range(j) if rng.random() < 0.35]
    parents = {k: [i for i, j in edges if j == k] for k in range(SIZE)}
    cpds = [
        pgm.LinearGaussianCPD(
            V[k], {V[i]: rng.uniform(0.5, 1.5) for i in parents[k]}, cov=rng.uniform(0.5, 1.5)
        )
        for k in range(SIZE)
    ]
    return pgm.BayesianNetwork(cpds), edges


def random_sets(rng):
    """Draw two disjoint sets that are not empty, and a third."""
    part = rng.choice(4, size=SIZE, p=[0.25, 0.25, 0.25, 0.25])
    part[rng.choice(SIZE, size=2, replace=False)] = [0, 1]
    return tuple([v for v, k in zip(V, part, strict=True) if k == which] for which in range(3))


def active(edges, trail, known):
    """Whether one trail of indices carries information, by the definition."""
    graph = nx.DiGraph(edges)
    for (before, at), (_, after) in pairwise(pairwise(trail)):
        if (before, at) in edges and (after, at) in edges:
            if not known & ({at} | nx.descendants(graph, at)):
                return False
        elif at in known:
            return False
    return True


def separated(edges, a, b, given):
    skeleton = nx.Graph(edges)
    skeleton.add_nodes_from(range(SIZE))
    known = {V.index(v) for v in given}
    return not any(
        active(edges, trail, known)
        for i in map(V.index, a)
        for j in map(V.index, b)
        for trail in nx.all_simple_paths(skeleton, i, j)
    )


def test_every_trail_of_random_graphs():
    rng = np.random.default_rng(0)
    found = []
    for _ in range(150):
        net, edges = random_network(rng)
        for _ in range(4):
            a, b, given = random_sets(rng)
            found.append(net.separated(a, b, given))
            assert found[-1] == separated(edges, a, b, given), (edges, a, b, given)
    assert 0.1 < np.mean(found) < 0.9


def test_it_is_independence_in_the_density():
    """With coefficients in general position, separation is a partial covariance of zero."""
    rng = np.random.default_rng(1)
    for _ in range(60):
        net, _ = random_network(rng)
        joint = linear_joint(
            [(c.child, {p: c.matrices[p] for p in c.given}, c.offset, c.cov) for c in net.cpds]
        )
        a, b, given = random_sets(rng)
        rest, _ = joint.given({v: np.zeros(1) for v in given})
        cross = np.abs(rest.cov[np.ix_(rest.index(*a), rest.index(*b))]).max()
        assert net.separated(a, b, given) == (cross < 1e-9)


def network():
    a, b, c, u = V[:4]
    return pgm.BayesianNetwork(
        [
            pgm.LinearGaussianCPD(a, {u: 1.0}, cov=1.0),
            pgm.LinearGaussianCPD(b, {u: 1.0}, cov=1.0),
            pgm.LinearGaussianCPD(c, {a: 1.0, b: 1.0}, cov=1.0),
        ]
    )


def test_one_variable_or_any_collection():
    a, b, c, u = V[:4]
    net = network()
    assert not net.separated(a, b)
    assert net.separated(a, b, u)  # an input is a variable like others
    assert net.separated({a}, iter([b]), given=[u])
    assert not net.separated(a, b, given=(u, c))
    assert net.separated(c, u, (a, b))
    assert net.separated(a, ())


@pytest.mark.parametrize(
    ("sets", "words", "variable"),
    [
        ((V[0], V[5]), "v5, which the network does not have; it has v0, v1", V[5]),
        ((V[0], V[1], V[4]), "v4, which the network does not have", V[4]),
        ((V[0], V[0]), "v0 stands in two of the sets", V[0]),
        (((V[0], V[1]), V[2], V[1]), "v1 stands in two of the sets", V[1]),
        ((V[0], V[2], (V[3], V[2])), "v2 stands in two of the sets", V[2]),
        (("v0", V[1]), "separated: a holds variables, not 'v0'; give the variable itself", None),
    ],
)
def test_sets_that_are_none(sets, words, variable):
    with pytest.raises(pgm.ModelError, match=words) as caught:
        network().separated(*sets)
    assert caught.value.variable == variable
