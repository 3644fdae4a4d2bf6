"""`python -m benchmarks.particles`: particle filters by NumPy, one thread and two, by the clock.

README's robot over 20 steps with a sighting at each. The ways take turns, best of several; each
filter is gone before the next, so that all find the same memory.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

import pgm
from benchmarks.work import robots
from experiments.record import table
from models.networks import landmark, sighting, velocity

STEPS, REPEATS = 20, 9
COUNTS = 10_000, 100_000, 1_000_000
WAYS = None, pgm.Compiled(threads=1), pgm.Compiled(threads=2)


def main() -> None:
    """Print a table."""
    counts: Sequence[int] = [int(each) for each in sys.argv[1:]] or COUNTS
    work = robots.draw(1, STEPS)
    seen = pgm.sightings(
        work.readings[0, :, 0],
        step=np.arange(1, STEPS + 1),
        given={landmark: work.landmarks[:, 0]},
    )
    evidence = {velocity: work.controls, sighting: seen}
    rows = []
    for count in counts:
        numpy, one, two = timed(work.network, evidence, count)
        each = (f"{1e9 * took / count / STEPS:.1f}" for took in (numpy, one, two))
        rows.append((f"{count:,}", *each, f"{numpy / one:.1f}", f"{one / two:.2f}"))
    heading = "particles", "NumPy", "one thread", "two", "NumPy / one", "one / two"
    table("Particle filters: nanoseconds a particle and step", heading, rows)


def timed(
    network: pgm.DynamicBayesianNetwork, evidence: Mapping[Any, Any], count: int
) -> list[float]:
    """The seconds of a filter of so many particles, in each way."""
    found = [float("inf")] * len(WAYS)
    for _ in range(REPEATS):
        for k, way in enumerate(WAYS):
            began = time.perf_counter()
            pgm.filter(network, evidence, belief=pgm.Particles(count, seed=1), compiled=way)
            found[k] = min(found[k], time.perf_counter() - began)
    return found


if __name__ == "__main__":
    main()
