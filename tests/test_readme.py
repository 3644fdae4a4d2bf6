"""Every program in the README runs as it is written, one after the other."""

import re
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).parent.parent
README = (ROOT / "README.md").read_text(encoding="utf-8")


def blocks(language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", README, flags=re.MULTILINE | re.DOTALL)


def test_programs_run_as_written(tmp_path, monkeypatch, capsys):
    matplotlib = pytest.importorskip("matplotlib")
    matplotlib.use("Agg")
    monkeypatch.chdir(tmp_path)
    (tmp_path / "docs").symlink_to(ROOT / "docs")
    namespace: dict[str, object] = {}
    for block in blocks("python"):
        exec(compile(block, "README.md", "exec"), namespace)
    matplotlib.pyplot.close("all")
    assert Path("drive.png").stat().st_size > 10_000
    printed = capsys.readouterr().out
    rmse = {name: float(value) for name, value in re.findall(r"(\w+) +RMSE ([\d.]+)", printed)}
    assert rmse["smoothed"] < rmse["filtered"]
    assert "OnlineBelief(filtered, step 5, over [x])" in printed
    (report,) = re.findall(r"^```\n(Timeline.*?)^```", README, flags=re.MULTILINE | re.DOTALL)
    shown, pose = report.strip().rsplit("\n", 1)
    assert shown in printed
    last = np.fromstring(printed.rsplit("[", 1)[1].rstrip("]\n"), sep=" ")
    np.testing.assert_allclose(last, np.fromstring(pose.strip("[]"), sep=" "), atol=1e-5)


def test_the_guides_program_runs_too(tmp_path, monkeypatch):
    matplotlib = pytest.importorskip("matplotlib")
    matplotlib.use("Agg")
    monkeypatch.chdir(tmp_path)
    guide = (ROOT / "docs" / "which_lineariser.md").read_text(encoding="utf-8")
    (block,) = re.findall(r"^```python\n(.*?)^```", guide, flags=re.MULTILINE | re.DOTALL)
    namespace: dict = {}
    exec(compile(blocks("python")[0], "README.md", "exec"), namespace)
    namespace["evidence"] = namespace["drawn"].evidence
    exec(compile(block, "which_lineariser.md", "exec"), namespace)
    matplotlib.pyplot.close("all")
    assert namespace["smoothed"].status.iterations > 1
    for picture in re.findall(r"!\[[^]]*\]\(([^)]+)\)", guide):
        assert (ROOT / "docs" / picture).is_file(), picture


def test_pictures_exist():
    for path in re.findall(r"!\[[^]]*\]\(([^)]+)\)", README):
        assert (ROOT / path).is_file(), path


def test_the_log_shown_is_the_log():
    (head,) = blocks("csv")
    assert (ROOT / "docs" / "log.csv").read_text(encoding="utf-8").startswith(head)


def test_both_commands_are_named():
    assert "make demo" in README
    assert "make test" in README
