import re
from dataclasses import replace
from itertools import combinations

import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.patches import FancyArrowPatch
from scipy.stats import norm

from experiments.dense import Dense
from experiments.seven_nodes.boundaries import draw_boundaries
from experiments.seven_nodes.experiment import solve
from experiments.seven_nodes.formulas import factor
from experiments.seven_nodes.messages import draw_messages
from experiments.seven_nodes.potentials import initial_belief
from models.seven_nodes import CLUSTERS, c, e, g, seven_nodes_clusters


@pytest.fixture(scope="module")
def done(quick):
    found = quick("seven_nodes")
    return found.folder, found.summary


def test_the_messages_are_the_known_ones(done):
    cases = done[1]["cases"]
    for name in ("none", "c=1"):
        message = cases[name]["messages"]["2,3"]
        assert message["scope"] == ["b"]
        assert (message["mean"], message["variance"]) == pytest.approx((-0.5, 2.0))
        assert message["log_weight"] == pytest.approx(0.0, abs=1e-12)
    prior, told = (cases[name]["messages"]["3,4"] for name in ("none", "c=1"))
    assert prior["scope"] == told["scope"] == ["f"]
    assert (prior["mean"], prior["variance"]) == pytest.approx((2.05, 2.0))
    assert (told["mean"], told["variance"]) == pytest.approx((0.85, 1.28))
    # ln N(1; 2, 0.5)
    assert told["log_weight"] == pytest.approx(-0.5 * (1 / 0.5 + np.log(2 * np.pi * 0.5)))
    assert told["K"] == pytest.approx(1 / 1.28)
    assert told["h"] == pytest.approx(0.85 / 1.28)


def test_messages_that_carry_nothing_have_no_mean(done):
    cases = done[1]["cases"]
    assert "mean" not in cases["c=1"]["messages"]["3,2"]
    assert "mean" in cases["c=1, e=0.3, g=1.2"]["messages"]["3,2"]
    assert set(cases["none"]["messages"]) == {"1,2", "2,1", "2,3", "3,2", "3,4", "4,3"}


def test_every_belief_is_that_of_the_dense_joint(done):
    summary = done[1]
    found = [value for case in summary["cases"].values() for value in case["difference"].values()]
    assert len(found) == 3 * 4
    assert max(found) == summary["largest_difference"] < 1e-12


def test_the_difference_shows_a_wrong_joint(monkeypatch):
    """A variance that is a thousandth too large is noticed wherever it matters."""

    def wrong(self, evidence):
        found = given(self, evidence)
        return replace(found, cov=1.001 * found.cov, log_evidence=found.log_evidence + 0.001)

    given = Dense.given
    monkeypatch.setattr(Dense, "given", wrong)
    difference = solve(seven_nodes_clusters(), {c: 1.0})["difference"]
    assert set(difference) == {"marginals", "beliefs", "sepsets", "log_evidence"}
    assert min(difference.values()) > 1e-4


def test_messages_are_those_of_the_equations(done):
    assert done[1]["equations"] < 1e-13


def test_an_initial_belief_is_the_product_of_the_cpds():
    rng = np.random.default_rng(0)
    graph = seven_nodes_clusters()
    point = dict(zip(graph.network.variables, rng.normal(size=7), strict=True))
    for cluster in graph:
        psi = initial_belief(cluster)
        at = [point[variable] for variable in psi.scope]
        due = sum(
            norm.logpdf(
                point[cpd.child],
                cpd.offset.item() + sum(cpd.matrices[p].item() * point[p] for p in cpd.parents),
                np.sqrt(cpd.cov.item()),
            )
            for cpd in cluster.cpds
        )
        assert float(psi.log_value(at)) == pytest.approx(due)


def test_figures(done):
    for name in ("network", "boundaries", "cluster_graph", "with_evidence"):
        assert (done[0] / f"{name}.png").read_bytes().startswith(b"\x89PNG")
        assert (done[0] / f"{name}.pdf").read_bytes().startswith(b"%PDF")


def test_a_dashed_boundary_holds_the_factors_of_its_cluster_and_nothing_else():
    graph = seven_nodes_clusters()
    ax = plt.subplots(figsize=(7, 4))[1]
    boundaries = draw_boundaries(graph, ax)
    texts = {text.get_text(): text.get_position() for text in ax.texts}
    assert set(boundaries) == set(CLUSTERS)
    for number, boundary in boundaries.items():
        assert boundary.get_linestyle() == "--"
        box = boundary.get_bbox()
        inside = {text for text, at in texts.items() if box.contains(*at)}
        cpds = graph.clusters[number - 1].cpds
        assert inside == {cpd.child.name for cpd in cpds} | {factor(cpd) for cpd in cpds}
    for one, other in combinations(boundaries.values(), 2):
        assert not one.get_bbox().overlaps(other.get_bbox())
    arrows = sum(isinstance(patch, FancyArrowPatch) for patch in ax.patches)
    assert arrows == sum(len(cpd.parents) for cpd in graph.network.cpds)


def test_messages_can_be_read_off(done):
    for evidence, case in (({}, "none"), ({c: 1.0, e: 0.3, g: 1.2}, "c=1, e=0.3, g=1.2")):
        ax = plt.subplots(figsize=(11, 2))[1]
        draw_messages(seven_nodes_clusters(), evidence, ax)
        words = " ".join(text.get_text() for text in ax.texts)
        for number in range(1, 5):
            assert f"$C_{number}$" in words
            assert rf"\psi_{number}(" in words
        for edge, sent in done[1]["cases"][case]["messages"].items():
            (name,) = sent["scope"]
            read = re.search(
                rf"\\delta_\{{{edge}\}}\({name}\)\$ = (?:\$e\^\{{(\S+)\}}\$ )?"
                rf"(?:1|\$\\mathcal\{{N\}}\({name};\\ \{{(\S+)\}},\\ \{{(\S+)\}}\)\$)",
                words,
            )
            weight, mean, variance = read.groups()
            assert float(weight or 0) == pytest.approx(sent.get("log_weight", 0.0), rel=0.01)
            if "mean" in sent:
                assert float(mean) == pytest.approx(sent["mean"], rel=0.01)
                assert float(variance) == pytest.approx(sent["variance"], rel=0.01)
            else:
                assert mean is None


def test_nothing_in_the_figure_of_messages_overlaps():
    for evidence in ({}, {c: 1.0, e: 0.3, g: 1.2}):
        figure, ax = plt.subplots(figsize=(11, 1.9))
        draw_messages(seven_nodes_clusters(), evidence, ax)
        figure.canvas.draw()
        boxes = [text.get_window_extent() for text in ax.texts]
        for one, other in combinations(boxes, 2):
            assert not one.padded(-1.0).overlaps(other.padded(-1.0))
        for box in boxes:
            assert figure.bbox.x0 <= box.x0 < box.x1 <= figure.bbox.x1
