from itertools import combinations

import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.patches import Ellipse, Rectangle

import pgm
import pgm.plot

U = pgm.Variable("u", components=("v", "omega"))
Z = pgm.Variable("z", components=("range", "bearing"), angles=("bearing",))
M = pgm.Variable("m", components=("east", "north"))


def labels(ax, kind):
    """Labels of all shapes of a kind, in the order drawn."""
    at = {text.get_position(): text.get_text() for text in ax.texts}
    return [at[centre(p)] for p in ax.patches if isinstance(p, kind)]


def words(label):
    return label.replace("\n", ", ").split(", ")


def centre(patch):
    if isinstance(patch, Ellipse):
        return tuple(patch.center)
    return next(
        text.get_position()
        for text in patch.axes.texts
        if np.allclose(text.get_position(), patch.get_center())
    )


def box(patch):
    extent = patch.get_extents().transformed(patch.axes.transData.inverted())
    return np.array([extent.x0, extent.y0]), np.array([extent.x1, extent.y1])


def assert_apart(ax):
    for (one, (a, b)), (other, (c, d)) in combinations([(p, box(p)) for p in ax.patches], 2):
        assert (b <= c).any() or (d <= a).any(), f"{one} lies on {other}"


def solid_lines(ax):
    return [line for line in ax.lines if line.get_linestyle() == "-"]


def readings(steps, values=None):
    steps = np.array(steps, dtype=int)
    rows = np.ones((steps.size, 2)) if values is None else values
    return pgm.sightings(rows, step=steps, given={M: np.ones((steps.size, 2))})


@pytest.mark.parametrize("last", [0, 2, 4, 11, 59])
def test_a_chain_has_an_ellipse_a_cluster_and_a_rectangle_a_sepset(robot, last):
    graph = pgm.compile(robot, last)
    ax = pgm.plot.cluster_graph(graph)
    assert labels(ax, Rectangle) == [f"x[{k}]" for k in range(last)]
    found = labels(ax, Ellipse)
    assert [set(words(label)) for label in found] == [
        {repr(v) for v in cluster.scope} for cluster in graph.clusters
    ]
    assert len(solid_lines(ax)) == last
    assert_apart(ax)


def test_a_chain_reads_left_to_right_and_in_rows(robot):
    ax = pgm.plot.cluster_graph(pgm.compile(robot, 59))
    centres = [patch.center for patch in ax.patches if isinstance(patch, Ellipse)]
    assert centres == sorted(centres, key=lambda at: (-at[1], at[0]))
    rows = {y for _, y in centres}
    assert 5 <= len(rows) <= 20
    width, _ = ax.figure.get_size_inches()
    assert width < 14


def test_a_short_chain_is_one_row_and_hidden_variables_come_first(robot):
    ax = pgm.plot.cluster_graph(pgm.compile(robot, 3))
    assert len({patch.center[1] for patch in ax.patches if isinstance(patch, Ellipse)}) == 1
    assert labels(ax, Ellipse)[3] == "x[2], x[3]\nu[3]\nz[3], m[3]"


def test_sightings_are_counted_and_silent_sensors_left_out(robot):
    evidence = {U: np.ones((5, 2)), Z: readings([3, 1, 3, 3, 3])}
    ax = pgm.plot.cluster_graph(pgm.compile(robot, 5), evidence=evidence)
    assert labels(ax, Ellipse) == [
        "x[0]",
        "x[0], x[1]\nu[1]\nz[1], m[1]",
        "x[1], x[2]\nu[2]",
        "x[2], x[3]\nu[3]\nz[3] ×4, m[3]",
        "x[3], x[4]\nu[4]",
        "x[4], x[5]\nu[5]",
    ]


def test_readings_not_taken_do_not_count(robot):
    values = np.ones((2, 4, 2))  # two runs
    values[:, 0] = np.nan  # taken in neither
    values[0, 1] = np.nan  # taken in the second
    evidence = {U: np.ones((2, 2)), Z: readings([1, 2, 2, 2], values)}
    ax = pgm.plot.cluster_graph(pgm.compile(robot, 2), evidence=evidence)
    assert labels(ax, Ellipse)[1:] == ["x[0], x[1]\nu[1]", "x[1], x[2]\nu[2]\nz[2] ×3, m[2]"]


def test_a_plain_array_reads_once_a_step_and_not_at_step_0():
    x, z, y = pgm.variables("x z y")
    linear = pgm.LinearGaussianCPD
    model = pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(x, 0.0, 1.0)],
        transition=[linear(x, given={x.previous: 1.0}, cov=0.1)],
        observation=[linear(z, given={x: 1.0}, cov=0.1), linear(y, given={x: 1.0}, cov=0.1)],
    )
    evidence = {z: np.array([[1.0], [np.nan]])}
    ax = pgm.plot.cluster_graph(pgm.compile(model, 2), evidence=evidence)
    assert labels(ax, Ellipse) == ["x[0]", "x[0], x[1]\nz[1]", "x[1], x[2]"]


def test_an_input_of_a_silent_sensor_stays_where_another_cpd_needs_it():
    x, z, u = pgm.variables("x z u")
    linear = pgm.LinearGaussianCPD
    model = pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(x, 0.0, 1.0)],
        transition=[linear(x, given={x.previous: 1.0, u: 1.0}, cov=0.1)],
        observation=[linear(z, given={x: 1.0, u: 1.0}, cov=0.1)],
    )
    ax = pgm.plot.cluster_graph(pgm.compile(model, 1), evidence={u: np.ones((1, 1))})
    assert labels(ax, Ellipse) == ["x[0]", "x[0], x[1]\nu[1]"]


