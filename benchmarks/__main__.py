"""`make bench`: every row on this machine, in this run, on one thread."""

from __future__ import annotations

import json
import statistics
import time
from collections.abc import Callable
from importlib import metadata
from pathlib import Path

import numpy as np

import pgm
from benchmarks import discrete, filterpy_ekf, work
from experiments.record import note, table, versions
from models.networks import landmark, pose, sighting, velocity

ROBOTS, STEPS, REPEATS = 1_000, 200, 7
CALIBRATIONS = 101
FILTERPY_ROBOTS = 10  # filterpy's cost a robot does not depend on how many there are
OUT = Path("results") / "bench"


def seconds(call: Callable[[], object], repeats: int = REPEATS) -> float:
    """Median time of a call, after one to warm up."""
    call()
    times = []
    for _ in range(repeats):
        begin = time.perf_counter()
        call()
        times.append(time.perf_counter() - begin)
    return statistics.median(times)


def online(task: work.Work) -> pgm.OnlineBelief:
    """One robot in its loop."""
    robot = pgm.OnlineFilter(task.network)
    belief = robot.initial()
    for k, control in enumerate(task.controls):
        belief = robot.predict(belief, {velocity: control})
        seen = pgm.sightings(
            task.readings[0, k : k + 1], given={landmark: task.landmarks[k : k + 1]}
        )
        belief = robot.update(belief, {sighting: seen})
    return belief


def check(task: work.Work) -> None:
    """The libraries must agree before their times mean anything."""
    posterior = pgm.filter(task.network, task.evidence(slice(0, 2)))
    means, covs = filterpy_ekf.run(task, 2)
    np.testing.assert_allclose(posterior[pose].mean[:, 1:], means, rtol=0, atol=1e-8)
    np.testing.assert_allclose(posterior[pose].cov[:, 1:], covs, rtol=0, atol=1e-9)


def main() -> None:
    """Run every row, print the tables, write results/bench/summary.json."""
    known = versions() | {peer: metadata.version(peer) for peer in ("filterpy", "pyagrum")}
    summary: dict[str, object] = {"versions": known, **dynamic(), **calibration()}
    note(f"versions: {known}")
    OUT.mkdir(parents=True, exist_ok=True)
    (OUT / "summary.json").write_text(json.dumps(summary, indent=2))


def calibration() -> dict[str, dict[str, float]]:
    """New evidence on a compiled discrete network, then all marginals: seconds by row."""
    rows: dict[str, dict[str, float]] = {}
    for name, task in discrete.tasks().items():
        discrete.check(task)
        rows[f"discrete_{name}"] = {
            "pgm": seconds(discrete.with_pgm(task), CALIBRATIONS),
            "pyagrum": seconds(discrete.with_pyagrum(task), CALIBRATIONS),
        }
    table(
        "new evidence on a compiled discrete network, all marginals: milliseconds",
        ("row", "pgm", "pyAgrum", "pyAgrum / pgm"),
        [
            (row, 1e3 * each["pgm"], 1e3 * each["pyagrum"], each["pyagrum"] / each["pgm"])
            for row, each in rows.items()
        ],
    )
    return rows


def dynamic() -> dict[str, dict[str, float]]:
    """Filters and smoothers of robots: seconds a robot and step, by row."""
    task = work.range_bearing(ROBOTS, STEPS)
    check(task)
    many, one = task.evidence(slice(None)), task.evidence(0)
    filterpy = seconds(lambda: filterpy_ekf.run(task, FILTERPY_ROBOTS), 5) / (
        FILTERPY_ROBOTS * STEPS
    )
    rows = {
        "ekf_1000_robots": seconds(lambda: pgm.filter(task.network, many)) / (ROBOTS * STEPS),
        "ekf_one_robot": seconds(lambda: pgm.filter(task.network, one)) / STEPS,
        "rts_one_robot": seconds(lambda: pgm.smooth(task.network, one)) / STEPS,
        "online_step": seconds(lambda: online(task), 3) / STEPS,
    }
    peer = {"ekf_1000_robots": filterpy, "ekf_one_robot": filterpy, "online_step": filterpy}
    table(
        f"Taylor, range-bearing, {ROBOTS} robots x {STEPS} steps: microseconds a robot and step",
        ("row", "pgm", "filterpy", "filterpy / pgm"),
        [
            (
                row,
                1e6 * value,
                1e6 * peer[row] if row in peer else "",
                peer[row] / value if row in peer else "",
            )
            for row, value in rows.items()
        ],
    )
    return {
        row: {"pgm": value} | ({"filterpy": peer[row]} if row in peer else {})
        for row, value in rows.items()
    }


if __name__ == "__main__":
    main()
