"""Checks of a recording's parts, as users give them."""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from typing import Any

import numpy as np

from pgm.boundary import as_floats, as_mapping
from pgm.display import titled
from pgm.errors import EvidenceError
from pgm.evidence.degrees import beyond_a_turn
from pgm.factors.arrays import covariance_fault
from pgm.factors.scope import listed
from pgm.io.stamped import as_stamps
from pgm.kernels.arrays import Array, frozen
from pgm.recordings.drives.scans import Scans
from pgm.recordings.drives.stream import Stream


def stream(what: str, value: Any) -> Stream:
    """A stream."""
    if not isinstance(value, Stream):
        raise EvidenceError(
            f"{what} is given as Stream(stamps, values, components), not as {titled(value)}"
        )
    return value


def places(landmarks: Any) -> dict[Hashable, Array]:
    """Positions by identity, (2,) or (3,)."""
    found: dict[Hashable, Array] = {}
    for key, value in as_mapping(landmarks, "landmarks").items():
        place = as_floats(value, f"the position of landmark {key!r}", EvidenceError)
        if place.shape not in ((2,), (3,)) or not np.isfinite(place).all():
            raise EvidenceError(
                f"the position of landmark {key!r} is {place.tolist()}; two or three metres were "
                "due"
            )
        found[key] = frozen(place.copy())
    return found


def covariances(given: Any, known: Mapping[Hashable, Array]) -> dict[Hashable, Array]:
    """Covariances of known positions, by the landmark's identity."""
    found: dict[Hashable, Array] = {}
    for key, value in as_mapping(given, "landmark_cov").items():
        cov = as_floats(value, f"the covariance of landmark {key!r}", EvidenceError)
        if key not in known:
            raise EvidenceError(f"landmark_cov has {key!r}, which is no landmark")
        size = known[key].size
        fault = "has another shape" if cov.shape != (size, size) else covariance_fault(cov)
        if fault:
            raise EvidenceError(f"the covariance of landmark {key!r} {fault}: {cov.tolist()}")
        found[key] = frozen(cov.copy())
    return found


def scans(given: Any) -> dict[str, Scans]:
    """Scans by laser."""
    found = dict(as_mapping(given, "scans"))
    for key, value in found.items():
        if not isinstance(value, Scans):
            raise EvidenceError(f"the scans {key!r} are given as Scans, not as {titled(value)}")
    return found


def mounts(given: Any, known: Sequence[str]) -> dict[str, Array]:
    """Poses of sensors on the robot."""
    found: dict[str, Array] = {}
    for key, value in as_mapping(given, "mounts").items():
        if key not in known:
            raise EvidenceError(f"mounts has {key!r}; the sensors are {listed(known)}")
        pose = as_floats(value, f"the mount of {key!r}", EvidenceError)
        if pose.shape != (3,) or not np.isfinite(pose).all():
            raise EvidenceError(f"the mount of {key!r} is (forward, left, turn), not {value!r}")
        if beyond_a_turn(pose[2:]):
            raise EvidenceError(
                f"the mount of {key!r} is turned by {pose[2]:.4g} rad, more than a turn; it seems "
                "to be in degrees: np.radians(degrees) makes radians"
            )
        found[key] = frozen(pose.copy())
    return found


def increasing(times: Any) -> Array:
    """Times, each after the one before."""
    axis = as_stamps("times", times)
    if not axis.size or (np.diff(axis) <= 0.0).any():
        raise EvidenceError("times increase from each to the next; np.unique(times) does")
    return axis
