"""The guide to files: its program runs, and what it says of errors is so."""

import re
from pathlib import Path

import pytest

import pgm

GUIDE = (Path(__file__).parents[3] / "docs" / "files.md").read_text(encoding="utf-8")


def test_the_guides_program_runs(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (block,) = re.findall(r"^```python\n(.*?)^```", GUIDE, flags=re.MULTILINE | re.DOTALL)
    exec(compile(block, "files.md", "exec"), {})
    assert float(capsys.readouterr().out) == pytest.approx(0.1 * 0.4 / (0.1 * 0.4 + 0.9 * 0.08))


def test_the_guide_names_every_function():
    assert set(re.findall(r"`pgm\.(\w+)`", GUIDE)) == {*pgm.io.networks.__all__, "FileError"}
