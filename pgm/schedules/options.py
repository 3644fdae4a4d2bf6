"""The options of a call, and who has a use for them: graphs, schedules, families of beliefs.

Each party of a call lists the options that it takes. One function, `require`, compares a call with
that, and raises the party's refusal, which has the remedy.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np

from pgm.boundary import is_number
from pgm.compile import BalancedGraph
from pgm.display import titled
from pgm.errors import EvidenceError, GraphError, ModelError, PgmError
from pgm.linearisers import TAYLOR
from pgm.schedules.impossible import RAISE
from pgm.schedules.schedule import ONCE, Loopy, Schedule

if TYPE_CHECKING:
    from concurrent.futures import Executor

    from pgm.linearisers import Lineariser
    from pgm.schedules.starting_points import Start


class Call(NamedTuple):
    """The options of a call of `infer`, `filter` or `smooth`, with their defaults.

    schedule: None for the graph's own.
    compiled: Whether machine code was asked for when the graph was compiled; None if it was not.
    tells: Whether few digits are told of by a warning; a part of the runs leaves that to the whole.
    trial: Whether the iterations of a chain are one start among many, which takes no more than a
        few in twice the digits, from where float64 stopped, and fails where float64 does.
    """

    schedule: Schedule | None = None
    lineariser: Lineariser = TAYLOR
    start: Start | None = None
    keep: Any = None
    executor: Executor | None = None
    memory: float | None = None
    impossible: str = RAISE
    compiled: Any = None
    tells: bool = True
    trial: bool = False

    def asked(self, graph: Any) -> dict[str, Any]:
        """The options that are not left at their defaults, those of the schedule among them.

        For `graph`, which is one of its method.
        """
        found = {
            name: value
            for (name, default), value in zip(_DEFAULTS, self, strict=True)
            if value is not default and name != "schedule" and not is_left(value, default)
        }
        if isinstance(graph, BalancedGraph):
            found["method"] = "Balanced"
        if self.schedule is not None and not isinstance(self.schedule, Loopy):
            for name, left in OF_SCHEDULES.items():
                value = getattr(self.schedule, name, left)
                if not is_left(value, left):
                    found[name] = value
        return found


_DEFAULTS = tuple(Call._field_defaults.items())
# The options of schedules of linearisations, whose other arguments say what is sent; and their
# defaults. A schedule for graphs with loops has options of its own.
OF_SCHEDULES: dict[str, Any] = {"iterations": 1, "damping": 0.0, "gate": None}
# Options that are idle on a graph without time where nothing is nonlinear: no family refuses them.
IDLE = frozenset({"iterations", "lineariser"})
# The options of an online filter, and the values by which each is left out.
_ONLINE: dict[str, tuple[Any, ...]] = {
    "lineariser": (TAYLOR,),
    "schedule": (None, ONCE),
    "lag": (None,),
    "gate": (None,),
    "watch": (False, None, 0),
    "compiled": (None, False, 0),
}


def asked_online(given: Mapping[str, Any]) -> dict[str, Any]:
    """The options of an online filter that are not left out, the gate of a schedule among them.

    `given` are all of them, by name.
    """
    found = {n: v for n, v in given.items() if not any(is_left(v, left) for left in _ONLINE[n])}
    schedule = given["schedule"]
    if getattr(schedule, "gate", None) is not None:
        found.setdefault("gate", schedule)
    return found


class Party(Protocol):
    """A party of a call: the graph, by its method, the schedule, or the family of beliefs.

    takes: The options that it has a use for.
    """

    @property
    def takes(self) -> frozenset[str]:
        """The options that it has a use for."""
        ...

    def refusal(self, option: str, of: object) -> PgmError:
        """The error for an option that it has no use for, with the remedy.

        `of` is the graph, or online the network, for its text.
        """
        ...


def require(given: Mapping[str, Any], of: object, *parties: Party) -> None:
    """Raise the first party's refusal of an option that it has no use for.

    `given` are the options asked for, by name; `of` is the graph, or online the network.
    """
    for party in parties:
        for option in given:
            if option not in party.takes:
                raise party.refusal(option, of)


def require_over_time(call: Call, graph: Any, family: Party) -> None:
    """Raise the refusal of an option that the graph, the family or the schedule has no use for.

    `graph` is one of a dynamic network.
    """
    if asked := call.asked(graph):
        require(asked, graph, BALANCED if "method" in asked else OVER_TIME, family)
        if call.schedule is not None:
            require(asked, graph, Scheduled(call.schedule))


class OverTime(NamedTuple):
    """Graphs of dynamic networks, which take every option but those of networks without time."""

    takes: frozenset[str] = frozenset({*Call._fields, *OF_SCHEDULES, "method"} - {"memory"})

    def refusal(self, option: str, of: object) -> PgmError:
        """The error for an option of networks without time."""
        return refused(option, of)


class OfBalanced(NamedTuple):
    """Balanced trees, on which nothing is decided along a chain; `pgm.compile` refuses compiled=.

    takes: The options of graphs of dynamic networks, but a gate.
    """

    takes: frozenset[str] = OverTime().takes - {"gate"}

    def refusal(self, option: str, of: object) -> PgmError:
        """The error for a gate, or an option of networks without time."""
        if option == "gate":
            return GraphError(
                "gate= decides at one predicted belief after another, and "
                f"{titled(of)} solves for all steps at once: leave it out, or compile without "
                "pgm.Balanced()"
            )
        return refused(option, of)


class Static(NamedTuple):
    """Graphs of networks without time."""

    takes: frozenset[str] = frozenset(
        {"lineariser", "start", "memory", "impossible", "compiled", "iterations", "damping"}
    )

    def refusal(self, option: str, of: object) -> PgmError:
        """The error for an option of dynamic networks."""
        if option == "belief":
            return GraphError(
                f"belief= is for dynamic networks, whose states it is of, not for {titled(of)}"
            )
        if option == "gate":
            return GraphError(
                "gate= is for dynamic networks, at whose predicted beliefs it decides, not for "
                f"{titled(of)}"
            )
        return GraphError(
            f"keep= and executor= are for the runs of dynamic networks, not for {titled(of)}; to "
            "hold less at a time, give fewer runs to a call"
        )


class Paths(NamedTuple):
    """Most probable paths of dynamic networks of tables, found for all runs at once."""

    takes: frozenset[str] = frozenset()

    def refusal(self, option: str, of: object) -> PgmError:
        """The error for a method, or an option of assignments of networks without time."""
        if option == "method":
            return refused(option, of, "tables")
        return GraphError(
            "memory= and executor= are for networks without time; of a dynamic one give fewer "
            "runs to a call"
        )


OVER_TIME, BALANCED, STATIC, PATHS = OverTime(), OfBalanced(), Static(), Paths()


class Scheduled(NamedTuple):
    """A schedule, which lists the options that the messages it sends have a use for."""

    schedule: Schedule

    @property
    def takes(self) -> frozenset[str]:
        """The options that the schedule has a use for."""
        return self.schedule.takes

    def refusal(self, option: str, of: object) -> PgmError:
        """The error for an option that the schedule has no use for, with the remedy."""
        if option not in _OF_SCHEDULES:
            return ModelError(f"{option}= is not for {self.schedule!r}: leave it out")
        error, text = _OF_SCHEDULES[option]
        kind = type(self.schedule).__name__
        return error(text.format(schedule=self.schedule, kind=kind, of=titled(of)))


# The refusals of a schedule, by option: {schedule} is its text, {kind} its class, {of} the graph.
_OF_SCHEDULES: dict[str, tuple[type[PgmError], str]] = {
    "start": (
        EvidenceError,
        "a start is for smoothing all at once, not {schedule!r}, which linearises at beliefs: "
        "leave start= out, or smooth by pgm.Smoothing()",
    ),
    "method": (
        GraphError,
        "{schedule!r} goes along a chain of slices, step after step, which {of} is not: compile "
        "without pgm.Balanced()",
    ),
    "memory": (
        GraphError,
        "memory= is for two passes over a tree: {kind} lets all runs go round {of} together; to "
        "hold less at a time, give fewer runs to a call",
    ),
    "impossible": (
        GraphError,
        "impossible= is for two passes over a tree: messages that go round, as {kind} sends them "
        "on {of}, need not find out that evidence is impossible; leave it out",
    ),
}

_NOTHING = (
    "{beliefs} need no linearising, so that there is nothing to iterate or damp; leave iterations "
    "and damping out"
)
# Options whose refusal is the same whoever has no use for them: {of} is the graph, or network, and
# {beliefs} are those of the family. Other options' is in the family's words.
REFUSALS: dict[str, tuple[type[PgmError], str]] = {
    "memory": (
        GraphError,
        "memory= is for the runs of discrete networks; of a dynamic network keep=[x] holds fewer "
        "at a time, and of others fewer runs to a call do",
    ),
    "impossible": (
        GraphError,
        "impossible= is for runs of networks without time, and over time of tables, not for {of}",
    ),
    "method": (
        GraphError,
        "{beliefs} go along a chain of slices, which {of} is not: leave method= out of pgm.compile "
        "or pgm.smooth",
    ),
    "iterations": (ModelError, _NOTHING),
    "damping": (ModelError, _NOTHING),
}


def refused(
    option: str, of: object, beliefs: str = "", spare: str = "", more: str = ": leave it out"
) -> PgmError:
    """The error for an option that is not taken.

    `beliefs` are the family's, in the plural; `spare` says, of most options, for what it has no use
    of those; `more` is the remedy.
    """
    if option not in REFUSALS:
        return ModelError(f"{option}= {spare}{more}")
    error, text = REFUSALS[option]
    remedy = more if option == "impossible" else ""
    return error(text.format(of=titled(of), beliefs=beliefs) + remedy)


def is_left(value: Any, default: Any) -> bool:
    """Whether an option was left at its default, or given as a value that is the same.

    A number is the same as another of any type, and as no bool: 0 is 0.0, and not False.
    """
    if value is default:
        return True
    if is_number(value) and is_number(default):
        return float(value) == float(default)
    value = bool(value) if isinstance(value, np.bool_) else value
    return default is not None and type(value) is type(default) and bool(value == default)
