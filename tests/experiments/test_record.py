"""What a record prints, and where it refuses to write."""

import pytest

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
