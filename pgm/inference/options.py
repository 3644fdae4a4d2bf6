"""The options of a call, and who has a use for them: graphs, families of beliefs.

Each party of a call lists the options that it takes. One function, `require`, compares a call with
that, and words the refusal with the remedy.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

from pgm.display import titled
from pgm.errors import GraphError, ModelError, PgmError
from pgm.inference.impossible import RAISE
from pgm.linearisers import TAYLOR

if TYPE_CHECKING:
    from concurrent.futures import Executor

    from pgm.inference.schedule import Schedule
    from pgm.inference.starting_points import Start
    from pgm.linearisers import Lineariser


class Call(NamedTuple):
    """The options of a call of `infer`, `filter` or `smooth`, with their defaults.

    schedule: None for the graph's own.
    compiled: Whether machine code was asked for when the graph was compiled; None if it was not.
    """

    schedule: Schedule | None = None
    lineariser: Lineariser = TAYLOR
    start: Start | None = None
    keep: Any = None
    executor: Executor | None = None
    memory: float | None = None
    impossible: str = RAISE
    compiled: Any = None

    @property
    def asked(self) -> dict[str, Any]:
        """The options, but for the schedule, that are not left at their defaults."""
        default = Call()._asdict()
        given = self._asdict()
        return {n: v for n, v in given.items() if n != "schedule" and not _is(v, default[n])}


class Party(Protocol):
    """A party of a call: the graph, or the family of beliefs.

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


class OverTime(NamedTuple):
    """Graphs of dynamic networks, which take every option but those of networks without time."""

    takes: frozenset[str] = frozenset({*Call._fields, "method"} - {"memory"})

    def refusal(self, option: str, of: object) -> PgmError:
        """The error for an option of networks without time."""
        return refused(option, of)


class Static(NamedTuple):
    """Graphs of networks without time."""

    takes: frozenset[str] = frozenset({"lineariser", "start", "memory", "impossible", "compiled"})

    def refusal(self, option: str, of: object) -> PgmError:
        """The error for an option of dynamic networks."""
        if option == "belief":
            return GraphError(
                f"belief= is for dynamic networks, whose states it is of, not for {titled(of)}"
            )
        return GraphError(
            f"keep= and executor= are for the runs of dynamic networks, not for {titled(of)}; to "
            "hold less at a time, give fewer runs to a call"
        )


OVER_TIME, STATIC = OverTime(), Static()

# Options whose refusal is the same whoever has no use for them; {of} is the graph, or network.
REFUSALS: dict[str, tuple[type[PgmError], str]] = {
    "memory": (
        GraphError,
        "memory= is for the runs of discrete networks; of a dynamic network keep=[x] holds fewer "
        "at a time, and of others fewer runs to a call do",
    ),
    "impossible": (
        GraphError,
        "impossible= is for the runs of discrete networks, not for {of}",
    ),
}


def refused(option: str, of: object, spare: str = "", more: str = ": leave it out") -> PgmError:
    """The error for an option that is not taken.

    `spare` says, of most options, for what a family has no use of those; `more` is the remedy.
    """
    error, text = REFUSALS.get(option, (ModelError, f"{option}= {spare}"))
    return error(text.format(of=titled(of)) + more)


def _is(value: Any, default: Any) -> bool:
    """Whether an option was left at its default."""
    if value is default:
        return True
    return default is not None and type(value) is type(default) and bool(value == default)
