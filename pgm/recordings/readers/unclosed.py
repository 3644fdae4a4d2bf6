"""Bags whose recorder was killed: copies that have what it left out, an index or an end."""

from __future__ import annotations

import bz2
import os
import shutil
import sqlite3
import struct
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pgm.resources import optional

EXTRA = "sepset[bags]"
_ROSBAG, _MCAP = b"#ROSBAG V2.0\n", b"\x89MCAP0\r\n"
# Kinds of records in a bag of ROS 1.
_MESSAGE, _CHUNK, _CONNECTION = 2, 5, 7
# MCAP's records of the end of data and of a file without a summary, and the largest kind.
_END = b"\x0f" + struct.pack("<QI", 4, 0) + b"\x02" + struct.pack("<QQQI", 20, 0, 0, 0)
_KINDS = 0x0F
# Its chunk, and the records in one that are kept: schemas, channels and messages.
_MCAP_CHUNK, _MCAP_MESSAGE, _KEPT = 0x06, 0x05, (0x03, 0x04, 0x05)
# What SQLite leaves beside a database that was not closed.
_BESIDE = ("-wal", "-journal")


@dataclass(frozen=True, slots=True)
class Closed:
    """Paths that rosbags opens, whether they are of ROS 2, and what was mended, in words."""

    paths: list[Path]
    second: bool
    mended: str = ""


def closed(where: Path, scratch: Path) -> Closed:
    """The files of a bag; a copy in a folder, of those that were not closed."""
    if where.is_file() and _begins(where, _ROSBAG):
        if _indexed(where) and where.suffix == ".bag":
            return Closed([where], False)
        copy = scratch / "mended.bag"
        lost = _reindexed(where, copy)
        return Closed([copy], False, "" if _indexed(where) else _words("its index", lost))
    files = [where]
    if where.is_dir():
        files = sorted(p for p in where.iterdir() if p.suffix in (".db3", ".mcap"))
    told, found = [], []
    for file in files:
        said, path = _mended(file, scratch)
        found.append(path)
        told += [said] if said else []
    if where.is_dir() and not told:
        if (where / "metadata.yaml").exists() or not files:
            return Closed([where], True)
        told.append("without metadata.yaml")
    return Closed(found, True, "; ".join(told))


def _mended(file: Path, scratch: Path) -> tuple[str, Path]:
    """Words of what was mended of a file of ROS 2, and the path of the file or its copy."""
    if file.suffix == ".db3" and any(_size(Path(f"{file}{end}")) for end in _BESIDE):
        copy = scratch / file.name
        for end in ("", *_BESIDE):
            if (beside := Path(f"{file}{end}")).exists():
                shutil.copyfile(beside, f"{copy}{end}")
        # Opened and checkpointed: rosbags reads the database alone.
        database = sqlite3.connect(copy)
        database.execute("PRAGMA journal_mode = DELETE")
        database.execute("SELECT count(*) FROM sqlite_master").fetchall()
        database.close()
        return "with transactions that its database had not taken", copy
    if file.suffix == ".mcap" and _begins(file, _MCAP) and not _ends(file, _MCAP):
        copy = scratch / file.name
        return _ended(file, copy), copy
    return "", file


def _words(what: str, lost: int) -> str:
    beside = f", and {lost} bytes at its end are no whole record" if lost else ""
    return f"without {what}{beside}"


def _ended(file: Path, copy: Path) -> str:
    """Copy an MCAP file's whole records, of a cut chunk too, and an end; tell of it in words."""
    size = file.stat().st_size
    with file.open("rb") as source, copy.open("wb") as target:
        end, cut = source.seek(len(_MCAP)), b""
        while len(head := source.read(9)) == 9:
            kind, length = head[0], struct.unpack("<Q", head[1:])[0]
            if not 0 < kind < _KINDS:
                break
            if end + 9 + length > size:
                cut = source.read() if kind == _MCAP_CHUNK else b""
                break
            end = source.seek(end + 9 + length)
        source.seek(0)
        for part in _pieces(source, end):
            target.write(part)
        kept, messages = _of_chunk(cut)
        target.write(kept + _END + _MCAP)
    if messages:
        return f"without its end, with {messages} messages of a chunk that is cut"
    return _words("its end", size - end)


def _of_chunk(body: bytes) -> tuple[bytes, int]:
    """The records that are whole in a chunk of MCAP whose end is cut, and how many are messages."""
    if len(body) < 32:
        return b"", 0
    begin = 32 + int.from_bytes(body[28:32], "little")
    data = _begun(body[begin + 8 :], body[32:begin])
    kept, messages, at = [], 0, 0
    while at + 9 <= len(data):
        ends = at + 9 + int.from_bytes(data[at + 1 : at + 9], "little")
        if ends > len(data):
            break
        if data[at] in _KEPT:
            kept.append(data[at:ends])
            messages += data[at] == _MCAP_MESSAGE
        at = ends
    return b"".join(kept), messages


