"""Every experiment runs, and leaves what it promises."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from experiments import localisation, plaza
from experiments.__main__ import app, main
from experiments.catalogue import EXPERIMENTS, NEEDS, THEMES, summary_line
from experiments.plaza import log as plaza_log
from experiments.plaza.experiment import localise
from pgm import EvidenceError, consistency

ROOT = Path(__file__).parent.parent.parent

# The baselines of textbook implementations on the same data, metres.
BASELINES = {
    "plaza1": {
        "dead_reckoning": 1.935,
        "Taylor": {"filter": 0.256, "smoother": 0.184},
        "Unscented": {"filter": 0.256, "smoother": 0.184},
    },
    "plaza2": {
        "dead_reckoning": 31.65,
        "Taylor": {"filter": 0.367, "smoother": 0.208},
        "Unscented": {"filter": 0.364, "smoother": 0.207},
    },
}


def test_the_list_has_a_line_for_each():
    lines = CliRunner().invoke(app, ["list"]).stdout.strip().splitlines()
    assert [line for line in lines if line.endswith(":")] == [f"{theme}:" for theme in THEMES]
    each = [line for line in lines if line.startswith("  ")]
    assert [line.split()[0] for line in each] == list(EXPERIMENTS)
    for line, (name, experiment) in zip(each, EXPERIMENTS.items(), strict=True):
        needs = f" [{NEEDS[name]}]" if name in NEEDS else ""
        assert line.endswith(f"  {summary_line(experiment)}{needs}")
    starts = [
        line.index(summary_line(e)) for line, e in zip(each, EXPERIMENTS.values(), strict=True)
    ]
    assert len(set(starts)) == 1


@pytest.mark.parametrize("missing", ["typer", "rich"])
def test_a_missing_package_is_told_in_a_line(missing):
    code = (
        f"import runpy, sys; sys.modules[{missing!r}] = None; "
        "runpy.run_module('experiments', run_name='__main__')"
    )
    run = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True)
    assert run.returncode == 1
    (line,) = run.stderr.splitlines()
    assert "typer and rich: pip install '.[experiments]'" in line


@pytest.mark.parametrize(
    ("name", "find"),
    [
        ("plaza", "experiments.plaza.log.find"),
        ("calibration", "experiments.plaza.log.find"),
        ("freiburg", "experiments.freiburg.log.find"),
        ("unknown_landmarks", "experiments.freiburg.log.find"),
        ("killian", "experiments.killian.log.find"),
        ("global_localisation", "experiments.house.find"),
        ("kidnapped", "experiments.house.find"),
    ],
)
def test_the_list_says_what_cannot_run_without_data(name, find, monkeypatch, tmp_path):
    assert name in NEEDS
    monkeypatch.setattr(find, lambda *of: None)
    EXPERIMENTS[name].run(out=tmp_path / name, seed=0)
    assert not (tmp_path / name).exists()


@pytest.mark.parametrize("words", [("kalman",), ("report", "--quick")])
def test_a_folder_that_cannot_be_is_told_in_a_line(words, tmp_path, monkeypatch, capsys):
    taken = tmp_path / "taken"
    taken.write_text("")
    monkeypatch.setattr(sys, "argv", ["experiments", *words, "--out", str(taken)])
    with pytest.raises(SystemExit) as left:
        main()
    assert left.value.code == 1
    told = capsys.readouterr()
    assert told.err == ""
    (line,) = told.out.splitlines()
    assert line.startswith(f"FolderError: results cannot be written into {taken} (")


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    out = tmp_path_factory.mktemp("localisation")
    localisation.run(out=out, seed=0, runs=20, steps=120)
    return out, json.loads((out / "summary.json").read_text())


def test_the_smoother_beats_the_filter_with_every_lineariser(drive):
    _, summary = drive
    assert set(summary["rmse"]) == {"Taylor", "Unscented", "MonteCarlo"}
    for rmse in summary["rmse"].values():
        assert rmse["smoother"] < rmse["filter"]


def test_a_summary_says_how_it_came_about(drive):
    _, summary = drive
    assert summary["settings"]["seed"] == 0
    assert {"python", "sepset", "numpy"} <= set(summary["versions"])
    assert {"nees", "log_evidence", "rmse_heading", "linear"} <= set(summary)


def test_figures_are_png_and_pdf(drive):
    out, _ = drive
    for name in ("network", "cluster_graph", "trajectories", "errors"):
        assert (out / f"{name}.png").read_bytes().startswith(b"\x89PNG")
        assert (out / f"{name}.pdf").read_bytes().startswith(b"%PDF")


def test_the_same_seed_gives_the_same_numbers():
    first, second, other = (
        localisation.compare(*localisation.simulate(seed, 2, 20))[0] for seed in (1, 1, 2)
    )
    assert first == second != other


def test_the_linear_check_is_inside_its_band():
    check = localisation.linear_check(0)
    low, high = check["band"]
    assert all(low < value < high for value in check["nees"].values())
    assert check["rmse"]["smoother"] < check["rmse"]["filter"]
    assert check["band"] == consistency.mean_band(2, check["runs"])


@pytest.mark.parametrize("name", BASELINES)
def test_plaza_meets_the_baselines(name):
    path = plaza_log.find(name)
    if path is None:
        pytest.skip("the recordings come with gtsam, which is not installed")
    setting = plaza_log.SETTINGS[name]
    log = plaza_log.load(path, setting)
    results, _ = localise(log, setting, name)
    due = BASELINES[name]
    assert results["dead_reckoning"] == pytest.approx(due["dead_reckoning"], rel=0.03)
    for label in ("Taylor", "Unscented"):
        for kind in ("filter", "smoother"):
            assert results[label][kind] == pytest.approx(due[label][kind], rel=0.03)
    moved = np.abs(next(iter(log.timeline.readings.values())).shift)
    assert moved.max() < 0.2


def test_plaza_without_recordings_says_so(monkeypatch, capsys):
    monkeypatch.setattr(plaza_log, "find", lambda name: None)
    plaza.run(out=None, seed=0, data=None, path=None)
    assert "gtsam" in capsys.readouterr().out


def test_plaza_refuses_a_file_of_unknown_kind(tmp_path):
    with pytest.raises(EvidenceError, match="--data"):
        plaza.run(out=tmp_path, seed=0, data=None, path=tmp_path / "log.mat")


def test_the_command_line_knows_them_all():
    beside = {"list", "report", "sweep", "uai"}
    assert {command.name for command in app.registered_commands} == {*EXPERIMENTS, *beside}
