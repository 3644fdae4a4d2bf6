"""A study's folder takes nothing but whole parts of its own study, and says what else it finds."""

import json
import shutil

import pyarrow.parquet as pq
import pytest

from experiments.studies import Study, StudyError, folder
from tests.experiments.studies import sweeps


def study(function=sweeps.dice, *over, **changes):
    settings = {"over": {"sides": [4, 20]}} if function is sweeps.dice else {}
    return Study(function, **({"runs": 2500, "part_size": 1000, "seed": 3} | settings | changes))


@pytest.fixture(scope="module")
def done(client, tmp_path_factory):
    path = tmp_path_factory.mktemp("done")
    assert study().run(path, scheduler=client, progress=False) == 6
    return path


@pytest.fixture
def copy(done, tmp_path):
    return shutil.copytree(done, tmp_path / "copy")


def test_a_finished_study_is_left_alone(copy):
    before = {file: file.stat() for file in copy.rglob("*")}
    assert study().run(copy, scheduler=3) == 0
    assert {file: file.stat() for file in copy.rglob("*")}.keys() == before.keys()
    for file, stat in before.items():
        assert file.stat().st_mtime_ns == stat.st_mtime_ns


def test_a_part_that_is_gone_is_worked_out_again_bit_by_bit(copy, done, client):
    gone = copy / "parts" / "0001-000001.parquet"
    gone.unlink()
    assert study().run(copy, scheduler=client, progress=False) == 1
    for file in (done / "parts").iterdir():
        assert (copy / "parts" / file.name).read_bytes() == file.read_bytes()


@pytest.mark.parametrize(
    ("other", "told"),
    [
        ({"seed": 4}, "seed 3, here 4"),
        ({"runs": 2600}, "runs 2500, here 2600"),
        ({"part_size": 500}, "part_size 1000, here 500"),
        ({"over": {"sides": [4, 6]}}, r"over \{'sides': \[4, 20\]\}, here \{'sides': \[4, 6\]\}"),
        ({"over": {"sides": [20, 4]}}, "holds another study"),
    ],
)
def test_another_study_is_refused(other, told, copy):
    for call in (Study.run, Study.table):
        with pytest.raises(StudyError, match=told):
            call(study(**other), copy)


def test_other_versions_are_refused(copy):
    manifest = json.loads((copy / "study.json").read_text())
    manifest["versions"] |= {"numpy": "1.26.0", "jax": "0.10"}
    (copy / "study.json").write_text(json.dumps(manifest))
    with pytest.raises(StudyError, match=r"numpy 1\.26\.0, here 2.*; jax 0\.10, here none; go on"):
        study().run(copy)


@pytest.mark.parametrize("content", ["", "[1]", "{}", '{"figures": 3}'])
def test_a_damaged_manifest_is_refused(content, copy):
    (copy / "study.json").write_text(content)
    with pytest.raises(StudyError, match=r"study\.json cannot be read"):
        study().run(copy)


def test_a_folder_of_something_else_is_refused(tmp_path):
    (tmp_path / "thesis.tex").touch()
    with pytest.raises(StudyError, match=r"holds something else, and no study\.json"):
        study().run(tmp_path)
    with pytest.raises(StudyError, match="holds something else"):
        study().run(tmp_path / "thesis.tex")
    with pytest.raises(StudyError, match="no study was begun there"):
        study().table(tmp_path)


def test_one_killed_before_its_manifest_was_there_goes_on(tmp_path, client):
    (tmp_path / ".study.123-abc.json").write_text("{")
    assert study().run(tmp_path, scheduler=client, progress=False) == 6


def test_what_killed_processes_left_beside_is_tidied_away(copy, client):
    beside = copy / "parts" / ".0001-000001.123-abc.parquet"
    beside.write_bytes(b"PAR1")
    (copy / "parts" / "0001-000001.parquet").unlink()
    study().run(copy, scheduler=client, progress=False)
    assert not beside.exists()
    assert len(list((copy / "parts").iterdir())) == 6


def cut(file):
    file.write_bytes(file.read_bytes()[:-100])


def emptied(file):
    file.write_bytes(b"")


def shortened(file):
    table = pq.read_table(file)
    pq.write_table(table.slice(0, 10), file)


def flipped(file):
    data = bytearray(file.read_bytes())
    data[len(data) // 3] ^= 1
    file.write_bytes(data)


@pytest.mark.parametrize("damage", [cut, emptied, shortened, flipped])
def test_a_damaged_part_is_refused_with_what_to_do(damage, copy, client):
    file = copy / "parts" / "0000-000002.parquet"
    damage(file)
    with pytest.raises(StudyError, match=f"{file} is damaged .*; delete it and run the study"):
        study().table(copy)
    file.unlink()
    study().run(copy, scheduler=client, progress=False)
    assert study().table(copy).parts == 6


def test_parts_of_others_are_refused(copy, client, tmp_path):
    parts = copy / "parts"
    study(seed=5).run(tmp_path / "other", scheduler=client, progress=False)
    shutil.copy(tmp_path / "other" / "parts" / "0000-000001.parquet", parts)
    with pytest.raises(StudyError, match=r"0000-000001\.parquet is of another study or part"):
        study().run(copy)
    shutil.copy(parts / "0000-000000.parquet", parts / "0000-000001.parquet")
    with pytest.raises(StudyError, match=r"0000-000001\.parquet is of another study or part"):
        study().run(copy)


@pytest.mark.parametrize("name", ["notes.txt", "0002-000000.parquet", "0000-000003.parquet"])
def test_files_that_are_no_parts_are_refused(name, copy):
    (copy / "parts" / name).touch()
    with pytest.raises(StudyError, match=f"{name} is no part of the study; move it elsewhere"):
        study().run(copy)


def test_figures_that_come_out_otherwise_are_refused(tmp_path, client):
    own = study(sweeps.other_draws, runs=10, part_size=10)
    place = folder.Folder.begin(tmp_path, own)
    first, figures = next(own.each()), own.part(0, 0)
    place.keep(first, figures)
    place.keep(first, figures)
    with pytest.raises(StudyError, match=r"worked out twice, with other figures \(x\)"):
        place.keep(first, own.part(0, 0))


def test_a_full_disk_keeps_what_is_there(tmp_path, client, monkeypatch):
    def fails(*arguments, **settings):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(pq, "write_table", fails)
    with pytest.raises(StudyError, match=r"cannot be written into \(No space left on device\)"):
        study().run(tmp_path, scheduler=client, progress=False)
    monkeypatch.undo()
    assert study().run(tmp_path, scheduler=client, progress=False) == 6
