"""Doubts about the beliefs of a chain, for its summary and for a warning.

A belief is *lost* where innovations or gates say that it is wrong (`pgm.posteriors.lost`), and a
linearisation is *wrong* where the CPD is too nonlinear over the belief for any line
(`pgm.posteriors.nonlinearity`).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from pgm.beliefs.moments.passes.forward import Forward
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


def doubt(posterior: ChainOutcome) -> str:
    """The text of a warning, empty if there is none, by what can be asked in a moment.

    That is where NumPy has swept the chain, and kept the predictions: the question then takes a
    hundredth of the time of the sweep where log-densities answer it, else a twentieth, of short
    linear chains a fifth. Machine code is as fast as the test.
    """
    if posterior.status.compilation.startswith("compiled"):
        return ""
    if not isinstance(posterior._swept, Forward) or posterior._surely_kept or not posterior.lost:
        return ""
    return (
        "the belief was lost at some steps: innovations are too large for it, or gates reject too "
        "much; posterior.lost says where, and print(posterior) whether it was linearised where no "
        "line is right. Smooth with iterations=, try pgm.estimate, or look at the model's noise"
    )
