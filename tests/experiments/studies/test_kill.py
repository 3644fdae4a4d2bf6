"""A study whose workers, and which itself, are killed with -9: nothing lost, nothing twice."""

import signal
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest
from distributed import KilledWorker

from experiments.studies import Study, StudyError, carrier
from experiments.studies.study import Part
from tests.experiments.studies import sweeps

ROOT = Path(__file__).parents[3]


def begun(words):
    """The command, in a process of its own."""
    return subprocess.Popen(
        [sys.executable, *words], cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.STDOUT
    )


def until(condition, seconds=180.0):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.02)


def workers(process):
    """The processes of the cluster's workers: those that were spawned."""
    found = psutil.Process(process.pid).children(recursive=True)
    return [each for each in found if "spawn_main" in " ".join(each.cmdline())]


def disturbed(words, parts, more):
    """Kill a worker, and all once it was replaced and there are more parts; how many there are."""
    process = begun(words)
    try:
        until(lambda: parts.is_dir() and any(parts.glob("0*")))
        before = workers(process)
        before[0].kill()
        until(lambda: len(list(parts.glob("0*"))) >= more, 600.0)
        until(lambda: {each.pid for each in workers(process)} - {each.pid for each in before})
        others = workers(process)
        process.send_signal(signal.SIGKILL)
        process.wait()
        # Workers end with the cluster that they belong to.
        until(lambda: not any(each.is_running() for each in others))
    finally:
        process.kill()
        process.stdout.close()
        process.wait()
    return len(list(parts.glob("0*")))


def same(folder, other):
    files = {file.name: file for file in (folder / "parts").iterdir()}
    assert files.keys() == {file.name for file in (other / "parts").iterdir()}
    for name, file in files.items():
        assert file.read_bytes() == (other / "parts" / name).read_bytes(), name


CODE = """
import sys
sys.path.insert(0, sys.argv[1])
from tests.experiments.studies.sweeps import dice
from experiments.studies import Study

if __name__ == "__main__":
    study = Study(dice, {"sides": [4, 20]}, runs=3000, part_size=50)
    study.run(sys.argv[2], workers=2, progress=False)
"""


@pytest.mark.slow
def test_a_study_that_is_killed_goes_on_where_it_was(tmp_path, client, monkeypatch):
    script, folder = tmp_path / "script.py", tmp_path / "study"
    script.write_text(CODE)
    study = Study(sweeps.dice, {"sides": [4, 20]}, runs=3000, part_size=50)
    with monkeypatch.context() as slowly:
        slowly.setenv("SECONDS_A_PART", "0.25")
        there = disturbed([str(script), str(ROOT), str(folder)], folder / "parts", more=8)
    assert 8 <= there < study.parts
    assert study.run(folder, scheduler=client, progress=False) == study.parts - there
    study.run(tmp_path / "other", scheduler=client, progress=False)
    same(folder, tmp_path / "other")


def test_a_part_that_ends_workers_is_told():
    error = KilledWorker("0-0-0", None, 3)
    found = carrier._failed(Study(sweeps.ends, runs=10), Part(0, 0), error)
    assert "(part 0 of 1) has ended its worker again and again" in str(found)


@pytest.mark.slow
def test_a_part_that_ends_its_workers_is_given_up(tmp_path):
    study = Study(sweeps.ends, runs=10)
    with pytest.raises(StudyError, match=r"has ended its worker again and again, .*part_size"):
        study.run(tmp_path, workers=1, progress=False)


@pytest.mark.slow
def test_a_million_runs_of_two_settings(tmp_path):
    """The command, undisturbed by one worker; and killed twice, with two."""
    over = {"lineariser": ["Taylor", "Unscented"], "steps": [20]}
    words = ["-m", "experiments", "sweep", "localisation", "--runs", "1000000"]
    for name, values in over.items():
        words += ["--over", f"{name}={','.join(map(str, values))}"]
    one, two = tmp_path / "one", tmp_path / "two"
    subprocess.run(
        [sys.executable, *words, "--folder", str(one), "--workers", "1"], cwd=ROOT, check=True
    )
    there = disturbed([*words, "--folder", str(two)], two / "parts", more=300)
    assert 300 <= there < 1000
    found = subprocess.run(
        [sys.executable, *words, "--folder", str(two)], cwd=ROOT, check=True, capture_output=True
    )
    assert f"{1000 - there:,} parts are missing" in found.stdout.decode()
    same(one, two)
