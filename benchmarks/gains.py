"""`python -m benchmarks.gains`: a step in machine code, and one where a call differs a little.

The plain call is a filter of one robot, Taylor; its neighbours change the method, the noise, or the
function of the sensor. Each is called with NumPy alone as well, of fewer steps, in turns with its
machine code; the cost a step does not depend on how many there are.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

import pgm
from benchmarks import recorded
from benchmarks.command import known
from benchmarks.timing import Contender, least, seconds
from benchmarks.work import robots
from benchmarks.work.robots import Array, Robots
from experiments.record import note, table
from models.networks import landmark, pose, sighting
from models.sensors import range_bearing

STEPS, BY_NUMPY, REPEATS = 5_000, 500, 3
NAME = "gains"
HEAD = ("call", "NumPy [µs]", "compiled [µs]", "NumPy / compiled", "first call [s]")
PLAIN = "filter"
TAYLOR = pgm.Taylor()
LM = pgm.LevenbergMarquardt()
FAR = 1_000.0  # [m]: no range is


def plain(steps: int) -> Robots:
    """The plain work."""
    return robots.draw(1, steps)


def thrice(steps: int) -> Robots:
    """Three landmarks a step."""
    return robots.draw(1, steps, seen=3)


def sensing(function: Any = range_bearing, **options: Any) -> Callable[[int], Robots]:
    """The plain work with another sensor."""

    def work(steps: int) -> Robots:
        found = plain(steps)
        given = pose, landmark
        sensor = pgm.NonlinearGaussianCPD(
            sighting, given=given, function=function, cov=found.sensor_cov, **options
        )
        return replace(found, network=found.network.replace(observation=[sensor]))

    return work


def branching(state: Array, place: Array) -> Array:
    """Ranges and bearings by a function that has no trace."""
    found = range_bearing(state, place)
    if (found[..., 0] > FAR).any():
        found[..., 0] = np.minimum(found[..., 0], FAR)
    return found


# By its words: the work, the schedule, and the lineariser.
Way = tuple[Callable[[int], Robots], pgm.Filtering | pgm.FixedLag | pgm.Smoothing, Any]
WAYS: dict[str, Way] = {
    PLAIN: (plain, pgm.Filtering(), TAYLOR),
    "a gate": (plain, pgm.Filtering(gate=0.99), TAYLOR),
    "three landmarks a step": (thrice, pgm.Filtering(), TAYLOR),
    "Huber's noise": (sensing(noise=pgm.Huber(1.5)), pgm.Filtering(), TAYLOR),
    "Student's t": (sensing(noise=pgm.StudentT(4)), pgm.Filtering(), TAYLOR),
    "five iterations": (plain, pgm.Filtering(iterations=5, tolerance=0.0), TAYLOR),
    "Levenberg–Marquardt": (plain, pgm.Filtering(iterations=5, damping=LM), TAYLOR),
    "unscented": (plain, pgm.Filtering(), pgm.Unscented()),
    "Gauss–Hermite, 27 points": (plain, pgm.Filtering(), pgm.GaussHermite(3)),
    "a sensor that is called back": (sensing(branching), pgm.Filtering(), TAYLOR),
    "smoother": (plain, pgm.Smoothing(), TAYLOR),
    "smoother, five iterations": (plain, pgm.Smoothing(iterations=5, tolerance=0.0), TAYLOR),
    "lag of five": (plain, pgm.FixedLag(5), TAYLOR),
    "lag of five, three iterations": (plain, pgm.FixedLag(5, iterations=3, tolerance=0.0), TAYLOR),
}


def main() -> None:
    """Print a table; with `--record` write it into the file of figures."""
    ways = {}
    for words, way in WAYS.items():
        machine, status = contender(way, STEPS, compiled=True)
        first = seconds(machine.call)
        second = seconds(machine.call)
        numpy, _ = contender(way, BY_NUMPY, compiled=False)
        found = least({"compiled": machine, "numpy": numpy}, REPEATS)
        ways[words] = found | {"first": first - second}
        note(f"{words}: {status()}")
    table("one robot: microseconds a step", HEAD, told(ways))
    if sys.argv[1:] == ["--record"]:
        recorded.add({NAME: {"ways": ways}}, "python -m benchmarks.gains", known())


def told(ways: Mapping[str, Mapping[str, float]]) -> Iterator[tuple[str, ...]]:
    """Lines of a table, under `HEAD`."""
    for words, times in ways.items():
        micro = (recorded.digits(1e6 * times[key]) for key in ("numpy", "compiled"))
        ratio = times["numpy"] / times["compiled"]
        yield words, *micro, f"{ratio:,.0f}", f"{times['first']:.2f}"


def contender(way: Way, steps: int, *, compiled: bool) -> tuple[Contender, Callable[[], str]]:
    """The call, a step being the unit, and what tells whether it was compiled."""
    work, schedule, lineariser = way
    drawn = work(steps)
    graph = pgm.compile(drawn.network, steps, compiled=compiled)
    evidence = drawn.evidence(0)

    def infer() -> Any:
        return pgm.infer(graph, evidence, schedule=schedule, lineariser=lineariser)

    def call() -> Array:
        mean: Array = infer()[pose].mean
        return mean

    return Contender(call, steps), lambda: str(infer().status.compilation)


if __name__ == "__main__":
    main()
