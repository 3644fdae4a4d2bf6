"""Pictures of balanced cluster trees."""

import matplotlib.pyplot as plt
import numpy as np
import pytest
from crossed import crossed
from matplotlib.patches import Ellipse, FancyArrowPatch, Rectangle

import pgm
import pgm.plot


def tree(model, steps):
    return pgm.compile(model, steps, method=pgm.Balanced())


def places(ax, graph):
    """The centres of the clusters, by index: messages=True names them."""
    plain = str.maketrans("₀₁₂₃₄₅₆₇₈₉", "0123456789")
    named = {t.get_text().split("\n")[0].translate(plain): t.get_position() for t in ax.texts}
    return {k: named[f"C{k}"] for k in range(len(graph)) if f"C{k}" in named}


def boxes(ax):
    back = ax.transData.inverted()
    shapes = [p for p in ax.patches if isinstance(p, Ellipse | Rectangle)]
    return [p.get_extents().transformed(back) for p in shapes]


@pytest.mark.parametrize("steps", [2, 3, 5, 8, 13])
def test_levels_go_by_depth_and_leaves_by_time(robot, steps):
    graph = tree(robot, steps)
    at = places(pgm.plot.cluster_graph(graph, messages=True), graph)
    assert set(at) == set(range(2 * steps))
    levels = {}
    for index in at:
        depth, above = 0, graph.parent(index)
        while above is not None:
            depth, above = depth + 1, graph.parent(above)
        levels.setdefault(depth, []).append(index)
    heights = [{round(at[k][1], 3) for k in level} for _, level in sorted(levels.items())]
    assert all(len(level) == 1 for level in heights)
    assert heights == sorted(heights, key=max, reverse=True)
    for level in levels.values():
        across = sorted(level, key=lambda k: at[k][0])
        assert across == sorted(level, key=lambda k: (graph.segment(k), k))


@crossed(("steps", "messages"), [0, 1, 2, 6, 16], [False, True])
def test_nothing_lies_on_anything(model, steps, messages):
    graph = tree(model, steps)
    ax = pgm.plot.cluster_graph(graph, messages=messages)
    shapes = boxes(ax)
    assert len(shapes) == len(graph) + len(graph.sepsets)
    for i, one in enumerate(shapes):
        for other in shapes[:i]:
            assert not one.overlaps(other)
    arrows = [p for p in ax.patches if isinstance(p, FancyArrowPatch)]
    assert len(arrows) == 2 * messages * len(graph.sepsets)
    words = {t.get_text() for t in ax.texts}
    assert steps != 6 or not messages or {"δ₀,₁₀", "δ₁₀,₀", "δ₁,₇", "δ₇,₁"} <= words


def test_the_first_steps_of_many(robot):
    graph = tree(robot, 100_000)
    ax = pgm.plot.cluster_graph(graph, steps=4)
    # Segment [0, 4] whole, cluster 0, and a stub from each to the root.
    assert len([p for p in ax.patches if isinstance(p, Ellipse)]) == 8
    assert len([p for p in ax.patches if isinstance(p, Rectangle)]) == 6
    assert [t.get_text() for t in ax.texts].count("…") == 2
    with pytest.raises(pgm.GraphError, match=r"200000 clusters are too many.*steps=4"):
        pgm.plot.cluster_graph(graph)


def test_sightings_are_counted_in_the_leaves(robot):
    (u, m), (z,) = robot.inputs, robot.sensors
    seen = pgm.sightings(np.ones((3, 2)), step=[0, 3, 3], given={m: np.ones((3, 2))})
    evidence = {u: np.ones((4, 2)), z: seen}
    ax = pgm.plot.cluster_graph(tree(robot, 4), evidence=evidence)
    words = "\n".join(t.get_text() for t in ax.texts)
    assert "z[3] ×2" in words
    assert "z[0]" in words
    assert "z[2]" not in words


def test_on_given_axes(robot):
    ax = plt.subplots(figsize=(4, 8))[1]
    assert pgm.plot.cluster_graph(tree(robot, 8), messages=True, sizes=True, ax=ax) is ax
