from itertools import combinations

import matplotlib.pyplot as plt
import numpy as np
import pytest
from crossed import slow_after
from matplotlib.colors import to_rgb
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


def boxes_of(ax):
    """The lower and upper corners (P, 2) of all shapes."""
    return (np.array(corners) for corners in zip(*map(box, ax.patches), strict=True))


def assert_apart(ax):
    low, high = boxes_of(ax)
    before = (high[:, None] <= low).any(axis=-1)
    for one, other in np.argwhere(np.triu(~(before | before.T), k=1)):
        raise AssertionError(f"{ax.patches[one]} lies on {ax.patches[other]}")


def assert_lines_clear(ax):
    """No line runs over a shape but those it joins and the sepset between them."""
    low, high = boxes_of(ax)
    ellipses = np.array([isinstance(patch, Ellipse) for patch in ax.patches])
    for line in solid_lines(ax):
        ends = line.get_xydata()
        part = np.linspace(0.0, 1.0, 25)[:, None, None]
        path = (ends[:-1] + part * (ends[1:] - ends[:-1])).reshape(-1, 2)
        offset = (2.0 * path[:, None] - low - high) / (high - low)
        away = np.where(ellipses, np.hypot(*offset.T).T, np.abs(offset).max(axis=-1))
        assert (away < 1.0).any(axis=0).sum() == 3


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
    # The line of each sepset leads through it from one of its clusters to the other.
    where = {text.get_text(): text.get_position() for text in ax.texts}
    paths = {tuple(np.round(line.get_xydata()[[0, -1]].ravel(), 6)): line for line in ax.lines}
    for sepset, (i, j) in zip(shared, edges, strict=True):
        a, b = (ellipses[f"v{k}"].center for k in (i, j))
        path = paths.pop(tuple(np.round([*a, *b], 6))).get_xydata()
        legs = np.linalg.norm(path - where[sepset.name], axis=-1)
        pieces = np.linalg.norm(np.diff(path, axis=0), axis=-1)
        assert (legs[:-1] + legs[1:] - pieces).min() == pytest.approx(0.0, abs=1e-6)
    assert not paths
    assert_lines_clear(ax)


def test_the_neighbourhood_of_a_cluster_is_drawn_with_stubs_to_the_rest(robot):
    ax = pgm.plot.cluster_graph(pgm.compile(robot, 100_000), around=50_000, within=1)
    assert [words(label)[0] for label in labels(ax, Ellipse)] == [
        f"x[{k}]" for k in (49_998, 49_999, 50_000)
    ]
    assert [text.get_text() for text in ax.texts].count("…") == 2


@pytest.mark.parametrize(
    ("count", "names", "due"), [(12, None, True), (200, None, False), (12, False, False)]
)
def test_graphs_too_large_for_names_have_numbers(robot, count, names, due):
    graph = pgm.compile(robot, count - 1)
    ax = pgm.plot.cluster_graph(graph, names=names)
    numbers = [str(k) for k in range(count)]
    assert (labels(ax, Ellipse) == numbers) is not due
    assert len([p for p in ax.patches if isinstance(p, Rectangle)]) == count - 1
    assert min(text.get_fontsize() for text in ax.texts) >= 5.5


def test_many_sensors_alike_share_a_line():
    x, other = pgm.variables("x other")
    z = pgm.variables([f"z{k}" for k in range(1, 9)])
    linear = pgm.LinearGaussianCPD
    model = pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(x, 0.0, 1.0)],
        transition=[linear(x, given={x.previous: 1.0}, cov=0.1)],
        observation=[linear(one, given={x: 1.0}, cov=0.1) for one in (*z, other)],
    )
    ax = pgm.plot.cluster_graph(pgm.compile(model, 1))
    assert labels(ax, Ellipse)[1] == "x[0], x[1]\nz1…z8[1]\nother[1]"
    seen = {
        one: pgm.sightings(np.ones((count, 1)), step=[1] * count)
        for one, count in zip(z, (1, 2, 1, 0, 1, 4, 1, 1), strict=True)
    }
    ax = pgm.plot.cluster_graph(pgm.compile(model, 1), evidence=seen)
    assert labels(ax, Ellipse) == ["x[0]", "x[0], x[1]\n7 of z1…z8[1] ×11"]


