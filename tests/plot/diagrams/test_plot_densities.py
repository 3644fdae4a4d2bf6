import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.patches import Ellipse, FancyArrowPatch

import pgm
import pgm.plot
from models.seven_nodes import seven_nodes_clusters
from tests.plot.diagrams import zoo


def densities(ax):
    """The densities that are written, by the name above each."""
    pairs = (text.get_text().rsplit("\np(", 1) for text in ax.texts)
    return {name.replace("\n", ""): f"p({rest[0]}" for name, *rest in pairs if rest}


def test_slices_have_each_cpd_below_its_name(robot):
    assert densities(pgm.plot.network(robot, steps=2, cpds=True)) == {
        "x[0]": "p(x[0])",
        "x[1]": "p(x[1] | x[0], u[1])",
        "x[2]": "p(x[2] | x[1], u[2])",
        **{f"z[{t}]": f"p(z[{t}] | x[{t}], m[{t}])" for t in range(3)},
    }


@pytest.mark.parametrize("size", [None, (5.0, 2.5)])
def test_densities_lie_inside_their_nodes(model, size):
    ax = None if size is None else plt.subplots(figsize=size)[1]
    ax = pgm.plot.network(model, steps=2, cpds=True, ax=ax)
    ax.figure.dpi = 300
    ax.figure.canvas.draw()
    nodes = {p.center: p for p in ax.patches if isinstance(p, Ellipse)}
    for text in ax.texts:
        extent, outline = (each.get_window_extent() for each in (text, nodes[text.get_position()]))
        assert np.hypot(extent.width / outline.width, extent.height / outline.height) < 1.0


def test_other_networks_have_it_below_the_name():
    network = seven_nodes_clusters().network
    ax = pgm.plot.network(network, cpds=True)
    texts = {text.get_text() for text in ax.texts}
    assert {"a\np(a)", "e\np(e | b, d)", "g\np(g | f)"} <= texts
    assert len(texts) == 7
    ax.figure.dpi = 300
    ax.figure.canvas.draw()
    for text, shape in zip(
        ax.texts, [p for p in ax.patches if isinstance(p, Ellipse)], strict=True
    ):
        assert text.get_window_extent().width < shape.get_window_extent().width


def test_inputs_have_no_cpd_and_without_the_option_nobody_has(robot):
    assert densities(pgm.plot.network(robot, cpds=True)).keys() == {"x[0]", "x[1]", "z[0]", "z[1]"}
    assert not densities(pgm.plot.network(robot))


@pytest.mark.parametrize("name", ["hub of 3", "two robots", "tracker"])
def test_arrows_join_nodes_though_densities_of_the_first_slice_are_shorter(name):
    ax = pgm.plot.network(zoo.DYNAMIC[name][0], steps=2, cpds=True)
    nodes = [p for p in ax.patches if isinstance(p, Ellipse)]
    centre = np.array([p.center for p in nodes])
    half = 0.5 * np.array([(p.width, p.height) for p in nodes])
    arrows = [p for p in ax.patches if isinstance(p, FancyArrowPatch)]
    assert len(arrows) >= len(nodes) - 3
    for arrow in arrows:
        for end in arrow._path_original.vertices[[0, -1]]:
            reach = np.linalg.norm((end - centre) / half, axis=-1)
            assert np.abs(reach - 1.0).min() < 0.02
