"""`python -m experiments sweep`: its list, its refusals in a line, and what it leaves."""

import json
import sys

import pytest

from experiments.__main__ import main
from experiments.catalogue import EXPERIMENTS
from experiments.studies import Study, errors
from experiments.studies.settings import declared
from tests.experiments.studies import sweeps


def command(words, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["experiments", "sweep", *map(str, words)])
    code = 0
    try:
        main()
    except SystemExit as left:
        code = left.code
    told = capsys.readouterr()
    return code, told.out.strip().splitlines()


def test_the_list_has_every_sweep_and_setting(monkeypatch, capsys):
    code, lines = command([], monkeypatch, capsys)
    assert code == 0
    names = [line.strip() for line in lines if line.startswith("  ") and ":" not in line]
    assert names == [name for name, module in EXPERIMENTS.items() if hasattr(module, "sweep")]
    assert "      noise: float; 1.0 by default" in lines


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["plaza"], "sweep plaza: the experiments to sweep are localisation, "),
        (["localisation", "--over", "noise"], "--over noise: write --over setting=value,value"),
        (["localisation", "--over", "x=1"], "--over x=1: settings are lineariser, noise, "),
        (
            ["localisation", "--over", "noise=a"],
            "setting noise: found 'a'; its values are of float",
        ),
        (
            ["localisation", "--over", "noise=1,"],
            "setting noise: found ''; its values are of float",
        ),
        (["localisation", "--over", "steps=1.5"], "setting steps: found '1.5'; its values are of"),
        (["localisation", "--over", "belief=me"], "setting belief: found 'me'; its values are one"),
        (["localisation", "--over", "noise=1,1.0"], "setting noise: found [1.0, 1.0]; give each"),
        (
            ["localisation", "--over", "noise=1", "--over", "noise=2"],
            "--over noise=2: noise is there already; name all its values in one",
        ),
    ],
)
def test_refusals_are_a_line(words, told, tmp_path, monkeypatch, capsys):
    code, lines = command([*words, "--folder", tmp_path / "new"], monkeypatch, capsys)
    assert code == 1
    (line,) = lines
    assert line.startswith(f"StudyError: {told}")
    assert not (tmp_path / "new").exists()


def test_missing_packages_are_told_in_a_line(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(errors, "find_spec", lambda name: None)
    code, (line,) = command(["localisation"], monkeypatch, capsys)
    assert code == 1
    assert line.endswith("not installed here: pip install '.[studies]'")


def test_a_study_leaves_table_figure_and_summary(client, tmp_path, monkeypatch, capsys):
    words = ["nonlinear_measurement", "--over", "rule=Taylor,Cubature", "--over", "heading_std=0.2"]
    words += ["--runs", 300, "--part-size", 100, "--seed", 4, "--folder", tmp_path / "study"]
    words += ["--scheduler", client.scheduler.address]
    code, lines = command(words, monkeypatch, capsys)
    assert code == 0
    assert lines[0] == "6 parts are missing"
    summary = json.loads((tmp_path / "study" / "summary.json").read_text())
    assert summary["settings"]["seed"] == 4
    assert summary["settings"]["sensor"] == "near"
    sweep = EXPERIMENTS["nonlinear_measurement"].sweep
    over = {"rule": ["Taylor", "Cubature"], "heading_std": [0.2]}
    table = Study(sweep, over, runs=300, seed=4, part_size=100).table(tmp_path / "study")
    assert summary["rows"] == json.loads(json.dumps([row.numbers for row in table.rows]))
    assert (tmp_path / "study" / "figures.png").read_bytes().startswith(b"\x89PNG")


def test_one_who_stops_it_is_told_how_it_goes_on(tmp_path, monkeypatch, capsys):
    def stopped(*arguments, **settings):
        raise KeyboardInterrupt

    monkeypatch.setattr(Study, "run", stopped)
    code, (line,) = command(["localisation", "--folder", tmp_path], monkeypatch, capsys)
    assert code == 130
    assert line == f"stopped; the same command goes on from the parts in {tmp_path}"


def test_words_mean_values_of_each_kind():
    words = ("two words", "-3", "1e-3", "True")
    settings = declared(sweeps.kinds).values()
    found = {s.name: s.parsed(word) for s, word in zip(settings, words, strict=True)}
    assert found == {"word": "two words", "count": -3, "size": 1e-3, "on": True}
