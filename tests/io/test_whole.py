"""Files are written whole or not at all: what was there before is there after a failure."""

import errno
import os
import subprocess
import sys
from pathlib import Path

import pytest

import pgm
from models.discrete import sprinkler
from pgm.io.sources import whole

WRITERS = {"bif": pgm.write_bif, "xmlbif": pgm.write_xmlbif, "bif.gz": pgm.write_bif}


@pytest.fixture
def full(monkeypatch):
    """A disk that is full once half of a file is written."""
    write = Path.write_bytes

    def half(path, data):
        write(path, data[: len(data) // 2])
        raise OSError(errno.ENOSPC, "No space left on device", str(path))

    monkeypatch.setattr(Path, "write_bytes", half)


@pytest.mark.parametrize("ending", WRITERS)
@pytest.mark.usefixtures("full")
def test_a_network_that_cannot_be_written_leaves_the_one_before(tmp_path, ending):
    target = tmp_path / f"net.{ending}"
    target.write_text("good")
    with pytest.raises(OSError, match="No space left"):
        WRITERS[ending](sprinkler(), target)
    assert target.read_text() == "good"
    assert list(tmp_path.iterdir()) == [target]


@pytest.mark.parametrize("ending", WRITERS)
def test_a_network_takes_the_place_of_one_before(tmp_path, ending):
    target = tmp_path / f"net.{ending}"
    target.write_text("good")
    WRITERS[ending](sprinkler(), target)
    read = pgm.read_xmlbif if ending == "xmlbif" else pgm.read_bif
    assert read(target).variables == sprinkler().variables
    assert list(tmp_path.iterdir()) == [target]


def test_a_process_that_is_killed_leaves_the_file_before(tmp_path):
    target = tmp_path / "summary.json"
    target.write_text("good")
    code = (
        "import os, sys\n"
        "from pgm.io.sources import whole\n"
        "with whole(sys.argv[1]) as path:\n"
        "    path.write_text('ha')\n"
        "    os.kill(os.getpid(), 9)\n"
    )
    root = Path(pgm.__file__).parents[1]
    found = subprocess.run([sys.executable, "-c", code, str(target)], cwd=root, check=False)
    assert found.returncode == -9
    assert target.read_text() == "good"


def test_the_mode_of_a_file_is_kept(tmp_path):
    target = tmp_path / "net.bif"
    target.write_text("good")
    target.chmod(0o604)
    pgm.write_bif(sprinkler(), target)
    assert target.stat().st_mode & 0o777 == 0o604


def test_a_link_still_points_to_its_file(tmp_path):
    target, link = tmp_path / "net.bif", tmp_path / "latest.bif"
    target.write_text("good")
    link.symlink_to(target)
    pgm.write_bif(sprinkler(), link)
    assert link.is_symlink()
    assert "network" in target.read_text()


@pytest.mark.skipif(not os.path.exists("/proc/self/fd"), reason="of Linux alone")
def test_a_durable_file_is_on_the_disk_before_it_has_its_name(tmp_path, monkeypatch):
    target, synced = tmp_path / "part.bin", []
    sync = os.fsync

    def told(file):
        place = Path(os.readlink(f"/proc/self/fd/{file}"))
        synced.append((place.is_dir(), target.exists()))
        sync(file)

    monkeypatch.setattr(os, "fsync", told)
    with whole(target, durable=True) as path:
        path.write_bytes(b"figures")
    assert target.read_bytes() == b"figures"
    assert synced == [(False, False), (True, True)]


def test_two_that_write_at_once_do_not_meet(tmp_path):
    with whole(tmp_path / "part.bin") as one, whole(tmp_path / "part.bin") as other:
        assert one != other
        one.write_text("one")
        other.write_text("other")
    assert (tmp_path / "part.bin").read_text() == "one"


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="of Linux alone")
def test_a_device_is_written_directly():
    with pytest.raises(OSError, match="No space left"):
        pgm.write_bif(sprinkler(), "/dev/full")
    pgm.write_bif(sprinkler(), "/dev/null")
    assert not Path("/dev/null").is_file()


def interrupted(target):
    with whole(target) as path:
        path.write_text("half")
        assert path.parent == target.parent
        assert path.suffix == ".png"
        raise KeyboardInterrupt


def test_what_stands_beside_ends_alike_and_is_gone_after(tmp_path):
    with pytest.raises(KeyboardInterrupt):
        interrupted(tmp_path / "plot.png")
    assert list(tmp_path.iterdir()) == []
