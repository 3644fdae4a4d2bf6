import json
from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.path import Path

import pgm.plot
from experiments import seven_nodes
from experiments.dense import Dense
from experiments.seven_nodes.boundaries import draw_boundaries
from experiments.seven_nodes.experiment import solve
from models.seven_nodes import CLUSTERS, c, seven_nodes_clusters


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    out = tmp_path_factory.mktemp("seven_nodes")
    seven_nodes.run(out=out, value=1.0)
    return out, json.loads((out / "summary.json").read_text())


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


def test_three_figures(done):
    for name in ("network", "boundaries", "cluster_graph"):
        assert (done[0] / f"{name}.png").read_bytes().startswith(b"\x89PNG")
        assert (done[0] / f"{name}.pdf").read_bytes().startswith(b"%PDF")


def test_a_boundary_holds_its_cluster_and_nothing_else():
    graph = seven_nodes_clusters()
    ax = plt.subplots(figsize=(5, 4))[1]
    pgm.plot.network(graph.network, ax=ax)
    nodes = {text.get_text(): text.get_position() for text in ax.texts}
    boundaries = draw_boundaries(graph, ax)
    assert set(boundaries) == set(CLUSTERS)
    for number, boundary in boundaries.items():
        path = Path(boundary.get_xy())
        inside = {name for name, at in nodes.items() if path.contains_point(at)}
        assert inside == {variable.name for variable in CLUSTERS[number]}
    plt.close("all")
