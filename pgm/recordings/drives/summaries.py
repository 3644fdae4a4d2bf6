"""The lines of a recording that is printed."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from pgm.display import count
from pgm.io.stamped import clock
from pgm.recordings.drives.stream import Stream

if TYPE_CHECKING:
    from pgm.recordings.drives.recording import Recording


KINDS = {"odometry": ("increment",), "velocities": ("velocity", "velocities")}


def streams(recording: Recording) -> Iterator[tuple[str, Stream]]:
    """Each stream of a recording with its name, in order."""
    for name in ("odometry", "velocities", "imu", "fixes"):
        if (stream := getattr(recording, name)) is not None:
            yield name, stream
    yield from recording.sightings.items()
    if recording.truth is not None:
        yield "truth", recording.truth


def span(recording: Recording) -> str:
    """The first and the last time of all streams, in words."""
    ends = [each.begin for _, each in streams(recording) if each.begin is not None]
    for stamps in (
        *(each.stamps for _, each in streams(recording)),
        *(each.stamps for each in recording.scans.values()),
    ):
        ends += stamps[[0, -1]].tolist() if stamps.size else []
    return f", {clock(min(ends))} to {clock(max(ends))}" if ends else ""


def rows(recording: Recording) -> list[tuple[str, str]]:
    """A line for each stream, for the landmarks, and for each fate of rows."""
    found = [(name, _line(name, stream)) for name, stream in streams(recording)]
    if recording.landmarks:
        known = f", {len(recording.landmark_cov)} with covariances" * bool(recording.landmark_cov)
        found.append(("landmarks", f"{len(recording.landmarks)}{known}"))
    for name, scans in recording.scans.items():
        found.append((name, f"{count(len(scans), 'scan')} of {count(scans.angles.size, 'ray')}"))
    for name, mount in recording.mounts.items():
        where = ", ".join(f"{number:.4g}" for number in mount)
        found.append((name, f"mounted at forward, left, turn = {where}"))
    if recording.datum is not None:
        found.append(("datum", recording.datum.text))
    return found + [(each.stream, each.text) for each in recording.dropped]


def _line(name: str, stream: Stream) -> str:
    kind = KINDS.get(name)
    what = f"{len(stream):,}" if kind is None else count(len(stream), *kind)
    text = f"{what} of {', '.join(stream.components)}"
    if stream.subject is not None:
        text += f", of {count(len(set(stream.subject.tolist()) - {None}), 'subject')}"
    if kind and len(stream) > 1:
        edges = stream.stamps if stream.begin is None else np.append(stream.begin, stream.stamps)
        gaps = np.diff(edges)
        text += f"; every {np.median(gaps):.4g} s (median), {gaps.max():.4g} s at most"
    return text
