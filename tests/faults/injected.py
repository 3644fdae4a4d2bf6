"""Faults of sensors and robots, drawn by seed and put into recorded drives, a run each."""

from dataclasses import dataclass

import numpy as np

KINDS = ("missing", "frozen", "late", "moved", "slip", "carried", "kidnapped")


@dataclass(frozen=True)
class Faulty:
    """Drives with a fault each, as runs.

    Attributes
    ----------
    kinds : list of str
    begin, end : ndarray of int
        (runs,): the first step with the fault, and the last.
    controls, values, places, start
        As of a `Drive`, with an axis of runs.
    """

    kinds: list
    begin: np.ndarray
    end: np.ndarray
    controls: np.ndarray
    values: np.ndarray
    places: np.ndarray
    start: np.ndarray


def faulty(drive, kinds, size, rng):
    """A drive with a fault in each run, `size` metres large."""
    runs, steps = len(kinds), len(drive.times) - 1
    controls = np.tile(drive.controls, (runs, 1, 1))
    values = np.tile(drive.values, (runs, 1, 1))
    places = np.tile(drive.places, (runs, 1, 1))
    start = np.tile(drive.start[0], (runs, 1)).astype(float)
    begin = rng.integers(steps // 5, steps // 2, runs)
    end = begin + rng.integers(steps // 20, steps // 6, runs)
    for run, kind in enumerate(kinds):
        first, last = begin[run], end[run]
        during = (drive.step >= first) & (drive.step <= last)
        one = drive.subject == rng.choice(drive.subject[during])
        if kind == "missing":
            values[run, during] = np.nan
        elif kind == "frozen":
            for subject in np.unique(drive.subject):
                own = drive.subject == subject
                if (before := np.flatnonzero(own & (drive.step < first))).size:
                    values[run, own & during] = drive.values[before[-1]]
        elif kind == "late":
            for subject in np.unique(drive.subject):
                own = np.flatnonzero(drive.subject == subject)
                lag = max(len(own) // 40, 2)
                late = own[lag:][during[own[lag:]]]
                values[run, late] = drive.values[own[np.searchsorted(own, late) - lag]]
        elif kind == "moved":
            way = rng.uniform(0.0, 2.0 * np.pi)
            places[run, one & (drive.step >= first)] += size * np.array([np.cos(way), np.sin(way)])
            end[run] = steps
        elif kind in ("slip", "carried"):
            share = rng.uniform(1.5, 2.5) if kind == "slip" else 0.0
            controls[run, first:last, :3] *= [share, share, 1.0]
        else:
            way = rng.uniform(0.0, 2.0 * np.pi)
            start[run, :2] += size * np.array([np.cos(way), np.sin(way)])
            begin[run], end[run] = 0, 0
    return Faulty(list(kinds), begin, end, controls, values, places, start)