@pytest.mark.parametrize(
    ("count", "due"), [(5, "z1[0]\nz2[0]\nz3[0]\nz4[0]\nz5[0]"), (6, "z1…z6[0]")]
)
def test_sensors_are_listed_alike_in_all_clusters(count, due):
    x, u = pgm.variables("x u")
    z = pgm.variables([f"z{k + 1}" for k in range(count)])
    linear = pgm.LinearGaussianCPD
    model = pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(x, 0.0, 1.0)],
        transition=[linear(x, given={x.previous: 1.0, u: 1.0}, cov=0.1)],
        observation=[linear(one, given={x: 1.0}, cov=0.1) for one in z],
    )
    seen = {one: pgm.sightings(np.ones((2, 1)), step=[0, 1]) for one in z} | {u: [[1.0]]}
    first, second = labels(pgm.plot.cluster_graph(pgm.compile(model, 1), evidence=seen), Ellipse)
    assert first == f"x[0]\n{due}"
    assert second.endswith(due.replace("[0]", "[1]"))


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
    ax.figure.dpi = 300  # so that hinting does not widen the letters
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
    graph = pgm.compile(robot, 1500)
    with pytest.raises(pgm.GraphError, match=r"1501 clusters are too many.*steps=4 or around=10"):
        pgm.plot.cluster_graph(graph)
    for wrong in ({"around": 1501}, {"around": -1}, {"around": 3.0}, {"around": 5, "steps": 4}):
        with pytest.raises(pgm.GraphError, match="is no cluster; they are 0 to"):
            pgm.plot.cluster_graph(graph, **wrong)
    with pytest.raises(pgm.GraphError, match="number of edges"):
        pgm.plot.cluster_graph(graph, around=5, within=-1)
    with pytest.raises(pgm.GraphError, match="draws a compiled graph, not DynamicBayesianNetwork"):
        pgm.plot.cluster_graph(robot)
    for steps in (-1, 2.0, True):
        with pytest.raises(pgm.GraphError, match="last cluster to draw"):
            pgm.plot.cluster_graph(graph, steps=steps)
    with pytest.raises(
        pgm.EvidenceError, match=r"has 7 rows, of steps 1\.\.7, where steps 1\.\.1500"
    ):
        pgm.plot.cluster_graph(graph, steps=4, evidence={U: np.ones((7, 2))})
    with pytest.raises(pgm.EvidenceError, match="maps variables to values; found list"):
        pgm.plot.cluster_graph(graph, steps=4, evidence=[U])


def bethe(parents):
    """A loopy graph: a cluster a family, and one a variable; parents are given by index."""
    v = pgm.variables([f"v{k}" for k in range(len(parents))])
    net = pgm.BayesianNetwork(
        pgm.LinearGaussianCPD(v[k], given={v[p]: 1.0 for p in given}, cov=1.0)
        if given
        else pgm.GaussianCPD(v[k], 0.0, 1.0)
        for k, given in enumerate(parents)
    )
    families = [{v[k], *(v[p] for p in given)} for k, given in enumerate(parents)]
    sepsets = {(k, len(v) + p): {v[p]} for k, given in enumerate(parents) for p in (k, *given)}
    return pgm.ClusterGraph(net, [*families, *({u} for u in v)], sepsets)


def random_parents(count, seed):
    rng = np.random.default_rng(seed)
    return [
        rng.choice(np.arange(max(0, k - 8), k), size=min(k, 1 + k % 2), replace=False).tolist()
        for k in range(count)
    ]


def random_tree(any_graph, count, seed):
    rng = np.random.default_rng(seed)
    edges = [(int(rng.integers(max(0, k - 12), k)), k) for k in range(1, count)]
    shared = pgm.variables([f"edge{k}" for k in range(1, count)])
    scopes = [[s for s, edge in zip(shared, edges, strict=True) if k in edge] for k in range(count)]
    return any_graph(scopes, edges)


@pytest.mark.parametrize("kind", ["tree", "bethe"])
def test_graphs_of_sixty_clusters_are_clear_and_readable(any_graph, kind):
    graph = random_tree(any_graph, 60, 0) if kind == "tree" else bethe(random_parents(30, 1))
    ax = pgm.plot.cluster_graph(graph)
    assert len(labels(ax, Ellipse)) == 60
    assert len(labels(ax, Rectangle)) == len(graph.sepsets)
    assert_apart(ax)
    assert_lines_clear(ax)
    assert min(text.get_fontsize() for text in ax.texts) > 6.0
    frame = ax.get_window_extent()
    for patch in ax.patches:
        extent = patch.get_window_extent()
        assert frame.x0 < extent.x0 < extent.x1 < frame.x1
        assert frame.y0 < extent.y0 < extent.y1 < frame.y1


