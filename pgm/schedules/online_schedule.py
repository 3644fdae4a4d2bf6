"""The schedule of an online filter: the one given, or that of a lag or a gate."""

from __future__ import annotations

from typing import Any

from pgm.errors import ModelError
from pgm.schedules.gates import Gate
from pgm.schedules.schedule import (
    ONCE,
    Filtering,
    FixedLag,
    require_known,
)


def online_schedule(schedule: Any, lag: int | None, gate: Gate = None) -> Filtering | FixedLag:
    """A `FixedLag` of the lag, or a `Filtering` if there is none, with the gate; or the schedule.

    A ModelError refuses a schedule beside a lag or gate, and one that is for whole records.
    """
    if lag is not None and schedule is not None:
        raise ModelError(
            f"lag={lag!r} beside {schedule!r}: an online filter takes one of them; a FixedLag "
            "has iterations of its own"
        )
    if gate is not None and schedule is not None:
        raise ModelError(
            f"gate={gate!r} beside {schedule!r}, which has a gate of its own: give one of them"
        )
    if schedule is None:
        if lag is not None:
            return FixedLag(lag, gate=gate)
        return ONCE if gate is None else Filtering(gate=gate)
    if not isinstance(schedule, Filtering | FixedLag):
        raise ModelError(
            f"an online filter takes pgm.Filtering(...) or pgm.FixedLag(...), not {schedule!r}"
        )
    require_known(schedule, "an online filter")
    return schedule
