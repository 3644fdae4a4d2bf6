"""Checks of the arguments with which an online filter is made."""

from __future__ import annotations

from typing import Any

import numpy as np

from pgm.beliefs.moments.steps.gate import require_sensors
from pgm.display import titled
from pgm.errors import ModelError
from pgm.networks import DynamicBayesianNetwork
from pgm.schedules.argument_checks import require_gaussian, require_lineariser, require_plain
from pgm.schedules.gates import Gate
from pgm.schedules.options import is_left
from pgm.schedules.schedule import ONCE, Filtering, FixedLag


def require_settings(
    model: Any, lineariser: Any, schedule: Any, lag: int | None, gate: Gate = None
) -> Filtering | FixedLag:
    """The schedule of an online filter of Gaussian beliefs, from its settings, which are checked.

    Without a schedule it is a `FixedLag` of the lag, or a `Filtering` if there is none, with the
    gate. A `ModelError` refuses settings of a wrong kind or that exclude each other, and models
    with CPDs that are not Gaussian, robust noise in the transition, or an infinite variance in the
    prior. An `EvidenceError` refuses a gate for a variable that is no sensor.
    """
    if not isinstance(model, DynamicBayesianNetwork):
        raise ModelError(f"a dynamic network was due, not {titled(model)}")
    require_lineariser(lineariser)
    if lag is not None and schedule is not None:
        raise ModelError(
            f"lag={lag!r} beside {schedule!r}: an online filter takes one of them; a FixedLag "
            "has iterations of its own"
        )
    if gate is not None and schedule is not None:
        raise ModelError(
            f"gate={gate!r} beside {schedule!r}, which has a gate of its own: give one of them"
        )
    if schedule is None and lag is None:
        schedule = ONCE if gate is None else Filtering(gate=gate)
    elif lag is not None:
        schedule = FixedLag(lag, gate=gate)
    if not isinstance(schedule, Filtering | FixedLag):
        raise ModelError(
            f"an online filter takes pgm.Filtering(...) or pgm.FixedLag(...), not {schedule!r}"
        )
    require_gaussian((*model.prior, *model.transition, *model.observation), "Gaussian beliefs")
    require_plain(model.transition)
    require_sensors(model, schedule.gate)
    for cpd in model.prior:
        cpd.require_proper("an online filter begins at a belief, which has moments")
    return schedule


def require_watch(watch: Any) -> bool:
    """Whether a filter watches; what says neither yes nor no is refused by a ModelError."""
    if watch is None or isinstance(watch, bool | np.bool_) or is_left(watch, 0):
        return bool(watch)
    raise ModelError(f"OnlineFilter(...): watch is True or False, not {watch!r}")
