"""Kernels on the disk: whatever has become of a file, the kernel is compiled and written anew."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("numba", reason="kernels are compiled by Numba")

KERNEL = '''
"""A small kernel, through the store of the large ones."""
import json, os, random, sys
from pathlib import Path
from pgm.kernels.compiled.memory import kept, ready

FOLDER = Path(os.environ["NUMBA_CACHE_DIR"])

def entry(stamp):
    def tripled(x):
        return 3.0 * x + stamp
    return kept(tripled, "tripled")

def loaded(stamp=1):
    """Whether a process that begins now finds the kernel on the disk; it is right in any case."""
    kernel = entry(stamp)
    ready(kernel, "float64(float64)")
    assert kernel(2.0) == 6.0 + stamp
    return bool(kernel.stats.cache_hits)

def files():
    return [path for path in FOLDER.rglob("*") if path.is_file()]
'''


@pytest.fixture
def run(tmp_path):
    """A Python program beside the kernel, with a folder of its own for machine code; its output."""
    (tmp_path / "kernel.py").write_text(KERNEL)
    root = Path(__file__).resolve().parents[2]

    def started(program, folder=tmp_path / "cache"):
        return subprocess.Popen(
            [sys.executable, "-W", "error", "-c", f"from kernel import *\n{program}"],
            env=os.environ
            | {"NUMBA_CACHE_DIR": str(folder), "PYTHONPATH": f"{tmp_path}{os.pathsep}{root}"},
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )

    def output(program, **given):
        process = started(program, **given)
        out, err = process.communicate(timeout=300)
        assert process.returncode == 0, err
        return out.strip(), err.strip()

    output.started = started
    return output


def test_every_damage_is_mended(run):
    """Bits flipped anywhere, files cut, emptied, of another kernel, unreadable or away."""
    told, _ = run("""
assert not loaded() and loaded()
draw, (file,) = random.Random(5), files()
whole, wrong = file.read_bytes(), 0
assert not loaded(2)  # another source takes the place of the first
other = file.read_bytes()

def flipped():
    data, bit = bytearray(whole), draw.randrange(8 * len(whole))
    data[bit // 8] ^= 1 << bit % 8
    return bytes(data)

damages = [b"", whole[:7], whole[:32], whole[:-1], whole[:len(whole) // 2], whole + b"!", other]
damages += [bytes(len(whole)), whole[::-1], b"\\x80\\x04."] + [flipped() for _ in range(30)]
for data in damages:
    file.write_bytes(data)
    wrong += loaded()
    assert loaded(), "it was not made anew"
file.unlink()
assert not loaded() and loaded()
file.unlink()
file.mkdir()  # which can neither be read nor written over
assert not loaded() and not loaded()
print(wrong, len(damages), len(files()))
""")
    assert told == "0 40 0"


@pytest.mark.skipif(os.name == "nt" or not os.getuid(), reason="permissions do not bind here")
def test_a_folder_or_a_file_that_is_closed(run):
    told, _ = run("""
assert not loaded()
file, = files()
file.chmod(0o000)
print(loaded(), loaded())  # it is written over
file.unlink()
kernel = entry(1)
file.parent.chmod(0o500)
ready(kernel, "float64(float64)")
print(kernel(2.0), files())
file.parent.chmod(0o700)
""")
    assert told.splitlines() == ["False True", "7.0 []"]


def test_a_disk_that_is_full_costs_no_answer(run):
    told, _ = run("""
def full(path, data):
    path.open("wb").write(data[:10])
    raise OSError(28, "No space left on device")
write, Path.write_bytes = Path.write_bytes, full
print(loaded(), files())
Path.write_bytes = write
print(loaded(), loaded())
""")
    assert told.splitlines() == ["False []", "False True"]


@pytest.mark.slow
def test_processes_that_write_at_once(run):
    """Two processes write over each other's file; each finds its own kernel whole, or none."""
    each = [
        run.started(f"for _ in range(25): loaded({stamp})\nprint('done', len(files()))")
        for stamp in (1, 2)
    ]
    ends = [process.communicate(timeout=300) for process in each]
    assert [out[:4] for out, _ in ends] == ["done"] * 2, ends
    told, _ = run("""
file, = files()
last = file.read_bytes()
first = loaded(1)
file.write_bytes(last)
print(first != loaded(2))
""")
    assert told == "True"


def test_compiling_is_told_of_once_and_where_it_is_kept(run, tmp_path):
    """On the standard error of a plain script, warnings being errors; a warm start says nothing."""
    told = [run("loaded(1); loaded(2)")[1], run("loaded(2)")[1]]
    assert told[0].count("compiling the sweeps to machine code") == 1
    assert "once on this machine" in told[0]
    assert str(tmp_path / "cache") in told[0]
    assert told[1] == ""


def test_a_program_may_keep_it_from_being_told(run):
    quiet = "import logging; logging.getLogger('pgm').setLevel('ERROR'); loaded()"
    assert run(quiet)[1] == ""