def test_steps_cut_the_chain_and_show_that_it_goes_on(robot):
    graph = pgm.compile(robot, 100_000)
    ax = pgm.plot.cluster_graph(graph, steps=4)
    assert len(labels(ax, Ellipse)) == 5
    assert len(labels(ax, Rectangle)) == 4
    assert [text.get_text() for text in ax.texts].count("…") == 1
    assert len(ax.lines) == len(solid_lines(ax)) + 1


@pytest.mark.parametrize("steps", [4, 5, None])
def test_a_whole_chain_has_no_stub(robot, steps):
    ax = pgm.plot.cluster_graph(pgm.compile(robot, 4), steps=steps)
    assert "…" not in {text.get_text() for text in ax.texts}
    assert len(ax.lines) == len(solid_lines(ax)) == 4


SHAPES = {
    "tree": (7, [(0, 1), (1, 2), (1, 3), (3, 4), (3, 5), (0, 6)]),
    "star": (8, [(0, k) for k in range(1, 8)]),
    "loop": (6, [(k, k + 1) for k in range(5)] + [(0, 5)]),
    "complete": (5, list(combinations(range(5), 2))),
    "forest": (7, [(0, 1), (1, 2), (3, 4), (3, 5), (3, 6)]),
    "apart": (3, []),
}


@pytest.mark.parametrize("shape", SHAPES)
def test_any_graph_is_drawn_with_its_shapes_apart(any_graph, shape):
    count, edges = SHAPES[shape]
    shared = pgm.variables([f"edge{k}" for k in range(len(edges))])
    own = pgm.variables([f"v{k}" for k in range(count)])
    scopes = [
        (own[i], *(s for s, edge in zip(shared, edges, strict=True) if i in edge))
        for i in range(count)
    ]
    ax = pgm.plot.cluster_graph(any_graph(scopes, edges))
    ellipses = {
        words(label)[0]: p
        for label, p in zip(
            labels(ax, Ellipse), [p for p in ax.patches if isinstance(p, Ellipse)], strict=True
        )
    }
    assert len(ellipses) == count
    assert sorted(labels(ax, Rectangle)) == sorted(s.name for s in shared)
    assert_apart(ax)
    # Each sepset stands on the line between its two clusters.
    where = {text.get_text(): text.get_position() for text in ax.texts}
    for sepset, (i, j) in zip(shared, edges, strict=True):
        a, b, at = (
            np.array(p)
            for p in (ellipses[f"v{i}"].center, ellipses[f"v{j}"].center, where[sepset.name])
        )
        detour = np.linalg.norm(at - a) + np.linalg.norm(b - at) - np.linalg.norm(b - a)
        assert detour == pytest.approx(0.0, abs=1e-6)


def test_stubs_of_a_tree_lead_to_each_cluster_left_out(any_graph):
    a, *rest = pgm.variables("a b c d e f")
    tree = any_graph([(a,), *((a, v) for v in rest)], [(0, 1), (0, 2), (0, 3), (1, 4), (2, 5)])
    ax = pgm.plot.cluster_graph(tree, steps=3)
    assert [text.get_text() for text in ax.texts].count("…") == 2
    assert labels(ax, Ellipse) == ["a", "a, b", "a, c", "a, d"]


def test_evidence_of_a_general_graph_moves_variables_to_the_end(any_graph):
    a, b, c = pgm.variables("a b c")
    ax = pgm.plot.cluster_graph(any_graph([(a, b), (b, c)], [(0, 1)]), evidence={a: 1.0})
    assert labels(ax, Ellipse) == ["b\na", "b, c"]


@pytest.mark.parametrize("size", [None, (3.0, 2.0), (12.0, 2.0)])
def test_labels_fit_their_ellipses_and_all_is_inside(robot, size):
    ax = None if size is None else plt.subplots(figsize=size)[1]
    ax = pgm.plot.cluster_graph(pgm.compile(robot, 14), ax=ax)
    ax.figure.canvas.draw()
    ellipses = {tuple(p.center): p for p in ax.patches if isinstance(p, Ellipse)}
    for text in ax.texts:
        extent = text.get_window_extent()
        if shape := ellipses.get(text.get_position()):
            outline = shape.get_window_extent()
            reach = (extent.width / outline.width) ** 2 + (extent.height / outline.height) ** 2
            assert reach < 1.0  # the corners of the text lie inside the ellipse
    frame = ax.get_window_extent()
    for patch in ax.patches:
        extent = patch.get_window_extent()
        assert frame.x0 <= extent.x0 <= extent.x1 <= frame.x1
        assert frame.y0 <= extent.y0 <= extent.y1 <= frame.y1


def test_the_axes_given_are_returned(robot):
    _, ax = plt.subplots()
    assert pgm.plot.cluster_graph(pgm.compile(robot, 2), ax=ax) is ax


def test_what_cannot_be_drawn_is_refused(robot):
    graph = pgm.compile(robot, 500)
    with pytest.raises(pgm.GraphError, match=r"501 clusters are too many to read.*steps=4"):
        pgm.plot.cluster_graph(graph)
    with pytest.raises(pgm.GraphError, match="draws a compiled graph, not DynamicBayesianNetwork"):
        pgm.plot.cluster_graph(robot)
    for steps in (-1, 2.0, True):
        with pytest.raises(pgm.GraphError, match="last cluster to draw"):
            pgm.plot.cluster_graph(graph, steps=steps)
    with pytest.raises(pgm.EvidenceError, match="has 7 steps where there are 500"):
        pgm.plot.cluster_graph(graph, steps=4, evidence={U: np.ones((7, 2))})
    with pytest.raises(pgm.EvidenceError, match="maps variables to values; found list"):
        pgm.plot.cluster_graph(graph, steps=4, evidence=[U])
