import json
from dataclasses import replace

import numpy as np
import pytest

from experiments import kalman
from experiments.kalman.comparison import differences, solve
from experiments.kalman.experiment import largest
from experiments.kalman.problems import problems
from experiments.textbook import Belief

NAMES = ("kalman", "extended", "unscented")


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    out = tmp_path_factory.mktemp("kalman")
    kalman.run(out=out, seed=0, **kalman.QUICK)
    return out, json.loads((out / "summary.json").read_text())


def test_the_cluster_graph_gives_the_textbook_numbers(done):
    summary = done[1]
    assert tuple(summary["difference"]) == NAMES
    for name, lengths in summary["difference"].items():
        assert set(lengths) == {"5", "20"}
        for numbers in lengths.values():
            assert set(numbers) == {"filter", "smoother"}
            assert all(set(n) == {"mean", "cov", "log_evidence"} for n in numbers.values())
        assert summary["largest_difference_by"][name] == largest(lengths)
    assert summary["largest_difference"] == max(summary["largest_difference_by"].values())
    assert 0.0 < summary["largest_difference"] < 1e-9


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("name", NAMES)
def test_other_drives(name, seed):
    """Random controls, some of them backwards or turning on the spot."""
    problem = problems()[name]
    controls = np.random.default_rng(seed).normal(0.3, 0.6, size=(60, 2))
    solved = solve(problem, controls, 3, seed)
    assert largest({"60": differences(problem, solved)}) < 1e-9


@pytest.mark.parametrize("name", NAMES)
def test_a_wrong_textbook_is_noticed(name):
    """Each number in turn a millionth off: the sensor's noise, the start, the readings' density."""
    problem = problems()[name]
    solved = solve(problem, problem.controls, 2, 0)

    def off(changed):
        return largest({"5": differences(replace(problem, **changed), solved)})

    def biased(belief, u, z):
        step = problem.one_step(belief, u, z)
        return step._replace(log_density=step.log_density + 1e-6)

    noise = (1.0 + 1e-6) * problem.one_step.keywords["sensor_noise"]
    at, cov = problem.initial
    assert off({}) < 1e-9
    assert off({"one_step": lambda *given: problem.one_step(*given, sensor_noise=noise)}) > 1e-8
    assert off({"initial": Belief(at, (1.0 + 1e-6) * cov)}) > 1e-9
    assert off({"one_step": biased}) > 1e-7


def test_a_wrong_smoother_is_noticed():
    """Without its covariance of neighbours the smoother is the filter, which the graph's is not."""
    problem = problems()["unscented"]
    solved = solve(problem, problem.controls, 2, 0)

    def blind(belief, u, z):
        step = problem.one_step(belief, u, z)
        return step._replace(cross=0.0 * step.cross)

    numbers = differences(replace(problem, one_step=blind), solved)
    assert max(numbers["filter"].values()) < 1e-9
    assert numbers["smoother"]["mean"] > 0.01
    assert numbers["smoother"]["cov"] > 1e-3


def test_the_two_linearisations_are_not_the_same(done):
    """Else one of them would be checked twice."""
    models = problems()
    means = [
        solve(models[name], models[name].controls, 2, 0).filtered[models[name].state].mean
        for name in NAMES[1:]
    ]
    assert np.abs(means[0] - means[1]).max() > 1e-3


def test_figures_come_in_the_order_of_the_report(done):
    out, summary = done
    figures = [entry for entry in summary["page"] if "figure" in entry]
    assert [entry["figure"] for entry in figures] == [
        *(f"{name}.png" for name in NAMES),
        "smoothers.png",
    ]
    for entry, number in zip(figures, ("4.1", "4.2", "4.3"), strict=False):
        assert entry["caption"].startswith(f"Figure {number}")
    for entry in figures:
        assert (out / entry["figure"]).read_bytes().startswith(b"\x89PNG")
