import json

import numpy as np
import pytest

from experiments import cluster_graph
from experiments.cluster_graph import apart, messages, network_figure, textbook
from models.networks import fix, velocity, velocity_position
from pgm import compile


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    out = tmp_path_factory.mktemp("cluster_graph")
    cluster_graph.run(out=out, seed=0, steps=6)
    return out, json.loads((out / "summary.json").read_text())


def test_messages_are_the_beliefs_of_filter_and_smoother(done):
    summary = done[1]
    assert (summary["clusters"], summary["sepsets"]) == (7, 6)
    for kind in ("forward", "both"):
        assert len(summary[kind]) == len(summary["difference"][kind]) == summary["sepsets"]
        assert max(summary["difference"][kind]) < 1e-9
    worst = max(max(found) for found in summary["difference"].values())
    assert summary["largest_difference"] == worst
    assert summary["forward"][0]["mean"] == pytest.approx([0.0, 0.0, 0.0])


def test_later_readings_shrink_beliefs_and_weights_agree(done):
    forward, both = done[1]["forward"], done[1]["both"]
    for there, product in zip(forward, both, strict=True):
        lost = np.linalg.eigvalsh(np.subtract(there["cov"], product["cov"]))
        assert lost.max() > 1e-4
        assert lost.min() > -1e-12
    weights = [product["log_weight"] for product in both]
    assert max(weights) - min(weights) < 1e-9
    assert forward[0]["log_weight"] == pytest.approx(0.0, abs=1e-9)
    assert len({round(there["log_weight"], 6) for there in forward}) == len(forward)


def test_a_model_with_other_noise_is_noticed():
    """The textbook keeps the experiment's noise; the network's sensor is a thousandth worse."""
    model = velocity_position(
        cluster_graph.DT,
        start_std=cluster_graph.START,
        motion_std=cluster_graph.MOTION,
        sensor_std=[1.001 * std for std in cluster_graph.SENSOR],
    )
    evidence = {velocity: np.full((5, 2), 0.4), fix: np.full((5, 2), 0.3)}
    found = messages(compile(model, steps=5), evidence)
    for ours, due in zip(found, textbook(evidence), strict=True):
        assert max(apart(ours, due)) > 1e-4


def test_the_network_shows_each_cpd_and_no_reading_at_the_start(done):
    drawn = network_figure(velocity_position(1.0)).axes[0].texts
    texts = [line for text in drawn for line in text.get_text().split("\n")]
    densities = {text for text in texts if text.startswith("p(")}
    due = {f"p(x[{t}] | x[{t - 1}], u[{t}])" for t in (1, 2, 3)}
    assert densities == {"p(x[0])"} | due | {f"p(z[{t}] | x[{t}])" for t in (1, 2, 3)}
    assert "z[0]" not in texts


def test_figures_come_in_the_order_of_the_report(done):
    out, summary = done
    figures = [entry for entry in summary["page"] if "figure" in entry]
    for entry, number in zip(figures, ("6.1", "6.2"), strict=True):
        assert entry["caption"].startswith(f"Figure {number}")
        assert (out / entry["figure"]).read_bytes().startswith(b"\x89PNG")
