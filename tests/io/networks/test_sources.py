"""Sources that are damaged, too large, or not text."""

import gzip
import io

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
