"""The basics are drawn as they are: what a figure shows is measured on it."""

import json

import numpy as np
import pytest
from matplotlib.collections import EllipseCollection
from matplotlib.patches import Circle, Ellipse, FancyArrowPatch

from experiments import basics
from experiments.basics import gaussians, graphs, poses
from experiments.basics.experiment import CAPTIONS, FIGURES
from experiments.report.reproduced import REPRODUCED
from models.motion import Velocity


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    out = tmp_path_factory.mktemp("basics")
    basics.run(out=out, seed=0, draws=20_000)
    return out, json.loads((out / "summary.json").read_text())


def test_the_numbers_agree_with_what_is_found_otherwise(done):
    _, summary = done
    assert summary["inside"]["within_std"] == pytest.approx(0.6827, abs=0.015)
    assert summary["inside"]["within_ellipse"] == pytest.approx(0.95, abs=0.006)
    assert summary["ellipse"]["drawn"] == pytest.approx(summary["ellipse"]["eigenvectors"])
    assert summary["motion"]["model"] == pytest.approx(summary["motion"]["equation"])


def test_each_figure_is_written_and_has_its_number(done):
    out, summary = done
    for name in FIGURES:
        assert (out / f"{name}.png").read_bytes().startswith(b"\x89PNG")
    captions = [entry["caption"] for entry in summary["page"] if "figure" in entry]
    for item, _, name in REPRODUCED:
        if name == "basics":
            assert any(caption.startswith(f"{item}: ") for caption in captions)
    assert set(CAPTIONS) == set(FIGURES)


def test_the_density_is_the_textbook_one():
    (ax,) = gaussians.density().axes
    x, y = ax.lines[0].get_data()
    mean, std = 2.0, 0.75
    due = np.exp(-((x - mean) ** 2) / (2 * std**2)) / np.sqrt(2 * np.pi * std**2)
    assert y == pytest.approx(due)


def test_the_dotted_axes_end_on_the_ellipse_and_are_square():
    (ax,) = gaussians.error_ellipse().axes
    (ellipse,) = (c for c in ax.collections if isinstance(c, EllipseCollection))
    dotted = [line.get_xydata() for line in ax.lines if line.get_linestyle() == ":"]
    assert len(dotted) == 2
    precision = np.linalg.inv(gaussians.TWO.cov)
    for ends in dotted:
        away = ends - gaussians.TWO.mean
        assert (away @ precision * away).sum(axis=-1) == pytest.approx([5.991, 5.991], abs=1e-3)
    major, minor = (ends[1] - ends[0] for ends in dotted)
    assert major @ minor == pytest.approx(0.0, abs=1e-9)
    assert np.linalg.norm(major) > np.linalg.norm(minor)
    assert ellipse.get_offsets().tolist() == [gaussians.TWO.mean.tolist()]


def test_robots_stand_at_their_poses_and_arrows_run_along_the_headings():
    (ax,) = poses.two_poses().axes
    after = Velocity(poses.DT)(poses.BEFORE, poses.VELOCITIES)
    discs = [p.center for p in ax.patches if isinstance(p, Circle)]
    assert np.array(discs) == pytest.approx(np.array([poses.BEFORE[:2], after[:2]]))
    noses = [p._posA_posB for p in ax.patches if isinstance(p, FancyArrowPatch)]
    for pose in (poses.BEFORE, after):
        (end,) = (np.subtract(b, a) for a, b in noses if np.allclose(a, pose[:2]))
        assert np.arctan2(end[1], end[0]) == pytest.approx(pose[2])


def test_the_graphs_differ_in_arrows_and_in_the_joined_parents():
    undirected, directed, moral = graphs.kinds().axes
    for ax, lines, arrows in ((undirected, 4, 0), (directed, 0, 4), (moral, 5, 0)):
        assert len(ax.lines) == lines
        assert sum(isinstance(p, FancyArrowPatch) for p in ax.patches) == arrows
        assert sum(isinstance(p, Ellipse) for p in ax.patches) == 4
    assert sum(line.is_dashed() for line in moral.lines) == 1
