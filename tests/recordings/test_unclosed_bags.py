"""Bags whose recorder was killed, made of whole ones: what they still hold is read, and told."""

import shutil
import sqlite3
import struct
import sys

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from pgm.errors import FileError
from pgm.recordings import read_bag

pytest.importorskip("rosbags")
from lz4 import frame as lz4
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

TYPES = {1: get_typestore(Stores.ROS1_NOETIC), 2: get_typestore(Stores.ROS2_HUMBLE)}
COUNT = 40
FIRST = 4130  # where the first record begins, behind a header of 4 KiB


def twists(ros):
    types = TYPES[ros].types
    vector, twist = types["geometry_msgs/msg/Vector3"], types["geometry_msgs/msg/Twist"]
    header, time = types["std_msgs/msg/Header"], types["builtin_interfaces/msg/Time"]
    stamped = types["geometry_msgs/msg/TwistStamped"]
    for k in range(COUNT):
        more = {"seq": k} if ros == 1 else {}
        made = header(stamp=time(sec=100 + k, nanosec=0), frame_id="a" * 50, **more)
        yield stamped(made, twist(vector(1.0, 0.0, 0.0), vector(0.0, 0.0, 0.01 * k)))


def write(path, ros, compression=None, storage=None):
    if ros == 1:
        writer = Writer1(path)
        writer.chunk_threshold = 1000  # several messages a chunk
        if compression is not None:
            writer.set_compression(compression)
    else:
        writer = Writer2(path, version=9, storage_plugin=storage)
    with writer:
        kind = "geometry_msgs/msg/TwistStamped"
        connection = writer.add_connection("/twist", kind, typestore=TYPES[ros])
        code = TYPES[ros].serialize_ros1 if ros == 1 else TYPES[ros].serialize_cdr
        for k, message in enumerate(twists(ros)):
            writer.write(connection, (100 + k) * 10**9, code(message, kind))
            if storage is StoragePlugin.MCAP and k % 8 == 7:
                writer.storage.close_chunk()
    return path


def killed(path, keep=None):
    """The file of a bag of ROS 1 as its recorder left it: no index, and a share of its records."""
    data = bytearray(path.read_bytes())
    at = data.index(b"index_pos=") + len(b"index_pos=")
    index = struct.unpack_from("<Q", data, at)[0]
    data[at : at + 8] = bytes(8)
    path.write_bytes(data[: index if keep is None else FIRST + int(keep * (index - FIRST))])
    return path


def rates(drive):
    return drive.velocities["omega"]


COMPRESSIONS = [None, Writer1.CompressionFormat.BZ2, Writer1.CompressionFormat.LZ4]


@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_a_bag_without_an_index(tmp_path, compression):
    whole = write(tmp_path / "a.bag", 1, compression)
    due = rates(read_bag(whole))
    found = read_bag(killed(whole))
    assert_array_equal(rates(found), due)
    (told,) = found.dropped
    assert told.kept
    assert told.rows.size == COUNT
    assert told.fate == "of a bag that was not closed, read without its index"
    active = shutil.copyfile(whole, tmp_path / "b.bag.active")
    assert_array_equal(rates(read_bag(active)), due)


@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_a_bag_that_ends_within_a_chunk(tmp_path, compression):
    path = write(tmp_path / "a.bag", 1, compression)
    due = rates(read_bag(path))
    found = read_bag(killed(path, 0.6))
    assert 8 < len(rates(found)) < COUNT - 8
    assert_array_equal(rates(found), due[: len(rates(found))])
    assert "bytes at its end are no whole record" in found.dropped[0].fate
    cut = killed(write(tmp_path / "b.bag", 1, compression), 0.0)
    with pytest.raises(FileError, match="before it had written a message"):
        read_bag(cut)


def test_a_chunk_that_was_being_written_has_no_size_yet(tmp_path):
    """Its records stand behind an empty one, as a recorder mends the size when it is full."""
    path = killed(write(tmp_path / "a.bag", 1))
    data = bytearray(path.read_bytes())
    last = data.rindex(b"compression=none")
    header = data.rindex(b"op=\x05", 0, last + 100)
    begin = data.index(b"size=", min(header, last)) + len(b"size=") + 4
    ends = begin + 4 + struct.unpack_from("<I", data, begin)[0]
    data[begin : begin + 4] = bytes(4)
    path.write_bytes(data[: ends - 10])
    found = read_bag(path)
    assert len(rates(found)) >= COUNT - 9
    assert_array_equal(rates(found), 0.01 * np.arange(len(rates(found))))