def test_large_clusters_name_the_first_variables_and_count_the_others(any_graph):
    v = pgm.variables([f"v{k}" for k in range(20)])
    ax = pgm.plot.cluster_graph(any_graph([v, v[4:]], [(0, 1)]))
    assert words(labels(ax, Ellipse)[0]) == [*(f"v{k}" for k in range(15)), "+5"]
    assert words(labels(ax, Rectangle)[0]) == [f"v{k}" for k in range(4, 20)]


def test_long_names_are_cut_in_the_middle(any_graph):
    long = pgm.Variable("the_position_of_the_second_landmark", components=("a",))
    (label,) = labels(pgm.plot.cluster_graph(any_graph([(long,)], [])), Ellipse)
    head, tail = label.split("…")
    assert long.name.startswith(head)
    assert long.name.endswith(tail)
    assert len(head) > len(tail) >= 4


def discrete_loop(any_graph):
    a, b, c, d = (pgm.Discrete(name, size) for name, size in zip("abcd", (2, 3, 4, 5), strict=True))
    return any_graph([(a, b), (b, c), (c, d), (d, a)], [(0, 1), (1, 2), (2, 3), (0, 3)])


def test_sizes_are_components_or_table_entries(any_graph):
    ax = pgm.plot.cluster_graph(discrete_loop(any_graph), sizes=True)
    assert labels(ax, Ellipse) == [
        "a, b\n6 entries",
        "b, c\n12 entries",
        "c, d\n20 entries",
        "d, a\n10 entries",
    ]
    assert set(labels(ax, Rectangle)) == {
        f"{v}\n{n} entries" for v, n in zip("abcd", "2345", strict=True)
    }
    x, y = pgm.Variable("x", components=("a", "b", "c")), pgm.Variable("y")
    ax = pgm.plot.cluster_graph(any_graph([(x, y), (y,)], [(0, 1)]), sizes=True)
    assert labels(ax, Ellipse) == ["x, y\ndim 4", "y\ndim 1"]
    assert labels(ax, Rectangle) == ["y\ndim 1"]


def test_rounding_alone_has_no_bar(any_graph):
    ax = pgm.plot.cluster_graph(discrete_loop(any_graph), residuals={(0, 1): 0.0, (1, 2): 2e-16})
    assert not ax.child_axes
    assert ax.texts[-1].get_text() == "residual (white: below 1e-13, which is rounding)"


def luminance(colour):
    """Of WCAG 2."""
    c = np.array(colour[:3])
    linear = np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)
    return float(linear @ [0.2126, 0.7152, 0.0722])


def shades(ax, kind):
    return [luminance(to_rgb(p.get_facecolor())) for p in ax.patches if isinstance(p, kind)]


def test_larger_clusters_are_darker_and_a_bar_says_what_is_what(any_graph):
    ax = pgm.plot.cluster_graph(discrete_loop(any_graph), colour="size")
    order = np.argsort([6, 12, 20, 10])
    assert np.all(np.diff(np.array(shades(ax, Ellipse))[order]) < -0.05)
    (bar,) = ax.child_axes
    assert bar.get_xlabel() == "table entries"
    assert bar.get_xlim() == (6.0, 20.0)
    assert len(set(shades(ax, Rectangle))) == 1


def test_larger_residuals_are_darker_and_rounding_is_white(any_graph):
    residuals = {(0, 1): 3e-16, (2, 1): [1e-9, 1e-6], (1, 2): 1e-8, (2, 3): 1e-3, (0, 3): 1e-9}
    ax = pgm.plot.cluster_graph(discrete_loop(any_graph), residuals=residuals)
    drawn = dict(zip(["01", "03", "12", "23"], shades(ax, Rectangle), strict=True))
    assert drawn["01"] > 0.999 > drawn["03"] > drawn["12"] > drawn["23"]
    (bar,) = ax.child_axes
    assert bar.get_xlabel() == "residual (white: below 1e-13, which is rounding)"
    np.testing.assert_allclose(bar.get_xlim(), (1e-9, 1e-3))
    assert len(set(shades(ax, Ellipse))) == 1


@pytest.mark.parametrize("numbers", [[1e-3], [1e-3, 2e-3], [np.inf], [0.0, np.inf, 1.0]])
def test_any_residuals_have_colours(any_graph, numbers):
    residuals = dict(zip([(0, 1), (1, 2), (2, 3)], numbers, strict=False))
    ax = pgm.plot.cluster_graph(
        discrete_loop(any_graph), colour="residual", residuals=residuals, sizes=True
    )
    ax.figure.canvas.draw()
    (bar,) = ax.child_axes
    low, high = bar.get_xlim()
    assert high / low >= 9.99
    named = [tick.label1.get_text() for tick in bar.xaxis.get_major_ticks()]
    assert len([name for name in named if name]) >= 2