def _begun(data: bytes, compression: bytes) -> bytes:
    """The unpacked beginning of data whose end is cut."""
    found: bytes
    if compression == b"lz4":
        found = optional("lz4.frame", "read_bag", EXTRA).LZ4FrameDecompressor().decompress(data)
    elif compression == b"zstd":
        module = "compression.zstd" if sys.version_info >= (3, 14) else "backports.zstd"
        found = optional(module, "read_bag", EXTRA).ZstdDecompressor().decompress(data)
    else:
        found = data if not compression else b""
    return found


def _pieces(source: Any, size: int) -> Iterator[bytes]:
    while size > 0 and (part := source.read(min(size, 2**24))):
        size -= len(part)
        yield part


def _indexed(file: Path) -> bool:
    """Whether a bag of ROS 1 says where its index is, within the file."""
    with file.open("rb") as source:
        source.seek(len(_ROSBAG))
        header = _header(source.read(2**12), 0)
    if header is None or len(at := header[0].get("index_pos", b"")) != 8:
        return True  # damaged elsewhere, as reading it will say
    return 0 < int.from_bytes(at, "little") < file.stat().st_size


def _reindexed(file: Path, copy: Path) -> int:
    """Write the messages of a bag of ROS 1 anew; the number of bytes at its end left out."""
    writer = optional("rosbags.rosbag1", "read_bag", EXTRA).Writer(copy)
    data = file.read_bytes()
    known: dict[int, Any] = {}
    with writer:
        return len(data) - _records(data, len(_ROSBAG), writer, known)


def _records(data: bytes, at: int, writer: Any, known: dict[int, Any]) -> int:
    """Write messages from records at a place on; where the last whole record ends."""
    while (found := _header(data, at)) is not None:
        fields, begin = found
        if begin + 4 > len(data):
            return at
        size = int.from_bytes(data[begin : begin + 4], "little")
        body, kind = data[begin + 4 : begin + 4 + size], fields["op"][0]
        if len(body) < size:
            return at
        if kind == _CHUNK and size:
            _records(_unpacked(body, fields["compression"]), 0, writer, known)
        elif kind == _CONNECTION:
            _connect(fields, body, writer, known)
        elif kind == _MESSAGE:
            seconds, rest = struct.unpack("<II", fields["time"])
            connection = known[int.from_bytes(fields["conn"], "little")]
            writer.write(connection, seconds * 10**9 + rest, body)
        at = begin + 4 + size
    return at


def _connect(fields: dict[str, bytes], body: bytes, writer: Any, known: dict[int, Any]) -> None:
    number = int.from_bytes(fields["conn"], "little")
    if number in known:
        return
    told = _fields(body)
    if told is None:
        return
    package, _, name = told["type"].decode().rpartition("/")
    known[number] = writer.add_connection(
        fields["topic"].decode(),
        f"{package}/msg/{name}",
        msgdef=told["message_definition"].decode(),
        md5sum=told["md5sum"].decode(),
        callerid=told["callerid"].decode() if "callerid" in told else None,
        latching=int(told["latching"]) if "latching" in told else None,
    )


def _unpacked(body: bytes, compression: bytes) -> bytes:
    if compression == b"bz2":
        return bz2.decompress(body)
    if compression == b"lz4":
        found: bytes = optional("lz4.frame", "read_bag", EXTRA).decompress(body)
        return found
    return body


def _header(data: bytes, at: int) -> tuple[dict[str, bytes], int] | None:
    """The fields of a record's header, and where it ends; None where none is whole."""
    size = int.from_bytes(data[at : at + 4], "little")
    block = data[at + 4 : at + 4 + size]
    if not size or len(block) < size:
        return None
    fields = _fields(block)
    whole = fields is not None and len(fields.get("op", b"")) == 1
    return (fields, at + 4 + size) if whole and fields is not None else None


def _fields(block: bytes) -> dict[str, bytes] | None:
    found, at = {}, 0
    while at < len(block):
        size = int.from_bytes(block[at : at + 4], "little")
        name, equals, value = block[at + 4 : at + 4 + size].partition(b"=")
        if not equals or at + 4 + size > len(block):
            return None
        found[name.decode("latin-1")] = value
        at += 4 + size
    return found


def _begins(file: Path, magic: bytes) -> bool:
    with file.open("rb") as source:
        return source.read(len(magic)) == magic


def _ends(file: Path, magic: bytes) -> bool:
    with file.open("rb") as source:
        source.seek(-min(len(magic), _size(file)), os.SEEK_END)
        return source.read() == magic


def _size(file: Path) -> int:
    return file.stat().st_size if file.exists() else 0
