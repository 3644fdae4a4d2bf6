"""Neighbours of the plain compiled step, and how many times its cost they take.

Their peer is pgm itself in machine code on the model of range and bearing, Taylor, which takes
turns with them. Calls are long, so that what a call takes once does not count; what it takes around
its sweeps, step by step, would hide what they cost: limits are of machine code alone as well.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import pgm
from benchmarks import agreement, inside
from benchmarks.libraries.pgm_neighbours import Work, asked, looped, swept, unchanged
from benchmarks.row import Row
from benchmarks.timing import Contender, least
from benchmarks.work import neighbours, robots
from benchmarks.work.robots import Robots

FILTER, SMOOTHER, ONLINE = "filter", "smoother", "online"
SIZES = {FILTER: (10_000, 3_000), SMOOTHER: (10_000, 3_000), ONLINE: (1_000, 300)}
SLOW = 3_000  # steps of what takes long
HERMITE = pgm.GaussHermite(3)
CONTROL = pgm.LevenbergMarquardt()


@dataclass(frozen=True, eq=False)
class Neighbour:
    """One ordinary thing more than the plain step has.

    Attributes
    ----------
    name, words : str
        A contender of the row; for readers.
    row : str
        A key of `SIZES`: of what the plain step is.
    make : callable
        From the plain work to a contender; ``compiled=False`` makes NumPy's.
    most : float or None
        How many times the plain step's cost it may take.
    microseconds : float or None
        What a step may take, where that is asked instead; with neither the cost is only told.
    same : bool
        Whether it finds what the plain step finds.
    steps : int or None
        The most that it is given.
    """

    name: str
    words: str
    row: str
    make: Callable[..., Contender]
    most: float | None = None
    microseconds: float | None = None
    same: bool = False
    steps: int | None = None

    @property
    def asked(self) -> float | None:
        """Its limit; None where its cost is only told."""
        return self.most if self.microseconds is None else self.microseconds

    def measured(self, timed: Timed) -> Iterator[tuple[str, float]]:
        """The measure that its limit is of, in words, with its value; of both ways of timing it."""
        if self.microseconds is not None:
            yield "microseconds", 1e6 * timed.calls[self.name]
        elif self.most is not None:
            yield "/ pgm", timed.calls[self.name] / timed.calls[PLAIN]
            if self.name in timed.code:
                yield "/ pgm in machine code", timed.code[self.name] / timed.code[PLAIN]

    def cells(self, timed: Timed) -> tuple[str, ...]:
        """Its line of the table, under `HEAD`."""
        numbers = []
        for costs in (timed.calls, timed.code):
            here = self.name in costs
            numbers += [f"{1e6 * costs[self.name]:.2f}" if here else ""]
            numbers += [f"{costs[self.name] / costs[PLAIN]:.2f}" if here else ""]
        limit, holds = "", ""
        if self.asked is not None:
            limit = f"{self.asked:g} {'×' if self.microseconds is None else 'µs'}"
            every = all(found <= self.asked for _, found in self.measured(timed))
            holds = "holds" if every else "does NOT hold"
        return self.row, self.words, *numbers, limit, holds


@dataclass(frozen=True)
class Timed:
    """Seconds a step of a row, by contender.

    Attributes
    ----------
    calls, code : mapping
        Of whole calls; of machine code alone, of those that spend any time there.
    """

    calls: Mapping[str, float]
    code: Mapping[str, float]


@dataclass(frozen=True)
class Sweep:
    """A call of a schedule, on changed work and by a lineariser."""

    schedule: Any = field(default_factory=pgm.Filtering)
    change: Work = unchanged
    lineariser: pgm.Lineariser | None = None

    def __call__(self, work: Robots, *, compiled: bool = True) -> Contender:
        """The contender to be timed."""
        return swept(work, self.schedule, self.change, self.lineariser, compiled=compiled)


@dataclass(frozen=True)
class Loop:
    """A robot's loop, with settings of `OnlineFilter`."""

    settings: Mapping[str, Any] = field(default_factory=dict)

    def __call__(self, work: Robots, *, compiled: bool = True) -> Contender:
        """The contender to be timed."""
        return looped(work, compiled=compiled, **self.settings)


def branch_alone(work: Robots, *, compiled: bool = True) -> Contender:
    """The function that a branch has called back, without inference."""
    return asked(work, neighbours.branching, work.controls)


def table_alone(work: Robots, *, compiled: bool = True) -> Contender:
    """The function that a table has called back, without inference."""
    return asked(work, neighbours.looked_up, work.landmarks[:, 0])