@pytest.mark.parametrize("size", slow_after(1, [(None,), ((4.0, 3.0),), ((9.0, 3.0),)]))
def test_texts_stand_out_from_every_shade_and_the_bar_from_the_clusters(any_graph, size):
    v = pgm.variables([f"v{k}" for k in range(31)])
    scopes = [v[: k + 1] for k in range(30)]
    graph = any_graph(scopes, [(0, k) for k in range(1, 30)])
    ax = None if size is None else plt.subplots(figsize=size)[1]
    ax = pgm.plot.cluster_graph(graph, colour="size", ax=ax)
    at = {text.get_position(): text for text in ax.texts}
    for patch in ax.patches:
        pair = [
            luminance(to_rgb(c)) for c in (patch.get_facecolor(), at[centre(patch)].get_color())
        ]
        assert (max(pair) + 0.05) / (min(pair) + 0.05) >= 4.5
    ax.figure.canvas.draw()
    (bar,) = ax.child_axes
    extent = bar.get_tightbbox()
    assert extent.y1 < min(patch.get_window_extent().y0 for patch in ax.patches)
    assert extent.y0 >= ax.get_window_extent().y0


@pytest.mark.parametrize(
    ("wrong", "match"),
    [
        ({"colour": "width"}, 'colour is "size" or "residual", not \'width\''),
        ({"colour": "residual"}, "needs residuals="),
        ({"colour": "size", "residuals": {}}, "does not go with residuals"),
        ({"residuals": [1.0]}, "found list"),
        ({"residuals": {}}, r"pgm\.Flooding\(\).*calibration of a tree leaves none"),
        ({"residuals": {(0, 2): 1.0}}, r"\(0, 2\), which is no pair of joined clusters"),
        ({"residuals": {3: 1.0}}, "3, which is no pair of joined clusters"),
        ({"residuals": {(0, 1): -1.0}}, "0 or more was due"),
        ({"residuals": {(0, 1): np.nan}}, "0 or more was due"),
    ],
)
def test_colours_without_numbers_are_refused(any_graph, wrong, match):
    with pytest.raises(pgm.GraphError, match=match):
        pgm.plot.cluster_graph(discrete_loop(any_graph), **wrong)
    assert not plt.get_fignums()


def test_residuals_of_trees_and_of_single_clusters():
    graph = pgm.compile(bethe([[], [0]]).network)
    status = pgm.infer(graph, {}, schedule=pgm.Flooding()).status
    pgm.plot.cluster_graph(graph, residuals=status.by_edge)
    chain = pgm.compile(bethe([[], [0], [1]]).network)
    with pytest.raises(pgm.GraphError, match="residuals are of no pair"):
        pgm.plot.cluster_graph(chain, residuals=pgm.infer(chain, {}).status.by_edge)
    status = pgm.infer(chain, {}, schedule=pgm.Flooding()).status
    pgm.plot.cluster_graph(chain, residuals=status.by_edge)


@pytest.mark.parametrize("size", [(2.5, 2.0), (8.0, 2.5)])
def test_texts_stay_in_their_shapes_on_small_axes(any_graph, size):
    ax = plt.subplots(figsize=size)[1]
    pgm.plot.cluster_graph(discrete_loop(any_graph), sizes=True, ax=ax)
    ax.figure.dpi = 300
    ax.figure.canvas.draw()
    at = {text.get_position(): text.get_window_extent() for text in ax.texts}
    for patch in ax.patches:
        inner, outer = at[centre(patch)], patch.get_window_extent()
        part = np.array([inner.width / outer.width, inner.height / outer.height])
        assert np.linalg.norm(part, ord=2 if isinstance(patch, Ellipse) else np.inf) < 1.0


def test_tables_larger_than_any_float_have_a_size_too(any_graph):
    v = [pgm.Discrete(f"v{k}", 10) for k in range(400)]
    ax = pgm.plot.cluster_graph(any_graph([v, v[:2]], [(0, 1)]), sizes=True, colour="size")
    assert labels(ax, Ellipse)[0].endswith(", +385\n10^400.0 entries")
    ax.figure.canvas.draw()


@pytest.mark.parametrize("names", [3, "x", []])
def test_names_are_shown_or_not(names):
    a = pgm.Variable("a")
    graph = pgm.compile(pgm.BayesianNetwork([pgm.GaussianCPD(a, 0.0, 1.0)]))
    with pytest.raises(pgm.GraphError, match="names= is True or False"):
        pgm.plot.cluster_graph(graph, names=names)
