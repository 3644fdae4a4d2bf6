"""`python -m benchmarks.simulated`: simulation studies by `pgm.study`, by the processor's clock.

README's robot over 200 steps with a reading at each, drawn and judged by all statistics; then
neighbours of it. A short study makes the machine code first. Memory is the process's peak.
"""

from __future__ import annotations

import resource
import sys
import time
from collections.abc import Sequence
from typing import Any

import numpy as np

import pgm
from benchmarks.work import robots
from experiments.record import table
from models.networks import landmark, pose, sighting, velocity

STEPS = 200
RUNS = 10_000, 100_000
FILTERS: dict[str, Any] = {"EKF": pgm.Taylor(), "UKF": pgm.Unscented()}
SMOOTHERS: dict[str, Any] = {"ERTS": pgm.Smoothing(), "URTS": (pgm.Unscented(), pgm.Smoothing())}


def main() -> None:
    """Print a table."""
    runs: Sequence[int] = [int(each) for each in sys.argv[1:]] or RUNS
    work = robots.draw(1, STEPS)
    evidence = {
        velocity: work.controls,
        sighting: pgm.sightings(
            step=np.arange(1, STEPS + 1), given={landmark: work.landmarks[:, 0]}
        ),
    }
    rows = [
        (name, *told)
        for name, network, given in cases(work.network)
        for told in timed(network, evidence, given, runs)
    ]
    heading = "study", "runs", "seconds of processors", "by the clock", "µs a run", "peak MB"
    table(f"pgm.study of {STEPS} steps", heading, rows)


def cases(network: pgm.DynamicBayesianNetwork) -> list[tuple[str, Any, dict[str, Any]]]:
    """The studies: a name, a network, and arguments."""
    sensor: Any = network.observation[0]
    robust = pgm.NonlinearGaussianCPD(
        sighting,
        sensor.given,
        sensor.function,
        cov=sensor.cov,
        noise=pgm.StudentT(5.0),
    )
    known = pgm.GaussianCPD(pose, np.zeros(3), 0.0)
    filters = {"methods": FILTERS}
    return [
        ("EKF, UKF", network, filters),
        ("EKF, UKF; two threads", network, filters | {"compiled": pgm.Compiled(threads=2)}),
        ("EKF, UKF; robust sensor", network.replace(observation=[robust]), filters),
        ("EKF, UKF; known start", network.replace(prior=[known]), filters),
        ("smoothers", network, {"methods": SMOOTHERS}),
    ]


def timed(
    network: Any, evidence: Any, given: dict[str, Any], runs: Sequence[int]
) -> Sequence[tuple[str, ...]]:
    """Of each number of runs: seconds of the processors, by the clock, each run's, and memory."""
    for _ in range(3):  # traces that are often right are judged by machine code of their own
        pgm.study(network, evidence, runs=3000, seed=1, **given)
    found: list[tuple[str, ...]] = []
    for count in runs:
        began, clock = time.process_time(), time.perf_counter()
        pgm.study(network, evidence, runs=count, seed=1, **given)
        took, by_clock = time.process_time() - began, time.perf_counter() - clock
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        each = f"{1e6 * took / count:.0f}"
        found.append((f"{count:,}", f"{took:.2f}", f"{by_clock:.2f}", each, f"{peak:.0f}"))
    return found


if __name__ == "__main__":
    main()
