from dataclasses import replace

import numpy as np
import pytest
from matplotlib.collections import EllipseCollection

from experiments.kalman import figures
from experiments.kalman.comparison import differences, solve
from experiments.kalman.experiment import largest
from experiments.kalman.problems import problems
from experiments.textbook import Belief, bayes_filter, rts_smoother
from models.networks import fix

NAMES = ("kalman", "extended", "unscented")


@pytest.fixture(scope="module")
def done(quick):
    found = quick("kalman")
    return found.folder, found.summary


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
        assert entry["caption"].startswith(f"Figure {number}: ")
    for entry in figures:
        assert (out / entry["figure"]).read_bytes().startswith(b"\x89PNG")


@pytest.fixture(scope="module")
def drives():
    """The problems, their drives, and what the textbook filters and smooths of the first."""
    models = problems()
    solved = {name: solve(model, model.controls, 50, 0) for name, model in models.items()}
    due = {}
    for name, model in models.items():
        readings = solved[name].evidence[fix][0]
        steps = bayes_filter(model.one_step, model.initial, model.controls, readings)
        due[name] = {
            "filter": [model.initial, *(step.filtered for step in steps)],
            "smoother": rts_smoother(model.initial, steps),
        }
    return models, solved, due


def dots(ax):
    """Where each kind of belief has its dots."""
    return {line.get_label(): line.get_xydata() for line in ax.lines}


def ellipses(ax):
    """Centres and widths of all ellipses, in the order drawn."""
    drawn = [found for found in ax.collections if isinstance(found, EllipseCollection)]
    return (
        np.concatenate([found.get_offsets() for found in drawn]),
        np.concatenate([found.get_widths() for found in drawn]),
    )


def plane(beliefs):
    """Positions, and the longer axes of their 95 % ellipses."""
    largest = [np.linalg.eigvalsh(belief.cov[:2, :2])[-1] for belief in beliefs]
    factor = -2.0 * np.log(0.05)
    return np.array([b.mean[:2] for b in beliefs]), 2.0 * np.sqrt(factor * np.array(largest))


@pytest.mark.parametrize("name", NAMES)
def test_a_drive_shows_what_was_filtered(drives, name):
    models, solved, due = drives
    (ax,) = figures.drive(models[name], solved[name]).axes
    means, widths = plane(due[name]["filter"])
    found = dots(ax)
    np.testing.assert_array_equal(found.pop("true position"), solved[name].truth[0, :, :2])
    np.testing.assert_allclose(np.concatenate(list(found.values())), means, atol=1e-9)
    centres, drawn = ellipses(ax)
    np.testing.assert_allclose(centres, means, atol=1e-9)
    np.testing.assert_allclose(drawn, widths, atol=1e-9)


def test_smoothers_are_shown_beside_their_filters(drives):
    models, solved, due = drives
    for ax, name in zip(figures.smoothers(models, solved).axes, NAMES, strict=True):
        found = dots(ax)
        both = [plane(due[name][kind]) for kind in ("filter", "smoother")]
        for label, (means, _) in zip(("filtered", "smoothed"), both, strict=True):
            np.testing.assert_allclose(found[label], means, atol=1e-9)
        centres, drawn = ellipses(ax)
        np.testing.assert_allclose(centres, np.concatenate([means for means, _ in both]), atol=1e-9)
        np.testing.assert_allclose(drawn, np.concatenate([wide for _, wide in both]), atol=1e-9)


def test_labels_stay_clear_of_the_panel_beside(drives):
    models, solved, _ = drives
    figure = figures.smoothers(models, solved)
    figure.draw_without_rendering()
    for left, ax in zip(figure.axes[:-1], figure.axes[1:], strict=True):
        assert ax.get_tightbbox().x0 > left.get_window_extent().x1
