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
from pgm.schedules.online_schedule import online_schedule
from pgm.schedules.options import is_left
from pgm.schedules.schedule import Filtering, FixedLag


def require_settings(
    model: Any, lineariser: Any, schedule: Any, lag: int | None, gate: Gate = None
) -> Filtering | FixedLag:
    """The schedule of an online filter of Gaussian beliefs, from its settings, which are checked.

    Without a schedule it is a `FixedLag` of the lag, or a `Filtering` if there is none, with the
    gate. A `ModelError` refuses settings of a wrong kind or that exclude each other, and models
    with CPDs that are not Gaussian, or robust noise in the transition. An `EvidenceError` refuses a
    gate for a variable that is no sensor.
    """
    if not isinstance(model, DynamicBayesianNetwork):
        raise ModelError(f"a dynamic network was due, not {titled(model)}")
    require_lineariser(lineariser)
    chosen = online_schedule(schedule, lag, gate)
    require_gaussian((*model.prior, *model.transition, *model.observation), "Gaussian beliefs")
    require_plain(model.transition)
    require_sensors(model, chosen.gate)
    return chosen


def require_watch(watch: Any) -> bool:
    """Whether a filter watches; what says neither yes nor no is refused by a ModelError."""
    if watch is None or isinstance(watch, bool | np.bool_) or is_left(watch, 0):
        return bool(watch)
    raise ModelError(f"OnlineFilter(...): watch is True or False, not {watch!r}")