@pytest.mark.parametrize("plugin", [StoragePlugin.SQLITE3, StoragePlugin.MCAP])
def test_a_folder_without_metadata(tmp_path, plugin):
    path = write(tmp_path / "a", 2, storage=plugin)
    due = rates(read_bag(path))
    (path / "metadata.yaml").unlink()
    found = read_bag(path)
    assert_array_equal(rates(found), due)
    assert "read without metadata.yaml" in found.dropped[0].fate
    file = next(path.glob("*"))
    assert_array_equal(rates(read_bag(file)), due)  # a file of it, by itself


@pytest.mark.parametrize("share", [1.0, 0.5])
def test_an_mcap_file_without_an_end(tmp_path, share):
    path = write(tmp_path / "a", 2, storage=StoragePlugin.MCAP)
    due = rates(read_bag(path))
    file = next(path.glob("*.mcap"))
    data = file.read_bytes()
    file.write_bytes(data[: int(share * len(data)) - 40])
    found = read_bag(path)
    assert 8 < len(rates(found)) <= COUNT
    assert_array_equal(rates(found), due[: len(rates(found))])
    assert "without its end" in found.dropped[0].fate
    file.write_bytes(data[:200])
    with pytest.raises(FileError, match="before it had written a message"):
        read_bag(path)


def packed(data, compression):
    """A file of MCAP whose first chunk is compressed, as far as that chunk goes."""
    at = 8
    while data[at] != 6:
        at += 9 + int.from_bytes(data[at + 1 : at + 9], "little")
    body = data[at + 9 : at + 9 + int.from_bytes(data[at + 1 : at + 9], "little")]
    records = body[40:]
    made = {
        "": lambda raw: raw,
        "lz4": lambda raw: lz4.compress(raw, block_size=lz4.BLOCKSIZE_MAX64KB, block_linked=False),
        "zstd": zstd.compress,
    }[compression](records)
    name = compression.encode()
    again = body[:28] + struct.pack("<I", len(name)) + name + struct.pack("<Q", len(made)) + made
    return data[:at] + b"\x06" + struct.pack("<Q", len(again)) + again


@pytest.mark.parametrize("compression", ["", "lz4", "zstd"])
def test_an_mcap_file_that_ends_within_its_only_chunk(tmp_path, monkeypatch, compression):
    monkeypatch.setitem(globals(), "COUNT", 2000)  # several blocks of a compressed chunk
    path = tmp_path / "a"
    writer = Writer2(path, version=9, storage_plugin=StoragePlugin.MCAP)
    kind = "geometry_msgs/msg/TwistStamped"
    with writer:
        connection = writer.add_connection("/twist", kind, typestore=TYPES[2])
        for k, message in enumerate(twists(2)):
            code = bytes(TYPES[2].serialize_cdr(message, kind))
            writer.write(connection, (100 + k) * 10**9, code)
    due = rates(read_bag(path))
    file = next(path.glob("*.mcap"))
    data = packed(file.read_bytes(), compression)
    file.write_bytes(data[: len(data) - len(data) // 3])
    found = read_bag(path)
    count = len(rates(found))
    assert 400 < count < COUNT
    assert_array_equal(rates(found), due[:count])
    assert f"without its end, with {count} messages of a chunk that is cut" in found.dropped[0].fate
    file.write_bytes(data[:400])
    with pytest.raises(FileError, match="before it had written a message"):
        read_bag(path)


def test_transactions_that_a_database_has_not_taken(tmp_path):
    path = write(tmp_path / "a", 2, storage=StoragePlugin.SQLITE3)
    due = rates(read_bag(path))
    file = next(path.glob("*.db3"))
    database = sqlite3.connect(file, isolation_level=None)
    database.execute("PRAGMA journal_mode = WAL")
    rows = database.execute("SELECT * FROM messages ORDER BY id").fetchall()
    database.execute("DELETE FROM messages WHERE id > 10")
    database.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    marks = ", ".join("?" * len(rows[0]))
    database.executemany(f"INSERT INTO messages VALUES ({marks})", rows[10:])
    killed = shutil.copytree(path, tmp_path / "b")  # with its -wal, while it is open
    database.close()
    found = read_bag(killed)
    assert_array_equal(rates(found), due)
    assert "transactions that its database had not taken" in found.dropped[0].fate
    assert list(killed.glob("*-wal"))  # the bag itself is as it was
