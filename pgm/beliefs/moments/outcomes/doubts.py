"""Doubts about the beliefs of a chain, for its summary and for a warning.

A belief is *lost* where innovations or gates say that it is wrong (`pgm.posteriors.lost`), and a
linearisation is *wrong* where the CPD is too nonlinear over the belief for any line
(`pgm.posteriors.nonlinearity`).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from pgm.errors import PgmError

if TYPE_CHECKING:
    from pgm.beliefs.moments.outcomes.outcome import ChainOutcome

# Of so many steps of all runs together a summary asks.
_MOST = 20_000


def told(posterior: ChainOutcome) -> list[str]:
    """The lines of a summary on what is wrong: none if nothing is, and one if it is not asked."""
    plan = posterior._planned
    if (plan.steps + 1) * plan.runs > _MOST:
        return ["of so many steps posterior.lost and posterior.nonlinearity are not asked here"]
    lines = []
    if posterior.lost:
        lines.append(f"lost at {posterior.lost.brief}")
    try:
        wrong = posterior.nonlinearity.wrong
    except PgmError as error:
        return [*lines, f"posterior.nonlinearity: none: {error}"]
    if wrong:
        iterated = posterior.status.iterations > 1
        advice = "try pgm.estimate" if iterated else "smooth with iterations=, or try pgm.estimate"
        lines.append(f"linearised where no line is right: {wrong}; {advice}")
    return lines


def is_held(posterior: ChainOutcome) -> bool:
    """Whether the belief was never lost.

    Sweeps of machine code tell by themselves; of others it is asked.
    """
    held = posterior._held
    return not posterior.lost if held is None else held


def doubt(*, held: bool, whole: bool = True) -> str:
    """The text of a warning of a belief that was lost, empty if it was `held`.

    `whole` says that the posterior has all that tells where.
    """
    if held:
        return ""
    without = "" if whole else "without keep= "
    return (
        "the belief was lost at some steps: innovations are too large for it, or gates reject too "
        f"much; {without}posterior.lost says where, and print(posterior) whether it was linearised "
        "where no line is right. Smooth with iterations=, try pgm.estimate, or look at the model's "
        "noise"
    )
