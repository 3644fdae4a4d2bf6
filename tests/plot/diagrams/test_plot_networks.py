from itertools import combinations, pairwise

import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.colors import to_rgb
from matplotlib.patches import Ellipse, FancyArrowPatch

import pgm
import pgm.plot


def parts(ax):
    """Circles by label, and arrows."""
    at = {text.get_position(): text.get_text().replace("\n", "") for text in ax.texts}
    circles = {at[p.center]: p for p in ax.patches if isinstance(p, Ellipse)}
    return circles, [p for p in ax.patches if isinstance(p, FancyArrowPatch)]


def curve(arrow):
    """Points along an arrow, its head included."""
    pieces = arrow.get_path().to_polygons(closed_only=False)
    part = np.linspace(0.0, 1.0, 20)[:, None]
    return np.concatenate([a + part * (b - a) for piece in pieces for a, b in pairwise(piece)])


def ends(arrow, circles):
    """The labels of the circles an arrow joins: those whose borders its ends are on."""
    return tuple(
        min(circles, key=lambda label: abs(away(circles[label], point)))
        for point in course(arrow)[[0, -1]]
    )


def course(arrow):
    return arrow._path_original.vertices


def away(circle, point):
    return np.hypot(*np.subtract(circle.center, point)) - 0.5 * circle.width


def test_two_slices_of_the_robot(robot):
    circles, arrows = parts(pgm.plot.network(robot))
    assert set(circles) == {"x[0]", "z[0]", "m[0]", "x[1]", "u[1]", "z[1]", "m[1]"}
    assert {ends(arrow, circles) for arrow in arrows} == {
        ("x[0]", "x[1]"),
        ("u[1]", "x[1]"),
        ("x[0]", "z[0]"),
        ("m[0]", "z[0]"),
        ("x[1]", "z[1]"),
        ("m[1]", "z[1]"),
    }
    assert len(arrows) == 6


def test_observed_variables_are_shaded_and_hidden_ones_white():
    circles, _ = parts(pgm.plot.network(two_states_with_control()))
    shaded = {name for name, c in circles.items() if to_rgb(c.get_facecolor()) != (1, 1, 1)}
    assert shaded == {"z[0]", "z[1]", "command[1]"}


def two_states_with_control():
    x, u, command, z = pgm.variables("x u command z")
    linear = pgm.LinearGaussianCPD
    return pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(x, 0.0, 1.0)],
        transition=[
            linear(u, given={command: 1.0}, cov=0.1),
            linear(x, given={x.previous: 1.0, u: 1.0}, cov=0.1),
        ],
        observation=[linear(z, given={x: 1.0}, cov=0.1)],
    )


def test_evidence_says_which_sensors_are_shaded_beside_the_inputs():
    model = two_states_with_control()
    z = model.sensors[0]
    for evidence, due in (
        ([], {"command[1]"}),
        ({z: 1.0}, {"command[1]", "z[0]", "z[1]"}),
        ([z.at(1)], {"command[1]", "z[1]"}),
    ):
        circles, _ = parts(pgm.plot.network(model, evidence=evidence))
        shaded = {name for name, c in circles.items() if to_rgb(c.get_facecolor()) != (1, 1, 1)}
        assert shaded == due


@pytest.mark.parametrize("steps", [0, 1, 3])
def test_no_two_circles_overlap(model, steps):
    circles, arrows = parts(pgm.plot.network(model, steps=steps))
    graph = model.to_networkx(steps)
    assert len(circles) == len(graph)
    assert len(arrows) == len(graph.edges)
    for one, other in combinations(circles.values(), 2):
        apart = np.hypot(*np.subtract(one.center, other.center))
        assert apart > 0.55 * (one.width + other.width)


def test_time_runs_right_and_parents_stand_above(model):
    circles, _ = parts(pgm.plot.network(model, steps=2))
    for parent, child in model.to_networkx(2).edges:
        a, b = circles[repr(parent)].center, circles[repr(child)].center
        if parent.step != child.step:
            assert a[0] < b[0]
        elif child.step == 2:  # the prior may order the states otherwise
            assert a[1] > b[1]
        if parent.template == child.template:
            assert a[1] == b[1]


def test_arrows_end_at_the_borders_and_pass_over_no_node(model):
    circles, arrows = parts(pgm.plot.network(model, steps=2))
    for arrow in arrows:
        path = curve(arrow)
        for name, circle in circles.items():
            nearest = np.linalg.norm(path - circle.center, axis=-1).min()
            radius = 0.5 * circle.width
            if name in ends(arrow, circles):
                assert nearest == pytest.approx(radius, abs=0.12 * radius)
            else:
                assert nearest > 1.05 * radius


@pytest.mark.parametrize("size", [None, (3.0, 2.0)])
def test_labels_fit_their_circles_on_large_and_small_axes(model, size):
    ax = pgm.plot.network(model, ax=None if size is None else plt.subplots(figsize=size)[1])
    ax.figure.dpi = 300  # so that hinting does not widen the letters
    ax.figure.canvas.draw()
    circles, _ = parts(ax)
    for text in ax.texts:
        circle = circles[text.get_text().replace("\n", "")]
        assert text.get_window_extent().width < circle.get_window_extent().width
        whole = ax.figure.bbox
        assert whole.x0 <= circle.get_window_extent().x0
        assert circle.get_window_extent().x1 <= whole.x1


def test_labels_of_small_axes_shrink_less_than_their_circles(robot):
    ax = pgm.plot.network(robot, steps=3, ax=plt.subplots(figsize=(3.0, 2.0))[1])
    natural = pgm.plot.network(robot, steps=3)
    shrunk = [
        drawn.patches[0].get_window_extent().width / drawn.figure.dpi for drawn in (ax, natural)
    ]
    sizes = [drawn.texts[0].get_fontsize() for drawn in (ax, natural)]
    assert shrunk[0] < 0.7 * shrunk[1]
    assert sizes[0] / sizes[1] > 1.1 * shrunk[0] / shrunk[1]


def test_the_axes_given_are_returned(robot):
    _, ax = plt.subplots()
    assert pgm.plot.network(robot, ax=ax) is ax


def test_circles_are_round(robot):
    _, ax = plt.subplots(figsize=(9, 3))
    pgm.plot.network(robot, ax=ax)
    ax.figure.canvas.draw()
    circles, _ = parts(ax)
    extent = circles["x[0]"].get_window_extent()
    assert extent.width == pytest.approx(extent.height, rel=1e-6)


@pytest.mark.parametrize("steps", [-1, 1.5, True, "2"])
def test_steps_must_be_a_slice(robot, steps):
    with pytest.raises(pgm.ModelError, match="last slice to draw"):
        pgm.plot.network(robot, steps=steps)


def test_only_networks_and_single_axes_are_taken(robot):
    with pytest.raises(pgm.ModelError, match="BayesianNetwork or MarkovNetwork, not S"):
        pgm.plot.network(pgm.compile(robot, 3))
    with pytest.raises(pgm.ModelError, match="one matplotlib Axes, not ndarray"):
        pgm.plot.network(robot, ax=plt.subplots(2)[1])
