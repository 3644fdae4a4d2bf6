"""Cliffs: ordinary changes of a model, and how many times the unchanged model's cost they take.

Their peer is pgm itself on the model of range and bearing, Taylor, which takes turns with them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from benchmarks import agreement
from benchmarks.libraries import pgm_robots
from benchmarks.row import Prepare, Row
from benchmarks.timing import Contender, least
from benchmarks.work import changes, robots
from benchmarks.work.robots import Robots


@dataclass(frozen=True, eq=False)
class Change:
    """One ordinary change.

    Attributes
    ----------
    name, words : str
        A contender of the rows; for readers.
    most : float or None
        How many times the unchanged model's cost it may take; None where that is only told.
    kinds : tuple of str
        Keys of `KINDS`.
    work : callable
        From the unchanged work to the changed.
    rule : str
        A key of `pgm_robots.RULES`.
    iterations : int
        Of the filter.
    same : bool
        Whether it finds what the unchanged model finds.
    """

    name: str
    words: str
    most: float | None
    kinds: tuple[str, ...] = ("many", "one")
    work: Callable[[Robots], Robots] = lambda work: work
    rule: str = "taylor"
    iterations: int = 1
    same: bool = False

    def under(self, kind: Kind) -> Prepare:
        """The preparation for a kind of work."""
        return lambda work: kind.make(self.rule, self.work(work), self.iterations)


@dataclass(frozen=True)
class Kind:
    """One kind of work for which changes are timed.

    Attributes
    ----------
    make : callable
        From the name of a rule, the work and how many iterations to a contender.
    unit : str
    runs, size, quick : int
        How many, and how many steps each has; in the quick run.
    column : str
        Of the table of changes.
    """

    make: Callable[[str, Robots, int], Contender]
    unit: str
    runs: int
    size: int
    quick: int
    column: str


COLUMNS = ("many", "one", "online")
KINDS = {
    "many": Kind(pgm_robots.filtering, "robot and step", 1_000, 200, 200, "many"),
    "one": Kind(pgm_robots.filtering, "step", 1, 10_000, 2_000, "one"),
    "online": Kind(pgm_robots.online, "step", 1, 1_000, 300, "online"),
    "few": Kind(pgm_robots.together, "step of all runs", 32, 200, 200, "many"),
}
UNCHANGED = Change("pgm", "the model of range and bearing", None, tuple(KINDS))
CHANGES = (
    Change("missing", "one measurement in 100,000 missing", 1.3, work=changes.missing),
    Change("second_state", "a second state variable", 1.8, work=changes.second_state),
    Change(
        "no_jacobian", "the motion without a Jacobian", None, work=changes.no_jacobian, same=True
    ),
    Change("singular", "singular motion noise", 1.3, work=changes.singular),
    Change("grouped", "`grouped=True` on the sensor", 1.4, work=changes.grouped, same=True),
    Change("iterations", "`Filtering(iterations=2)`", 2.3, COLUMNS, iterations=2),
    Change("one_fewer", "31 runs instead of 32", 1.1, ("few",), work=changes.one_fewer, same=True),
    Change("own_taylor", "Taylor's formula as a user's class", 1.3, COLUMNS, rule="own", same=True),
)


def row(name: str) -> Row:
    """The unchanged model, and all changes that are timed for a kind of work."""
    kind = KINDS[name]
    timed = [change for change in CHANGES if name in change.kinds]
    return Row(
        name=f"cliffs_{name}",
        unit=kind.unit,
        work=lambda size: robots.draw(kind.runs, size),
        contenders={each.name: each.under(kind) for each in (UNCHANGED, *timed)},
        check=agreement.first_beliefs,
        size=kind.size,
        quick=kind.quick,
        unchecked=frozenset(each.name for each in timed if not each.same),
        repeats=5,
        timed=least,  # limits are as tight as what other processes add to a median
    )


def ratios(summary: Mapping[str, Any]) -> Iterator[tuple[Change, dict[str, float]]]:
    """Changes that were timed: by kind, how many times the unchanged model's cost they took."""
    for change in CHANGES:
        rows = {kind: summary.get(f"cliffs_{kind}", {}) for kind in change.kinds}
        found = {
            kind: times[change.name] / times[UNCHANGED.name]
            for kind, times in rows.items()
            if change.name in times
        }
        if found:
            yield change, found


def told(summary: Mapping[str, Any]) -> Iterator[tuple[str, ...]]:
    """Lines of a table, under `HEAD`."""
    for change, found in ratios(summary):
        cells = {KINDS[kind].column: f"{ratio:.2f}" for kind, ratio in found.items()}
        most = "" if change.most is None else f"{change.most:g}"
        yield change.words, *(cells.get(column, "") for column in COLUMNS), most


HEAD = ("change", *COLUMNS, "at most")
ROWS = [row(name) for name in KINDS]
