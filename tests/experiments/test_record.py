"""What a record prints, and where it refuses to write."""

import errno
import json
from pathlib import Path

import matplotlib.pyplot as plt
import pytest
from matplotlib.figure import Figure

from experiments import record
from experiments.record import FolderError, Record, folder, table


@pytest.fixture
def narrow(monkeypatch):
    """A terminal of 80 columns."""
    monkeypatch.setenv("COLUMNS", "80")


@pytest.mark.usefixtures("narrow")
def test_a_wide_table_is_printed_whole(capsys):
    columns = [f"column {k:02d}" for k in range(12)]
    rows = [[f"{r} ± a long cell {k:02d}" for k in range(12)] for r in range(3)]
    table("Wide", columns, rows)
    title, _, head, _, *body, _ = capsys.readouterr().out.splitlines()
    assert title.strip() == "Wide"
    assert [cell.strip() for cell in head.strip("┃").split("┃")] == columns
    assert [[cell.strip() for cell in line.strip("│").split("│")] for line in body] == rows


@pytest.mark.usefixtures("narrow")
def test_a_long_title_keeps_its_words(capsys):
    words = [f"word{k}" for k in range(40)]
    table(" ".join(words), ("a [b]",), [(1.23456,), (2,)])
    printed = capsys.readouterr().out
    assert "…" not in printed
    assert printed.split("┏")[0].split() == words
    assert "a [b]" in printed
    assert "1.235" in printed


def test_a_folder_is_made_with_those_above_it(tmp_path):
    made = Record("name", tmp_path / "a" / "b").folder
    assert made == tmp_path / "a" / "b"
    assert list(made.iterdir()) == []


def test_a_folder_that_cannot_be_is_refused(tmp_path):
    taken = tmp_path / "taken"
    taken.write_text("")
    for path in (taken, taken / "below"):
        with pytest.raises(FolderError, match=r"into .*taken.* \(.+\); name another .* --out"):
            Record("name", path)


def test_a_folder_in_which_nothing_can_be_written_is_refused(tmp_path, monkeypatch):
    def refuses(dir):
        raise PermissionError(13, "Permission denied", str(dir))

    monkeypatch.setattr(record, "TemporaryFile", refuses)
    with pytest.raises(FolderError, match="Permission denied"):
        folder(tmp_path)


@pytest.fixture
def done(tmp_path):
    """A folder with the results of an earlier run."""
    _run(tmp_path, answer=1)
    return tmp_path


def _run(out, *, answer):
    record = Record("name", out, seed=answer)
    figure = plt.figure(figsize=(1, 1))
    record.figure(figure, "plot", "A plot.")
    plt.close(figure)
    record.summary(answer=answer)


def _fails(*arguments, **settings):
    raise OSError(errno.ENOSPC, "No space left on device")


def _torn(figure, path, **settings):
    Path(path).write_bytes(b"half")
    _fails()


def test_a_figure_that_cannot_be_written_leaves_results_as_they_were(done, monkeypatch):
    before = {path.name: path.read_bytes() for path in done.iterdir()}
    assert set(before) == {"plot.png", "plot.pdf", "summary.json"}
    monkeypatch.setattr(Figure, "savefig", _torn)
    with pytest.raises(FolderError, match=r"\(No space left on device\); name another"):
        _run(done, answer=2)
    assert {path.name: path.read_bytes() for path in done.iterdir()} == before


def test_an_earlier_summary_does_not_stand_beside_newer_figures(done, monkeypatch):
    """A second run that ends before its summary leaves none."""
    record = Record("name", done)
    assert (done / "summary.json").exists()
    figure = plt.figure(figsize=(1, 1))
    record.figure(figure, "plot", "A plot.")
    plt.close(figure)
    assert not (done / "summary.json").exists()


def test_a_summary_is_whole_or_as_it_was(tmp_path, monkeypatch):
    Record("name", tmp_path).summary(answer=1)
    write = Path.write_text

    def half(path, text, **settings):
        write(path, text[: len(text) // 2], **settings)
        _fails()

    monkeypatch.setattr(Path, "write_text", half)
    with pytest.raises(FolderError, match="No space left"):
        Record("name", tmp_path).summary(answer=2)
    (path,) = tmp_path.iterdir()
    assert json.loads(path.read_text())["answer"] == 1


def interrupted(file, content):
    with file as path:
        path.write_bytes(content)
        raise KeyboardInterrupt


def test_other_files_are_written_whole(done):
    record = Record("name", done)
    with pytest.raises(KeyboardInterrupt):
        interrupted(record.file("move.gif"), b"GIF")
    assert not (done / "move.gif").exists()
    assert (done / "summary.json").exists()
    with record.file("move.gif") as path:
        path.write_bytes(b"GIF89a")
    assert (done / "move.gif").read_bytes() == b"GIF89a"
    assert not (done / "summary.json").exists()
