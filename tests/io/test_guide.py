"""The guide to files: its programs run, and it names all that is there."""

import re
from pathlib import Path

import numpy as np
import pytest

import pgm

GUIDE = (Path(__file__).parents[2] / "docs" / "files.md").read_text(encoding="utf-8")


def test_the_guides_programs_run(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    networks, trajectories, _ = re.findall(
        r"^```python\n(.*?)^```", GUIDE, flags=re.MULTILINE | re.DOTALL
    )
    exec(compile(networks, "files.md", "exec"), {})
    assert float(capsys.readouterr().out) == pytest.approx(0.1 * 0.4 / (0.1 * 0.4 + 0.9 * 0.08))
    names: dict = {}
    exec(compile(trajectories, "files.md", "exec"), names)
    np.testing.assert_allclose(names["again"].mean, names["means"], atol=1e-15)


def test_the_guide_names_every_function():
    due = {*pgm.io.networks.__all__, "read_tum", "write_tum", "FileError"}
    due |= {"read_kitti", "write_kitti", "read_euroc", "compare"}
    assert set(re.findall(r"`pgm\.(\w+)`", GUIDE)) == due
