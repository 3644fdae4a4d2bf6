"""The cliques of a growing map: potentials, messages and beliefs, against all rows at once."""

import pickle
from math import prod

import numpy as np
import pytest
from growing.dense_maps import dense, linear, rings
from numpy.testing import assert_allclose

import pgm


def grow(steps, **options):
    grown = pgm.GrowingMap(tolerance=0.0, **options)
    for cpds, evidence, start in steps:
        grown = grown.add(cpds, evidence, start=start)
    return grown


def several(seed):
    """Maps of poses in rings, and of linear CPDs of variables of any sizes, in several parts."""
    return grow(rings(seed, 45, closures=0.1)) if seed % 2 else grow(linear(seed, 30))


@pytest.mark.parametrize("seed", range(6))
def test_potential_times_messages_is_the_belief(seed):
    grown = several(seed)
    tree = grown.cliques
    assert len(tree) == grown.status.cliques > 3
    for cluster in tree.clusters:
        k = cluster.index
        found = prod([tree.message(j, k) for j in tree.neighbours(k)], start=tree.potential(k))
        assert found.scope == tree.scope(k) == cluster.scope[: len(found.scope)]
        belief, due = found.gaussian(), grown.joint(*found.scope)
        assert_allclose(belief.mean, due.mean, atol=1e-8)
        assert_allclose(belief.cov, due.cov, atol=1e-8)
        assert_allclose(tree.belief(cluster).K, found.K, rtol=1e-8, atol=1e-8)
        assert_allclose(tree.joint(*found.scope).mean, due.mean)


@pytest.mark.parametrize("seed", range(6))
def test_potentials_are_all_rows_once(seed):
    """Their sum is the information of all CPDs at the map's points."""
    grown = several(seed)
    tree = grown.cliques
    means, cov, place = dense(grown.network.cpds, grown.evidence, grown.points)
    total, right = np.zeros_like(cov), np.zeros(len(cov))
    for k in range(len(tree)):
        factor = tree.potential(k)
        at = np.concatenate([np.arange(len(cov))[place[v]] for v in factor.scope])
        total[np.ix_(at, at)] += factor.K
        right[at] += factor.h
    assert_allclose(total, np.linalg.inv(cov), rtol=1e-6, atol=1e-6)
    assert_allclose(np.linalg.solve(total, right), np.concatenate(list(means.values())), atol=1e-7)


@pytest.mark.parametrize("seed", [1, 3])
def test_messages_are_what_is_known_beyond_an_edge(seed):
    tree = grow(rings(seed, 30, closures=0.1)).cliques
    for (above, below), sepset in tree.sepsets.items():
        for sender, receiver in ((below, above), (above, below)):
            message = tree.message(sender, receiver)
            assert message.scope == sepset
            side, waiting = [], [(sender, receiver)]
            while waiting:
                k, but = waiting.pop()
                side.append(k)
                waiting += [(j, k) for j in tree.neighbours(k) if j != but]
            whole = prod([tree.potential(k) for k in side[1:]], start=tree.potential(side[0]))
            due = whole.marginal(*sepset)
            scale = np.abs(whole.K).max()
            assert_allclose(message.K / scale, due.K / scale, atol=1e-8)
            assert_allclose(message.h / scale, due.h / scale, atol=1e-7)


def test_the_structure_is_that_of_the_map():
    grown = several(3)
    tree = grown.cliques
    assert sorted(map(repr, (v for scope in tree.pivots for v in scope))) == sorted(
        map(repr, grown.variables)
    )
    assert {v for k in tree.touched for v in tree.pivots[k]} == set(grown.touched)
    assert tree.touched == frozenset(range(len(tree.touched)))
    assert 0 < len(tree.touched) < len(tree)
    assert len(tree.sepsets) == len(tree) - len(tree.roots)
    for (above, below), sepset in tree.sepsets.items():
        assert above < below
        assert set(sepset) <= set(tree.scope(above)) & set(tree.scope(below))
        assert set(sepset).isdisjoint(tree.pivots[below])
    # Flat priors say nothing.
    told = [cpd for cpd in grown.network.cpds if not np.isinf(cpd.cov).any()]
    assert {cpd.child for c in tree.clusters for cpd in c.cpds} == {cpd.child for cpd in told}
    assert repr(tree).startswith(f"CliqueTree({len(tree)} cliques, {len(tree.touched)} touched)")
    for cluster in tree.clusters:
        assert set(cluster.scope) >= {v for family in cluster.families for v in family}


def test_cliques_that_are_not_there():
    tree = several(1).cliques
    with pytest.raises(pgm.GraphError, match="there is no clique 99; the map has"):
        tree.potential(99)
    with pytest.raises(pgm.GraphError, match="there is no clique 'x'"):
        tree.belief("x")
    far = max(k for k in range(len(tree)) if k not in tree.neighbours(0))
    with pytest.raises(pgm.GraphError, match=f"cliques 0 and {far} are not joined"):
        tree.message(0, far)
    with pytest.raises(AttributeError, match="immutable"):
        tree.clusters = ()


def test_cliques_are_pickled_with_deep_trees():
    x = [pgm.Variable(f"x{k}") for k in range(1100)]
    grown = pgm.GrowingMap().add(pgm.GaussianCPD(x[0], 0.0, 1.0))
    for k in range(1, 1100):
        grown = grown.add(pgm.LinearGaussianCPD(x[k], {x[k - 1]: 1.0}, cov=1.0))
    tree = grown.cliques
    restored = pickle.loads(pickle.dumps(tree))
    last = len(tree) - 1
    assert_allclose(restored.belief(last).K, tree.belief(last).K)
    assert pickle.loads(pickle.dumps(grown)).cliques.touched == tree.touched
    assert len(pgm.GrowingMap().cliques) == 0