PLAIN = "pgm"
PLAINS: Mapping[str, Callable[..., Contender]] = {
    FILTER: Sweep(),
    SMOOTHER: Sweep(pgm.Smoothing()),
    ONLINE: Loop(),
}
FILTERS = (
    Neighbour("gate", "`gate=0.99`", FILTER, Sweep(pgm.Filtering(gate=0.99)), 6.0),
    Neighbour("grouped", "three sightings, grouped", FILTER, Sweep(change=neighbours.grouped), 6.0),
    Neighbour("sensors", "three sensors", FILTER, Sweep(change=neighbours.three_sensors), 6.0),
    *(
        Neighbour(
            f"iterations_{count}",
            f"`iterations={count}`",
            FILTER,
            Sweep(pgm.Filtering(iterations=count, tolerance=0.0)),
            6.0,
        )
        for count in (2, 5)
    ),
    Neighbour("unscented", "`Unscented()`", FILTER, Sweep(lineariser=pgm.Unscented()), 6.0),
    Neighbour(
        "huber", "`Huber(1.5)`", FILTER, Sweep(change=neighbours.robust(pgm.Huber(1.5))), 6.0
    ),
    Neighbour(
        "student_t",
        "`StudentT(4.0)`",
        FILTER,
        Sweep(change=neighbours.robust(pgm.StudentT(4.0))),
        10.0,
    ),
    Neighbour("ten", "ten landmarks a step", FILTER, Sweep(change=neighbours.ten_landmarks), 10.0),
    Neighbour("hermite", "`GaussHermite(3)`", FILTER, Sweep(lineariser=HERMITE), 14.0),
    Neighbour(
        "control",
        "`iterations=10, damping=LevenbergMarquardt()`",
        FILTER,
        Sweep(pgm.Filtering(iterations=10, damping=CONTROL)),
        16.0,
    ),
    Neighbour(
        "unknown",
        "an unknown landmark of 20",
        FILTER,
        Sweep(change=neighbours.unknown_landmark),
        60.0,
        steps=SLOW,
    ),
    Neighbour(
        "lag",
        "`FixedLag(5, iterations=3)`",
        FILTER,
        Sweep(pgm.FixedLag(5, iterations=3, tolerance=0.0)),
        40.0,
    ),
    Neighbour(
        "branch",
        "a branch in the motion, called back",
        FILTER,
        Sweep(change=neighbours.branch),
        microseconds=15.0,
        same=True,
        steps=SLOW,
    ),
    Neighbour(
        "table",
        "a table in the sensor, called back",
        FILTER,
        Sweep(change=neighbours.table),
        microseconds=15.0,
        same=True,
        steps=SLOW,
    ),
    Neighbour("branch_alone", "the branch's function alone", FILTER, branch_alone, steps=SLOW),
    Neighbour("table_alone", "the table's function alone", FILTER, table_alone, steps=SLOW),
)
SMOOTHERS = (
    Neighbour("gate", "`gate=0.99`", SMOOTHER, Sweep(pgm.Smoothing(gate=0.99)), 6.0),
    Neighbour(
        "unscented",
        "`Unscented()`",
        SMOOTHER,
        Sweep(pgm.Smoothing(), lineariser=pgm.Unscented()),
        6.0,
    ),
    Neighbour(
        "control",
        "`iterations=10, damping=LevenbergMarquardt()`",
        SMOOTHER,
        Sweep(pgm.Smoothing(iterations=10, damping=CONTROL)),
        16.0,
    ),
)
LOOPS = (
    Neighbour("gate", "`gate=0.99`", ONLINE, Loop({"gate": 0.99}), 8.0),
    Neighbour("lag", "`lag=5`", ONLINE, Loop({"lag": 5}), 8.0, same=True),
    Neighbour("watch", "`watch=True`", ONLINE, Loop({"watch": True}), 8.0, same=True),
)
NEIGHBOURS = (*FILTERS, *SMOOTHERS, *LOOPS)


def row(name: str) -> Row:
    """The plain step, and all its neighbours."""
    near = [each for each in NEIGHBOURS if each.row == name]
    size, quick = SIZES[name]
    return Row(
        name=f"neighbours_{name}",
        unit="step",
        work=lambda size: robots.draw(1, size),
        contenders={PLAIN: PLAINS[name], **{each.name: each.make for each in near}},
        check=agreement.first_beliefs,
        size=size,
        quick=quick,
        most={each.name: each.steps for each in near if each.steps is not None},
        unchecked=frozenset(each.name for each in near if not each.same),
        repeats=5,
        timed=least,
    )


def code(whole: Row) -> Row:
    """A row, of which time in machine code alone is taken."""
    return replace(whole, name=f"{whole.name}_code", timed=inside.least)


def found(summary: Mapping[str, Any]) -> Iterator[tuple[Neighbour, Timed]]:
    """Neighbours whose calls were timed, and what a step of their row took."""
    for neighbour in NEIGHBOURS:
        name = f"neighbours_{neighbour.row}"
        calls = summary.get(name, {})
        if neighbour.name in calls:
            yield neighbour, Timed(calls, summary.get(f"{name}_code", {}))


def told(summary: Mapping[str, Any]) -> Iterator[tuple[str, ...]]:
    """Lines of a table, under `HEAD`."""
    for each, timed in found(summary):
        yield each.cells(timed)


HEAD = (
    *("of the", "neighbour", "µs a step", "× plain"),
    *("µs in machine code", "× plain there", "at most", ""),
)
ROWS = [row(name) for name in SIZES]
ROWS += [code(each) for each in ROWS if each.name != f"neighbours_{ONLINE}"]
