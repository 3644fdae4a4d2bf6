"""Sources that are damaged, too large, or not text."""

import gzip
import io
from pathlib import Path

import pytest
from files import same, written

import pgm
from models.discrete import sprinkler

DATA = written(pgm.write_bif, sprinkler())


@pytest.mark.parametrize("cut", [2, 12, -20, -4])
def test_gzip_that_is_cut(cut):
    with pytest.raises(pgm.FileError, match=r"it is gzipped, and damaged \("):
        pgm.read_bif(io.BytesIO(gzip.compress(DATA)[:cut]))


def test_gzip_with_a_wrong_checksum():
    data = bytearray(gzip.compress(DATA))
    data[-6] ^= 1
    with pytest.raises(pgm.FileError, match=r"gzipped, and damaged \(CRC"):
        pgm.read_bif(io.BytesIO(bytes(data)))


def test_gzip_in_several_members():
    data = gzip.compress(DATA[:100]) + gzip.compress(DATA[100:])
    same(sprinkler(), pgm.read_bif(io.BytesIO(data)))


@pytest.mark.parametrize("read", [pgm.read_bif, pgm.read_xmlbif, pgm.read_uai])
def test_a_bomb_is_unpacked_up_to_the_limit(read, monkeypatch):
    unpacked = 0

    class Counted(gzip.GzipFile):
        def read(self, size=-1):
            nonlocal unpacked
            piece = super().read(size)
            unpacked += len(piece)
            return piece

    bomb = io.BytesIO(gzip.compress(b" " * 10_000_000))
    monkeypatch.setattr(gzip, "GzipFile", Counted)
    with pytest.raises(pgm.FileError, match=r"more than 100000 bytes; .*raise the limit"):
        read(bomb, limit=100_000)
    assert unpacked == 100_001


@pytest.mark.parametrize("kind", [io.BytesIO, lambda data: io.StringIO(data.decode())])
def test_a_large_file_is_read_up_to_the_limit(kind):
    source = kind(DATA)
    with pytest.raises(pgm.FileError, match=f"more than {len(DATA) - 1} bytes"):
        pgm.read_bif(source, limit=len(DATA) - 1)
    source = kind(DATA + b" " * 1000)
    with pytest.raises(pgm.FileError):
        pgm.read_bif(source, limit=len(DATA))
    assert source.tell() == len(DATA) + 1
    same(sprinkler(), pgm.read_bif(kind(DATA), limit=len(DATA)))


def test_another_encoding(tmp_path):
    text = DATA.decode().replace("cloudy", "été")
    path = tmp_path / "été.bif"
    path.write_text(text, encoding="latin-1")
    message = r"été\.bif, line 3: the byte 0xe9 is no UTF-8; .*encoding='latin-1'"
    with pytest.raises(pgm.FileError, match=message):
        pgm.read_bif(path)
    with path.open(encoding="latin-1") as file:
        assert pgm.read_bif(file).variables[0].name == "été"
    with (
        path.open(encoding="utf-8") as file,
        pytest.raises(pgm.FileError, match="opened as utf-8, which it is not"),
    ):
        pgm.read_bif(file)


@pytest.mark.parametrize("limit", [None, 0, -1, True, 1e6, "1 GiB", float("nan")])
@pytest.mark.parametrize("read", [pgm.read_bif, pgm.read_xmlbif, pgm.read_uai])
def test_a_limit_is_a_number_of_bytes(read, limit):
    with pytest.raises(pgm.FileError, match=r"limit= is a whole number of bytes, such as 2\*\*28"):
        read(io.BytesIO(DATA), limit=limit)


def test_paths_of_other_kinds(tmp_path):
    class Place:
        def __fspath__(self):
            return str(tmp_path / "a.bif.gz")

    pgm.write_bif(sprinkler(), Place())
    assert Path(Place()).read_bytes().startswith(b"\x1f\x8b")
    same(sprinkler(), pgm.read_bif(Place()))


def test_files_that_are_closed_or_opened_for_something_else(tmp_path):
    path = tmp_path / "a.bif"
    with path.open("w", encoding="utf-8") as file:
        with pytest.raises(
            pgm.FileError, match=r"a\.bif: it cannot be read \(not readable\); is it"
        ):
            pgm.read_bif(file)
        pgm.write_bif(sprinkler(), file)
    with pytest.raises(pgm.FileError, match=r"cannot be read \(I/O operation on closed file"):
        pgm.read_bif(file)
    with pytest.raises(pgm.FileError, match=r"the target cannot be written \(.*closed file"):
        pgm.write_bif(sprinkler(), file)
    with path.open("rb") as file:
        with pytest.raises(pgm.FileError, match=r"the target cannot be written \("):
            pgm.write_bif(sprinkler(), file)
        same(sprinkler(), pgm.read_bif(file))


def test_names_that_an_encoding_has_no_letters_for(tmp_path):
    network = pgm.BayesianNetwork([pgm.TableCPD(pgm.Discrete("a", ("猫", "x")), table=[0.5, 0.5])])
    path = tmp_path / "a"
    with (
        path.open("w", encoding="latin-1") as file,
        pytest.raises(
            pgm.FileError, match="opened as latin-1, which has no '猫'; open it with enc"
        ),
    ):
        pgm.write_bif(network, file)
    with path.open("w", encoding="latin-1") as file:
        pgm.write_xmlbif(network, file)  # as a reference
    same(network, pgm.read_xmlbif(path))


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_lines_end_as_they_like(end):
    text = DATA.decode().replace("0.8", "0.9").replace("\n", end)
    line = DATA.decode().split("0.8")[0].count("\n") + 1
    with pytest.raises(pgm.FileError) as caught:
        pgm.read_bif(io.BytesIO(text.encode()))
    assert caught.value.line == line
    with pytest.raises(pgm.FileError) as caught:
        pgm.read_uai(io.StringIO(f"BAYES{end}1{end}2{end}1{end}1 0{end}x", newline=""))
    assert caught.value.line == 6


@pytest.mark.parametrize(
    ("write", "read"), [(pgm.write_bif, pgm.read_bif), (pgm.write_xmlbif, pgm.read_xmlbif)]
)
def test_names_are_no_more_than_the_limit_leaves_room_for(write, read):
    """A variable takes some hundred times as much memory as its declaration takes in a file."""
    cpds = [pgm.TableCPD(pgm.Discrete(f"v{k}", 1), table=[1.0]) for k in range(600)]
    data = written(write, pgm.BayesianNetwork(cpds))
    with pytest.raises(pgm.FileError, match=r"limit leaves room for; .*raise the limit") as caught:
        read(io.BytesIO(data), limit=2**17)
    assert "v512" in "".join(data.decode().splitlines()[caught.value.line - 1 :][:2])
    same(pgm.BayesianNetwork(cpds), read(io.BytesIO(data), limit=2**18))
