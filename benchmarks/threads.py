"""`python -m benchmarks.threads`: two threads beside one, by the clock, with all cores.

Both take turns, best of several; everything from evidence to means and covariances is in the time.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from itertools import product

import pgm
from benchmarks.libraries.pgm_robots import RULES
from benchmarks.verdicts import Verdict
from benchmarks.work import robots
from experiments.record import note, table

RUNS, STEPS, REPEATS = 10_000, 200, 7
SCHEDULES: dict[str, pgm.Filtering | pgm.Smoothing] = {
    "filter": pgm.Filtering(),
    "smoother": pgm.Smoothing(),
}
LEAST = 1.7


def main() -> None:
    """Print a table, and what must hold."""
    work = robots.draw(RUNS, STEPS)
    found = {
        way: best(*(sweeps(work, *way, threads) for threads in (1, 2)))
        for way in product(SCHEDULES, ("taylor", "unscented"))
    }
    table(
        f"{RUNS:,} robots of {STEPS} steps: seconds by the clock",
        ("sweeps", "rule", "one thread", "two", "one / two"),
        [
            (way, rule, *(f"{each:.3f}" for each in times), f"{times[0] / times[1]:.2f}")
            for (way, rule), times in found.items()
        ],
    )
    one, two = found["filter", "taylor"]
    verdict = Verdict("filter, taylor: one thread / two", one / two, LEAST, True)
    holds = "holds" if verdict.holds else "does NOT hold"
    note(f"{verdict.what}: {verdict.measured:.2f}, at least {verdict.asked:g}: {holds}")


def sweeps(work: robots.Robots, schedule: str, rule: str, threads: int) -> Callable[[], object]:
    """A call that ends with means and covariances of all robots."""
    graph = pgm.compile(work.network, work.steps, compiled=pgm.Compiled(threads=threads))
    evidence, how = work.evidence(), SCHEDULES[schedule]

    def call() -> object:
        belief = pgm.infer(graph, evidence, schedule=how, lineariser=RULES[rule])[robots.pose]
        return belief.mean, belief.cov

    call()
    return call


def best(*calls: Callable[[], object]) -> list[float]:
    """The least seconds of each, by the clock."""
    turns = [[_clock(call) for call in calls] for _ in range(REPEATS)]
    return [min(each) for each in zip(*turns, strict=True)]


def _clock(call: Callable[[], object]) -> float:
    begin = time.perf_counter()
    call()
    return time.perf_counter() - begin


if __name__ == "__main__":
    main()
