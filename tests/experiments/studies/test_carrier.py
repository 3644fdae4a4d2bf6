"""Parts are carried to workers and back, whoever else works on the folder; errors are told."""

import re
import threading

import pytest
from distributed import Client

from experiments.studies import Study, StudyError, carrier, errors
from experiments.studies.command import Lines, duration
from tests.experiments.studies import sweeps


def test_calls_that_share_a_folder_share_its_parts(client, tmp_path):
    study = Study(sweeps.dice, {"seconds": [0.01]}, runs=400, part_size=10)
    kept, told = [], []

    def run():
        with Client(client.cluster) as own:
            told.append(study.run(tmp_path, scheduler=own, progress=lambda d, n: kept.append(d)))

    threads = [threading.Thread(target=run) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(list((tmp_path / "parts").iterdir())) == study.parts == 40
    assert len(told) == 2
    rows = study.table(tmp_path).rows
    alone = Study(sweeps.dice, {"seconds": [0.01]}, runs=400, part_size=10)
    alone.run(tmp_path / "alone", scheduler=client, progress=False)
    assert alone.table(tmp_path / "alone").rows == rows


def test_progress_is_told(client, tmp_path):
    told = []
    study = Study(sweeps.dice, runs=30, part_size=10)
    study.run(tmp_path, scheduler=client, progress=lambda *each: told.append(each))
    assert told == [(0, 3), (1, 3), (2, 3), (3, 3)]


def test_an_error_in_a_part_is_told_once_with_its_seed(client, tmp_path):
    study = Study(sweeps.fails, {"at": [5]}, runs=10, seed=8, part_size=10)
    told = re.escape(
        "sweeps.fails (at=5, part 0 of 1) fails with ZeroDivisionError: no 5; it is repeated by "
        "Study(...).part(0, 0), of seed 8 with the spawn key (0, 0)"
    )
    with pytest.raises(StudyError, match=told) as caught:
        study.run(tmp_path, scheduler=client, progress=False)
    assert isinstance(caught.value.__cause__, ZeroDivisionError)
    with pytest.raises(ZeroDivisionError):
        study.part(0, 0)


def test_a_part_of_other_figures_is_refused(client, tmp_path):
    study = Study(sweeps.changing, runs=10)
    with pytest.raises(StudyError, match=r"has the figures \{'y': 'float64'\}; its study has"):
        study.run(tmp_path, scheduler=client, progress=False)


def test_a_worker_of_other_versions_is_refused(client, tmp_path, monkeypatch):
    study = Study(sweeps.dice, runs=10)
    real = carrier.versions
    first = threading.current_thread()

    def there(module):
        own = threading.current_thread() is first
        return real(module) | ({} if own else {"numpy": "1.26.0"})

    monkeypatch.setattr(carrier, "versions", there)
    with pytest.raises(StudyError, match=r"a worker has other versions.*numpy .*, there 1\.26\.0"):
        study.run(tmp_path, scheduler=client, progress=False)


def test_a_scheduler_that_is_not_there_is_told(tmp_path, monkeypatch):
    monkeypatch.setattr(carrier, "PATIENCE", 0.2)
    study = Study(sweeps.dice, runs=10)
    with pytest.raises(StudyError, match=r"no scheduler with a worker is at tcp://127\.0\.0\.1:9 "):
        study.run(tmp_path, scheduler="tcp://127.0.0.1:9", progress=False)


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ({"workers": 0}, "workers= is a whole number, 1 or more; found 0"),
        ({"scheduler": 3}, r"scheduler= is an address or a distributed\.Client; found 3"),
    ],
)
def test_workers_that_cannot_be_are_refused(given, told, tmp_path):
    with pytest.raises(StudyError, match=told):
        Study(sweeps.dice, runs=10).run(tmp_path, **given)


def test_missing_packages_are_named(tmp_path, monkeypatch):
    monkeypatch.setattr(errors, "find_spec", lambda name: None)
    told = r"studies need pyarrow and distributed, not installed here: pip install '\.\[studies\]'"
    with pytest.raises(StudyError, match=told):
        Study(sweeps.dice, runs=10).run(tmp_path / "new")
    assert not (tmp_path / "new").exists()


def test_lines_estimate_the_rest(monkeypatch):
    now, told = [0.0], []
    monkeypatch.setattr("experiments.studies.command.monotonic", lambda: now[0])
    lines = Lines(told.append)
    lines(0, 1000)
    for done in (1, 101, 1000):
        now[0] += 30.0
        lines(done, 1000)
    assert told == [
        "1,000 parts are missing",
        "101 of 1,000 parts, about 4 min left",
        "1,000 of 1,000 parts, 90 s",
    ]
    assert [duration(x) for x in (3.2, 7200.0, 1e6)] == ["3 s", "2 h", "12 d"]
