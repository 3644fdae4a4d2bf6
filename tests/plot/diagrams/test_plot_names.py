"""Names are shown word for word, whatever matplotlib would make of them."""

import io
import re

import matplotlib.pyplot as plt
import numpy as np
import pytest
from crossed import slow_after
from matplotlib.text import Text

import pgm
import pgm.plot

NAMES = ["$x_1$", "a$b", r"$\nonsense{$", r"\$3", "$a$ $b$ $"]


def walk(name):
    x, z = pgm.Variable(name, components=(f"{name}0", f"{name}1")), pgm.Variable(f"z{name}")
    return pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(x, [0.0, 0.0], np.eye(2))],
        transition=[pgm.LinearGaussianCPD(x, {x.previous: np.eye(2)}, cov=np.eye(2))],
        observation=[pgm.LinearGaussianCPD(z, {x: [[1.0, 1.0]]}, cov=1.0)],
    )


def drawn(name):
    """Every kind of plot that shows names."""
    model = walk(name)
    (x,), (z,) = model.states, model.sensors
    posterior = pgm.smooth(model, {z: np.arange(1.0, 31.0)[:, None]})
    belief, truth = posterior[x], np.zeros((31, 2))
    graph = pgm.compile(model, steps=2)
    yield pgm.plot.network(model, cpds=True)
    yield pgm.plot.cluster_graph(graph, messages=True)
    yield pgm.plot.ellipses(belief)
    yield pgm.plot.trajectory(belief, truth=truth)
    yield from pgm.plot.errors(belief, truth)
    yield pgm.plot.rmse(belief, truth, components=x.components)
    yield pgm.plot.nis(posterior.innovations[z])
    yield pgm.plot.whiteness(posterior.innovations[z])


def shown(text):
    """The text as matplotlib paints it; None where it is a formula."""
    words, formula = text._preprocess_math(text.get_text())
    return None if formula else words


def bare(text):
    return re.sub(r"[\s_]", "", text)


@pytest.mark.parametrize("name", slow_after(2, NAMES))
def test_names_are_shown_word_for_word(name):
    texts = []
    for ax in drawn(name):
        ax.figure.savefig(io.BytesIO(), dpi=20)
        texts.append({shown(text) for text in ax.figure.findobj(Text)} - {""})
        plt.close(ax.figure)
    network, clusters, ellipses, trajectory, first, second, rmse, nis, whiteness = texts
    assert not any(None in each for each in (clusters, nis, whiteness))
    assert any(bare(text or "").startswith(bare(f"{name}[1]p({name}[1]|")) for text in network)
    assert {f"{name}0", f"{name}1"} <= ellipses
    assert {f"{name}0", f"{name}1", f"estimate of {name}"} <= trajectory
    assert f"{name}0 error" in first
    assert f"{name}1 error" in second
    assert f"error in {name}0, {name}1" in rmse


def test_a_label_of_the_users_own_may_hold_a_formula():
    (x,) = walk("x").states
    belief = pgm.Gaussian(x, np.zeros((5, 2)), np.eye(2), steps=np.arange(5))
    ax = pgm.plot.trajectory(belief, truth=np.zeros((5, 2)), label=r"$\mu$")
    assert None in {shown(text) for text in ax.get_legend().get_texts()}
