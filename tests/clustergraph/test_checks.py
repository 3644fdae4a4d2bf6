"""Family preservation and running intersection, on trees, loops and everything that is neither."""

import itertools

import networkx as nx
import numpy as np
import pytest

import pgm
from pgm.clustergraph.cluster import check_families, check_running_intersection

A, B, C, D, E, F = pgm.variables("a b c d e f")

# Scopes, then sepsets, of graphs that are valid.
VALID = {
    "one cluster": ([{A, B}], {}),
    "apart": ([{A}, {B}, {C, D}], {}),
    "chain": ([{A, B}, {B, C}, {C, D}], {(0, 1): {B}, (1, 2): {C}}),
    "star": ([{A}, {A, B}, {A, C}, {A, D}], {(0, k): {A} for k in (1, 2, 3)}),
    "carried through": ([{A, B}, {A, C}, {A, D}], {(0, 1): {A}, (1, 2): {A}}),
    "wide sepset": ([{A, B, C}, {A, B, D}], {(0, 1): {A, B}}),
    "loop": (
        [{A, B}, {B, C}, {C, D}, {D, A}],
        {(0, 1): {B}, (1, 2): {C}, (2, 3): {D}, (0, 3): {A}},
    ),
    "loop with a shared variable": (
        [{A, B, E}, {B, C, E}, {C, A, E}],
        {(0, 1): {B, E}, (1, 2): {C, E}, (0, 2): {A}},
    ),
    "edge that carries nothing": ([{A}, {B}], {(0, 1): set()}),
    "higher index first": ([{A, B}, {B, C}], {(1, 0): {B}}),
}


@pytest.mark.parametrize("name", VALID)
def test_valid_graphs_pass(name):
    check_running_intersection(*VALID[name])


@pytest.mark.parametrize(
    ("scopes", "sepsets", "variable", "clusters"),
    [
        # not joined at all
        ([{A, B}, {B, C}], {}, B, "01"),
        # joined, but the sepset does not carry it
        ([{A, B, C}, {B, C}], {(0, 1): {B}}, C, "01"),
        # the chain between does not carry it
        ([{A, B}, {B, C}, {C, A}], {(0, 1): {B}, (1, 2): {C}}, A, "02"),
        # carried around a loop
        ([{A, B}, {A, C}, {A, D}], {(0, 1): {A}, (1, 2): {A}, (0, 2): {A}}, A, "012"),
        # carried around a loop, and apart from a fourth cluster
        (
            [{A}, {A, B}, {A, C}, {A, D}],
            {(0, 1): {A}, (1, 2): {A}, (0, 2): {A}},
            A,
            "3",
        ),
        # two pieces of two
        ([{A}, {A}, {A}, {A}], {(0, 1): {A}, (2, 3): {A}}, A, "0123"),
    ],
)
def test_running_intersection_fails(scopes, sepsets, variable, clusters):
    with pytest.raises(pgm.GraphError, match="running intersection") as caught:
        check_running_intersection(scopes, sepsets)
    assert caught.value.variable == variable
    assert isinstance(caught.value.cluster, int)
    words = str(caught.value)
    assert repr(variable) in words
    for cluster in clusters:
        assert cluster in words


@pytest.mark.parametrize(
    ("scopes", "sepsets", "variable", "cluster"),
    [
        ([{A, B}, {C}], {(0, 1): {A}}, A, 1),
        ([{C}, {A, B}], {(0, 1): {A}}, A, 0),
        ([{A}, {A}], {(0, 1): {A, B}}, B, 0),
        ([{A}, {A}], {(0, 1): {A}, (1, 2): {A}}, A, 2),
    ],
)
def test_a_sepset_outside_its_clusters(scopes, sepsets, variable, cluster):
    with pytest.raises(pgm.GraphError, match="the sepset between") as caught:
        check_running_intersection(scopes, sepsets)
    assert caught.value.variable == variable
    assert caught.value.cluster == cluster


@pytest.mark.parametrize("sepsets", [{(0, 1): {A}, (1, 0): {A}}, {(0, 1): {A}, (1, 1): {A}}])
def test_edges_that_stand_twice_or_in_a_ring(sepsets):
    with pytest.raises(pgm.GraphError):
        check_running_intersection([{A}, {A}], sepsets)


def is_valid(scopes, sepsets):
    """Check each variable's clusters and sepsets for a tree, by networkx."""
    for variable in set().union(*scopes):
        tree = nx.Graph()
        tree.add_nodes_from(k for k, scope in enumerate(scopes) if variable in scope)
        tree.add_edges_from(edge for edge, sepset in sepsets.items() if variable in sepset)
        if not nx.is_tree(tree):
            return False
    return True


def test_random_graphs_against_the_definition():
    rng = np.random.default_rng(0)
    found = []
    for _ in range(3000):
        count = int(rng.integers(2, 5))
        scopes = [{v for v in (A, B, C) if rng.random() < 0.6} for _ in range(count)]
        sepsets = {}
        for i, j in itertools.combinations(range(count), 2):
            sepset = {v for v in scopes[i] & scopes[j] if rng.random() < 0.7}
            if sepset:
                sepsets[i, j] = sepset
        if not any(scopes):
            continue
        valid = is_valid(scopes, sepsets)
        found.append(valid)
        if valid:
            check_running_intersection(scopes, sepsets)
        else:
            with pytest.raises(pgm.GraphError):
                check_running_intersection(scopes, sepsets)
    assert 100 < sum(found) < len(found) - 100


def test_families_preserved():
    scopes = [{A, B, C}, {C, D}]
    check_families(scopes, [[(A,), (C, A, B)], [(D, C)]])
    check_families(scopes, [[(A,), (C, A, B)], [(D, C)]], [(D, C), (C, A, B), (A,)])
    check_families(scopes, [[], []])


@pytest.mark.parametrize(
    ("assigned", "families", "words", "variable", "cluster"),
    [
        ([[(A, D)], []], None, r"cluster 0 .* the family .*, but lacks \(d\)", D, 0),
        ([[], [(D, A, C, B)]], None, r"cluster 1 .* the family .*, but lacks \(a, b\)", A, 1),
        ([[(C,)], [(C,)]], None, r"family \(c.* assigned to 2 clusters", C, None),
        ([[(C,), (C,)], []], None, r"family \(c.* assigned to 2 clusters", C, None),
        ([[(A,)], []], [(A,), (D, C)], r"family \(d.* assigned to 0 clusters", D, None),
    ],
)
def test_family_preservation_fails(assigned, families, words, variable, cluster):
    with pytest.raises(pgm.GraphError, match=words) as caught:
        check_families([{A, B, C}, {C, D}], assigned, families)
    assert "family preservation" in str(caught.value)
    assert caught.value.variable == variable
    assert caught.value.cluster == cluster
