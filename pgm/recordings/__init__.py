"""Recorded drives: readers of many kinds of files, all of which yield a `Recording`."""

from pgm.io.dropped import Dropped
from pgm.recordings.drives.datum import Datum
from pgm.recordings.drives.pose_graph import Edges, PoseGraph
from pgm.recordings.drives.recording import Recording
from pgm.recordings.drives.scans import Scans
from pgm.recordings.drives.stream import Stream
from pgm.recordings.readers.bags import read_bag
from pgm.recordings.readers.barfoot import read_barfoot
from pgm.recordings.readers.euroc import read_euroc_imu
from pgm.recordings.readers.freiburg import read_freiburg
from pgm.recordings.readers.gpx import read_gpx, write_gpx
from pgm.recordings.readers.labyrinth import read_labyrinth
from pgm.recordings.readers.mrclam import read_mrclam
from pgm.recordings.readers.oxts import read_oxts
from pgm.recordings.readers.plaza import read_plaza
from pgm.recordings.readers.pose_graphs import read_pose_graph
from pgm.recordings.readers.tables import read_csv

__all__ = [
    "Datum",
    "Dropped",
    "Edges",
    "PoseGraph",
    "Recording",
    "Scans",
    "Stream",
    "read_bag",
    "read_barfoot",
    "read_csv",
    "read_euroc_imu",
    "read_freiburg",
    "read_gpx",
    "read_labyrinth",
    "read_mrclam",
    "read_oxts",
    "read_plaza",
    "read_pose_graph",
    "write_gpx",
]
