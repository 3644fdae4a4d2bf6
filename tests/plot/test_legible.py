"""The checks of pictures find the faults that they are for."""

import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.patches import Circle, FancyArrowPatch

from tests.plot.legible import assert_legible, faults, smallest


def diagram():
    """Two nodes with names, and an arrow between them."""
    ax = plt.subplots(
        figsize=(4.0, 2.0), gridspec_kw={"left": 0, "right": 1, "bottom": 0, "top": 1}
    )[1]
    ax.set(xlim=(0.0, 4.0), ylim=(0.0, 2.0))
    ax.axis("off")
    for x, name in ((0.5, "a"), (3.5, "b")):
        ax.add_patch(Circle((x, 1.0), 0.3, facecolor="white", zorder=3.0))
        ax.text(x, 1.0, name, ha="center", va="center", zorder=4.0)
    arrow(ax, (0.8, 1.0), (3.2, 1.0))
    return ax


def arrow(ax, start, end, bend=0.0):
    ax.add_patch(
        FancyArrowPatch(
            start, end, arrowstyle="-|>", shrinkA=0, shrinkB=0, connectionstyle=f"arc3,rad={bend}"
        )
    )


def test_a_clear_diagram_has_no_faults():
    assert faults(diagram()) == []
    assert smallest(diagram()) == 10.0


def cut(ax):
    arrow(ax, (0.5, 1.3), (3.5, 1.3), bend=-0.9)


def behind(ax):
    ax.add_patch(Circle((2.0, 1.0), 0.2, zorder=3.0))
    ax.patches[-1].set_center((2.0, 1.02))
    ax.patches[-1].set_zorder(3.0)
    arrow(ax, (0.5, 1.4), (3.4, 0.7))


def over(ax):
    ax.text(2.0, 1.0, "p(b | a)", ha="center", va="center")


def tiny(ax):
    ax.text(2.0, 0.3, "small", fontsize=3.0)


def twice(ax):
    ax.text(2.0, 0.3, "one")
    ax.text(2.1, 0.3, "other")


def edge(ax):
    ax.text(0.75, 0.8, "x")


def heap(ax):
    ax.add_patch(Circle((3.6, 1.3), 0.3))


@pytest.mark.parametrize(
    ("spoil", "due"),
    [
        (cut, "leaves the figure"),
        (behind, "runs through Circle"),
        (over, "runs over the text 'p(b | a)'"),
        (tiny, "letters of 3 pt"),
        (twice, "the text 'one' lies on the text 'other'"),
        (edge, "the text 'x' lies on the edge of Circle"),
        (heap, "lies on Circle"),
    ],
)
def test_faults_of_diagrams_are_found(spoil, due):
    ax = diagram()
    spoil(ax)
    assert any(due in fault for fault in faults(ax)), faults(ax)
    with pytest.raises(AssertionError):
        assert_legible(ax)


def plot(**legend):
    ax = plt.subplots(layout="constrained")[1]
    ax.plot(np.arange(10), np.arange(10), label="up")
    ax.plot(np.arange(10), 0.5 * np.arange(10), label="half")
    ax.legend(**{"loc": "upper left"} | legend)
    return ax


def test_a_clear_plot_has_no_faults():
    assert faults(plot()) == []


def test_faults_of_plots_are_found():
    assert any("hides something" in fault for fault in faults(plot(loc="upper right")))
    ax = plot()
    ax.set_ylim(0.0, 5.0)
    assert any("Line2D 'up' leaves" in fault for fault in faults(ax))
    assert not any("leaves" in fault for fault in faults(ax, whole=False))
    ax = plot()
    ax.lines[1].set_color(ax.lines[0].get_color())
    ax.legend()
    assert any("look alike" in fault for fault in faults(ax))
    ax = plot()
    ax.lines[1].set_label("up")
    ax.legend()
    assert any("'up' twice" in fault for fault in faults(ax))
    ax = plt.subplots(figsize=(2.0, 1.0))[1]
    ax.set_xlabel("a label below")
    assert any("leaves the figure" in fault for fault in faults(ax))
