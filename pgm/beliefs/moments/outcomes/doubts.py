"""Doubts about the beliefs of a chain, for its summary and for warnings.

A belief is *lost* where innovations or gates say that it is wrong (`pgm.posteriors.lost`), and a
linearisation is *wrong* where the CPD is too nonlinear over the belief for any line
(`pgm.posteriors.nonlinearity`).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from pgm.beliefs.moments.outcomes.nonlinear import Linearised, linearised
from pgm.beliefs.moments.passes.forward import Filtered
from pgm.errors import PgmError
from pgm.posteriors.nonlinearity import advice

if TYPE_CHECKING:
    from pgm.beliefs.moments.outcomes.outcome import ChainOutcome

# Of so many steps of all runs together a summary asks, and a warning is looked for.
_MOST = 20_000
# A warning looks at so many rows of a CPD, and is given where the error of the best line governs
# more than this share of the child's components in more than this share of the runs. Of drives
# with ranges and bearings from a known start up to 2 in 100 are such, of those from a start known
# within 3 m and 1 rad all (200 each, filtered and smoothed by one linearisation).
_ROWS, _SHARE, _RUNS = 4, 0.5, 0.05


def told(posterior: ChainOutcome) -> list[str]:
    """The lines of a summary on what is wrong: none if nothing is, and one if it is not asked."""
    plan = posterior._planned
    if (plan.steps + 1) * plan.runs > _MOST:
        return ["of so many steps posterior.lost and posterior.nonlinearity are not asked here"]
    lines = []
    if posterior.lost:
        lines.append(f"lost at {posterior.lost.brief}")
    try:
        wrong = posterior.nonlinearity.told(posterior.status.iterations)
    except PgmError as error:
        return [*lines, f"posterior.nonlinearity: none: {error}"]
    return [*lines, wrong] if wrong else lines


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
        "where no line is right. If so, smooth with iterations=, or try pgm.estimate; else look at "
        "the model's noise, and for outliers"
    )


def misfit(posterior: ChainOutcome) -> str:
    """The text of a warning that no line fits some function, empty if none is known not to.

    Functions are evaluated for that, so that the first call of a model by a rule looks alone, at
    the rows with the widest beliefs. A filter of many runs, which has not kept the beliefs over
    which it linearised, is not swept again for it.
    """
    plan, layout = posterior._planned, posterior.graph.layout
    if (plan.steps + 1) * plan.runs > _MOST or isinstance(posterior._swept, Filtered):
        return ""
    rules = [type(each.lineariser) for each in plan.families if not each.exact]
    rule = posterior.kind, posterior.status.iterations == 1, *rules
    if rule in layout.looked_at:
        return ""
    layout.looked_at.add(rule)
    try:
        wrong = any(_is_wrong(each) for each in linearised(posterior).values())
    except PgmError:  # of a function that fails over a belief, which a summary tells
        return ""
    if not wrong:
        return ""
    return (
        "functions bend so much over the beliefs that no line is right: print(posterior) says of "
        f"which CPDs, and posterior.nonlinearity where; {advice(posterior.status.iterations)}"
    )


def _is_wrong(each: Linearised) -> bool:
    """Whether the best line of a CPD is known to be wrong, in more than a few runs."""
    figures = each.figures(each.widest(_ROWS))
    wrong = (figures > _SHARE * each.family.cpd.child.dimension).any(axis=0)
    return bool(wrong.mean() > _RUNS)
