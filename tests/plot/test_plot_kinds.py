"""The kind of a result is a label: of every plot that takes one."""

import numpy as np
import pytest

import pgm
import pgm.plot

LAG, STEPS, RUNS = pgm.Kind(5), 30, 3
x = pgm.Variable("x", components=("east", "north"))
z = pgm.Variable("z", components=("east", "north"))


@pytest.fixture(scope="module")
def walk():
    eye = np.eye(2)
    model = pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(x, [0.0, 0.0], eye)],
        transition=[pgm.LinearGaussianCPD(x, {x.previous: eye}, cov=eye)],
        observation=[pgm.LinearGaussianCPD(z, {x: eye}, cov=eye)],
    )
    drawn = model.sample(steps=STEPS, runs=RUNS, rng=0)
    return pgm.smooth(model, drawn.evidence, steps=STEPS), drawn[x]


def labels(axes):
    return axes.get_legend_handles_labels()[1]


PLOTS = {
    "trajectory": lambda p, truth, kind: pgm.plot.trajectory(p[x].run(0), label=kind),
    "errors": lambda p, truth, kind: pgm.plot.errors(p[x].run(0), truth[0], label=kind)[0],
    "nees": lambda p, truth, kind: pgm.plot.nees(p[x], truth, label=kind),
    "nis": lambda p, truth, kind: pgm.plot.nis(p.innovations[z], label=kind),
    "rmse": lambda p, truth, kind: pgm.plot.rmse(p[x], truth, label=kind),
    "kl": lambda p, truth, kind: pgm.plot.kl(p[x], p.filtered[x], label=kind),
    "coverage": lambda p, truth, kind: pgm.plot.coverage(p[x], truth, label=kind),
    "whiteness": lambda p, truth, kind: pgm.plot.whiteness(p.innovations[z], label=kind),
    "convergence": lambda p, truth, kind: pgm.plot.convergence(
        pgm.results.Status(2, np.ones((2, 20)), np.ones(20, dtype=bool)), label=kind
    ),
}


@pytest.mark.parametrize("name", PLOTS)
def test_a_kind_labels_as_its_text_does(name, walk):
    said, told = (labels(PLOTS[name](*walk, label)) for label in (LAG, "fixed-lag (5)"))
    assert said == told
    assert all(type(label) is str for label in said)
    assert any("fixed-lag (5)" in label for label in said)


def test_filter_and_smoother_say_which_they_are(walk):
    posterior, truth = walk
    filtered = posterior.filtered
    ax = pgm.plot.trajectory(filtered[x].run(0), label=filtered.kind, truth=truth[0])
    pgm.plot.trajectory(posterior[x].run(0), label=posterior.kind, ax=ax)
    assert {text.get_text() for text in ax.get_legend().get_texts()} == {
        "truth",
        "filtered",
        "smoothed",
    }
