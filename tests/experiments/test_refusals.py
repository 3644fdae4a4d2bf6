"""The command line tells in a line what is wrong, and leaves with a code."""

import errno
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from scipy.io import savemat

from experiments import cluster_graph
from experiments.__main__ import main
from experiments.belief_propagation import repository
from experiments.plaza import log as plaza_log
from experiments.report.command import make_report
from pgm import EvidenceError, FileError

ROOT = Path(__file__).parents[2]


def command(words, monkeypatch, capsys):
    """The code and the line that the command line leaves."""
    monkeypatch.setattr(sys, "argv", ["experiments", *map(str, words)])
    with pytest.raises(SystemExit) as left:
        main()
    told = capsys.readouterr()
    assert "Traceback" not in told.out + told.err
    assert told.err == ""
    return left.value.code, told.out.strip().splitlines()[-1]


@pytest.fixture
def full(monkeypatch):
    def fails(*arguments, **settings):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Figure, "savefig", fails)


@pytest.mark.usefixtures("full")
def test_a_full_disk(tmp_path, monkeypatch, capsys):
    code, line = command(["cluster_graph", "--out", tmp_path], monkeypatch, capsys)
    assert code == 1
    assert line.startswith(f"FolderError: results cannot be written into {tmp_path} (No space")


@pytest.mark.usefixtures("full")
def test_a_report_on_a_full_disk_has_no_traceback(tmp_path, capsys):
    (outcome,) = make_report({"cluster_graph": cluster_graph}, tmp_path, quick=True)
    assert outcome.error.startswith("FolderError: results cannot")
    assert "\n" not in outcome.error
    assert "Traceback" not in capsys.readouterr().out


@pytest.mark.parametrize(
    "name", ["localisation", "kalman", "differential_drive", "particle_counts", "smoothing"]
)
@pytest.mark.parametrize("runs", [10**12, 10**30])
def test_a_huge_number_of_runs(name, runs, tmp_path, monkeypatch, capsys):
    code, line = command([name, "--runs", runs, "--out", tmp_path], monkeypatch, capsys)
    assert code == 1
    assert line.startswith("ModelError: draws of ")
    assert "GiB or more, where this machine has" in line


def test_memory_that_runs_out(tmp_path, monkeypatch, capsys):
    def fails(*arguments, **settings):
        raise MemoryError("Unable to allocate 7.45 TiB")

    monkeypatch.setattr(Figure, "savefig", fails)
    code, line = command(["cluster_graph", "--out", tmp_path], monkeypatch, capsys)
    assert code == 1
    assert line == "MemoryError: Unable to allocate 7.45 TiB; ask for fewer runs or steps"


def test_an_error_of_the_programme_keeps_its_traceback(tmp_path, monkeypatch):
    def fails(*arguments, **settings):
        raise KeyError("a mistake")

    monkeypatch.setattr(Figure, "savefig", fails)
    monkeypatch.setattr(sys, "argv", ["experiments", "cluster_graph", "--out", str(tmp_path)])
    with pytest.raises(KeyError, match="a mistake"):
        main()


def test_an_unknown_network(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(repository, "_folder", lambda: tmp_path)
    for name in ("asia", "alarm"):
        (tmp_path / f"{name}.bif.gz").touch()
    words = ["belief_propagation", "--known", "nosuch", "--out", tmp_path / "out"]
    code, line = command(words, monkeypatch, capsys)
    assert code == 1
    assert line == "FileError: --known nosuch: pgmpy has no such network; it has alarm, asia"
    assert not (tmp_path / "out").exists()


def mat(path, **changes):
    tables = {"GT": np.zeros((3, 4)), "DR": np.zeros((3, 3)), "TD": np.ones((2, 4))}
    savemat(path, tables | {"TL": np.array([[1.0, 0.0, 0.0]])} | changes)


DAMAGED = {
    "empty": lambda path: path.write_bytes(b""),
    "text": lambda path: path.write_text("no recording\n" * 100),
    "cut": lambda path: (mat(path), path.write_bytes(path.read_bytes()[:-20])),
    "zeros": lambda path: path.write_bytes(bytes(4096)),
    "a newer kind": lambda path: path.write_bytes(b"MATLAB 7.3".ljust(124) + b"\x00\x02IM"),
}


@pytest.mark.parametrize("kind", DAMAGED)
def test_a_recording_that_cannot_be_read(kind, tmp_path, monkeypatch, capsys):
    path = tmp_path / "log.mat"
    DAMAGED[kind](path)
    words = ["plaza", "--data", "plaza1", "--path", path, "--out", tmp_path / "out"]
    code, line = command(words, monkeypatch, capsys)
    assert code == 1
    assert line.startswith(f"FileError: {path}: it ")


def test_a_recording_that_cannot_be_read_keeps_the_cause(tmp_path):
    path = tmp_path / "log.mat"
    DAMAGED["text"](path)
    with pytest.raises(FileError, match=r"cannot be read as a \.mat file") as caught:
        plaza_log.load(path, plaza_log.SETTINGS["plaza1"])
    assert caught.value.__cause__ is not None
    assert caught.value.path == str(path)


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        (
            {"GT": np.zeros((3, 3))},
            r"GT has shape \(3, 3\); numbers in 4 columns were due",
        ),
        ({"TD": np.array(["a", "b"])}, "the table TD is text; numbers in 4 columns were due"),
        (
            {"TD": np.full((2, 4), 7.0)},
            r"of 'radio', 1 row .* without a place, 7;",
        ),
    ],
)
def test_a_recording_of_other_tables(changes, told, tmp_path):
    mat(tmp_path / "log.mat", **changes)
    with pytest.raises((FileError, EvidenceError), match=told):
        plaza_log.load(tmp_path / "log.mat", plaza_log.SETTINGS["plaza1"])


def run(words, **settings):
    return subprocess.run(
        [sys.executable, "-m", "experiments", *map(str, words)],
        cwd=ROOT,
        check=False,
        stderr=subprocess.PIPE,
        **settings,
    )


def test_a_terminal_that_cannot_print_unicode(tmp_path):
    settings = os.environ | {"LC_ALL": "C", "PYTHONCOERCECLOCALE": "0", "PYTHONUTF8": "0"}
    words = ["imu_heading", "--out", tmp_path]
    found = run(words, stdout=subprocess.PIPE, env=settings)
    assert found.returncode == 0, found.stderr
    assert json.loads((tmp_path / "summary.json").read_text())["experiment"] == "imu_heading"
    assert found.stdout.isascii()


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="of Linux alone")
def test_an_output_that_cannot_be_written():
    with open("/dev/full", "wb") as full:
        found = run([], stdout=full)
    assert found.returncode == 1
    assert found.stderr.decode() == "OSError: [Errno 28] No space left on device\n"
