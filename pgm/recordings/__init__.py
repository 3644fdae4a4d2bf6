"""Recorded drives: readers of many kinds of files, all of which yield a `Recording`."""

from pgm.recordings.dropped import Dropped
from pgm.recordings.readers.freiburg import read_freiburg
from pgm.recordings.readers.labyrinth import read_labyrinth
from pgm.recordings.readers.plaza import read_plaza
from pgm.recordings.recording import Recording
from pgm.recordings.stream import Stream

__all__ = [
    "Dropped",
    "Recording",
    "Stream",
    "read_freiburg",
    "read_labyrinth",
    "read_plaza",
]
