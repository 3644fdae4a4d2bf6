"""Methods on many drives about a landmark: the maps against filters that are run here."""

import json

import numpy as np
import pytest

import pgm
from experiments import comparison_at_scale as scale
from models.networks.variables import pose
from pgm import consistency


@pytest.fixture(scope="module")
def left(tmp_path_factory):
    out = tmp_path_factory.mktemp("scale")
    scale.run(out=out, seed=3, **scale.QUICK)
    return out, json.loads((out / "summary.json").read_text())


def test_figures_and_cells_are_there(left):
    out, summary = left
    for name in ("consistency", "errors", "over_time"):
        assert (out / f"{name}.png").read_bytes().startswith(b"\x89PNG")
    assert set(summary["nees"]) == set(scale.METHODS)
    for by_distance in summary["nees"].values():
        assert len(by_distance) == len(scale.DISTANCES)
        assert all(len(each) == len(scale.BEARING_STD) for each in by_distance.values())


def test_a_cell_is_what_a_filter_finds_on_its_drives(left):
    _, summary = left
    found = scale.study(1.0, 0.05, seed=3, **scale.QUICK)
    runs = [found.run(k) for k in range(found.runs)]
    model, nees, square = found._drawn.model, [], []
    for run in runs:
        belief = pgm.filter(model, run.evidence, lineariser=pgm.Unscented())[pose]
        nees.append(consistency.nees(belief, run[pose]))
        square.append(((belief.mean - run[pose])[:, :2] ** 2).sum(axis=-1))
    cell = {name: summary[name]["UKF"]["1 m"]["0.05 rad"] for name in ("nees", "rmse")}
    assert cell["nees"] == pytest.approx(np.mean(nees), rel=1e-8)
    assert cell["rmse"] == pytest.approx(np.sqrt(np.mean(square)), rel=1e-8)


def test_drives_go_about_the_landmark():
    for distance in (1.0, 4.0):
        found = scale.study(distance, 0.05, runs=60, steps=8, seed=0)
        away = [np.hypot(*found.run(k)[pose][:, :2].T) for k in range(60)]
        assert np.abs(np.mean(away, axis=0) - distance).max() < 0.25


def test_near_a_landmark_an_ekf_is_too_sure_and_far_from_it_is_not():
    near, far = (scale.study(d, 0.05, runs=300, steps=8, seed=0)["EKF"] for d in (0.5, 8.0))
    assert near.nees.value > 2.0 * near.nees.expected
    assert abs(far.nees.value - 3.0) < 4.0 * far.nees.error
