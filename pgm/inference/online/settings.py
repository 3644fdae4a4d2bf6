"""The settings of an online filter, checked."""

from __future__ import annotations

from typing import Any

from pgm.display import titled
from pgm.errors import ModelError
from pgm.inference.checks import require_gaussian, require_lineariser, require_plain
from pgm.inference.schedule import ONCE, Filtering, FixedLag
from pgm.networks import DynamicBayesianNetwork


def require_settings(
    model: Any, lineariser: Any, schedule: Any, lag: int | None
) -> Filtering | FixedLag:
    """The schedule of a filter, whose settings are refused if they are none, or do not fit."""
    if not isinstance(model, DynamicBayesianNetwork):
        raise ModelError(f"a dynamic network was due, not {titled(model)}")
    require_lineariser(lineariser)
    if lag is not None and schedule is not None:
        raise ModelError(
            f"lag={lag!r} beside {schedule!r}: an online filter takes one of them; a FixedLag "
            "has iterations of its own"
        )
    if schedule is None:
        schedule = ONCE if lag is None else FixedLag(lag)
    if not isinstance(schedule, Filtering | FixedLag):
        raise ModelError(
            f"an online filter takes pgm.Filtering(...) or pgm.FixedLag(...), not {schedule!r}"
        )
    require_gaussian((*model.prior, *model.transition, *model.observation), "Gaussian beliefs")
    require_plain(model.transition)
    for cpd in model.prior:
        cpd.require_proper("an online filter begins at a belief, which has moments")
    return schedule
