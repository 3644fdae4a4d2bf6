from itertools import combinations

import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.patches import Circle, Ellipse

import pgm
import pgm.plot
from models.seven_nodes import seven_nodes_clusters


def boxes(ax):
    """Of the densities, in the data of the axes."""
    ax.figure.dpi = 300  # so that hinting does not widen the letters
    ax.figure.canvas.draw()
    back = ax.transData.inverted()
    extents = {
        text.get_text(): text.get_window_extent().transformed(back)
        for text in ax.texts
        if text.get_text().startswith("p(")
    }
    return {text: np.array([[e.x0, e.y0], [e.x1, e.y1]]) for text, e in extents.items()}


def test_slices_have_each_cpd_beside_its_node(robot):
    ax = pgm.plot.network(robot, steps=2, cpds=True)
    found = boxes(ax)
    assert set(found) == {
        "p(x[0])",
        "p(x[1] | x[0], u[1])",
        "p(x[2] | x[1], u[2])",
        *(f"p(z[{t}] | x[{t}], m[{t}])" for t in range(3)),
    }
    nodes = {t.get_text(): t.get_position() for t in ax.texts if t.get_text() not in found}
    for text, (low, high) in found.items():
        corner = np.array([low[0], high[1]])
        near = min(nodes, key=lambda name: np.hypot(*(corner - nodes[name])))
        assert text.startswith(f"p({near}")


@pytest.mark.parametrize("size", [None, (5.0, 2.5)])
def test_densities_lie_on_no_node_and_on_no_other(model, size):
    ax = None if size is None else plt.subplots(figsize=size)[1]
    ax = pgm.plot.network(model, steps=2, cpds=True, ax=ax)
    found = boxes(ax)
    circles = [p for p in ax.patches if isinstance(p, Circle)]
    for low, high in found.values():
        for circle in circles:
            nearest = np.clip(circle.center, low, high)
            assert np.hypot(*(nearest - circle.center)) > 0.98 * circle.radius
        assert (low >= [ax.get_xlim()[0], ax.get_ylim()[0]]).all()
        assert (high <= [ax.get_xlim()[1], ax.get_ylim()[1]]).all()
    for (a, b), (c, d) in combinations(found.values(), 2):
        assert (b <= c).any() or (d <= a).any()


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
    texts = [text.get_text() for text in pgm.plot.network(robot, cpds=True).axes.texts]
    assert not any(text.startswith(("p(u", "p(m")) for text in texts)
    assert not boxes(pgm.plot.network(robot))
