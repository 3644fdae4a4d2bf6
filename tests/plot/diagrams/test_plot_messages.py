from itertools import combinations

import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.patches import Ellipse, FancyArrowPatch, Rectangle

import pgm
import pgm.plot

SHAPES = {
    "pair": (2, [(0, 1)]),
    "chain": (9, [(k, k + 1) for k in range(8)]),
    "tree": (7, [(0, 1), (1, 2), (1, 3), (3, 4), (3, 5), (0, 6)]),
    "loop": (5, [(k, k + 1) for k in range(4)] + [(0, 4)]),
    "apart": (2, []),
}


@pytest.fixture(params=SHAPES)
def drawn(request, any_graph):
    """A graph's edges, and its axes."""
    count, edges = SHAPES[request.param]
    shared = pgm.variables([f"s{k}" for k in range(len(edges))])
    own = pgm.variables([f"v{k}" for k in range(count)])
    scopes = [
        (own[i], *(s for s, edge in zip(shared, edges, strict=True) if i in edge))
        for i in range(count)
    ]
    return edges, pgm.plot.cluster_graph(any_graph(scopes, edges), messages=True)


def ends(arrow):
    return np.array(arrow._posA_posB)


def plain(text):
    return text.translate(str.maketrans("₀₁₂₃₄₅₆₇₈₉", "0123456789"))


def named(ax):
    """The positions of messages' names, by source and target."""
    found = {plain(text.get_text()): np.array(text.get_position()) for text in ax.texts}
    return {
        tuple(map(int, name[1:].split(","))): at
        for name, at in found.items()
        if name.startswith("δ")
    }


def test_each_edge_has_two_messages_and_each_points_to_its_target(drawn):
    edges, ax = drawn
    names = named(ax)
    assert set(names) == {*edges, *((j, i) for i, j in edges)}
    arrows = [ends(p) for p in ax.patches if isinstance(p, FancyArrowPatch)]
    assert len(arrows) == len(names)
    places = {plain(t.get_text()).split("\n")[0]: np.array(t.get_position()) for t in ax.texts}
    sepset = {frozenset(edge): places[f"s{k}"] for k, edge in enumerate(edges)}
    for (source, target), at in names.items():
        nearest = min(arrows, key=lambda arrow: np.linalg.norm(arrow.mean(axis=0) - at))
        way = nearest[1] - nearest[0]
        middle = sepset[frozenset((source, target))]
        # The line may bend at its sepset, and does at the end of a row.
        legs = places[f"C{target}"] - middle, middle - places[f"C{source}"]
        assert max(way @ leg / np.linalg.norm(leg) for leg in legs) > 0.6 * np.linalg.norm(way)


def test_messages_lie_on_nothing(drawn):
    _, ax = drawn
    ax.figure.dpi = 300
    ax.figure.canvas.draw()
    back = ax.transData.inverted()

    def box(artist):
        extent = artist.get_window_extent().transformed(back)
        return np.array([extent.x0, extent.y0]), np.array([extent.x1, extent.y1])

    names = [box(text) for text in ax.texts if text.get_text().startswith("δ")]
    shapes = [box(p) for p in ax.patches if isinstance(p, Ellipse | Rectangle)]
    arrows = [(e.min(axis=0), e.max(axis=0)) for e in map(ends, ax.patches[len(shapes) :])]
    for (a, b), (c, d) in [
        *combinations(names, 2),
        *((name, other) for name in names for other in shapes + arrows),
        *((arrow, shape) for arrow in arrows for shape in shapes),
    ]:
        assert (b <= c).any() or (d <= a).any()
    for name in names + arrows:
        assert (name[0] >= [ax.get_xlim()[0], ax.get_ylim()[0]]).all()
        assert (name[1] <= [ax.get_xlim()[1], ax.get_ylim()[1]]).all()


def test_clusters_are_named_and_without_messages_nothing_changes(robot):
    graph = pgm.compile(robot, 12)
    ax = pgm.plot.cluster_graph(graph, messages=True, steps=11)
    first = [text.get_text().split("\n")[0] for text in ax.texts]
    assert {"C₀", "C₉", "C₁₁"} <= set(first)
    assert "δ₁₀,₁₁" in first
    assert "δ₁₁,₁₂" not in first  # its cluster is not drawn
    without = pgm.plot.cluster_graph(graph, steps=11)
    assert not any("C₀" in text.get_text() for text in without.texts)
    assert not any(isinstance(p, FancyArrowPatch) for p in without.patches)


def test_messages_on_given_axes(robot):
    ax = plt.subplots(figsize=(6, 2))[1]
    assert pgm.plot.cluster_graph(pgm.compile(robot, 3), messages=True, ax=ax) is ax
