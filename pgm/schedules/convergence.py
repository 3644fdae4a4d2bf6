"""The warnings of a call: of iterations not settled, beliefs lost, functions that no line fits.

The *residual* of an iteration is the largest change of a message, or the largest move of a mean in
standard deviations. The iterations of a run have *settled*, or converged, when the last residual is
within the tolerance. A call warns once, of all its runs together. One linearisation is a plain
filter or smoother, and a tolerance of 0 asks for a number of iterations: nobody expects a fixed
point of either, and no warning is given, unless messages diverge.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable

import numpy as np

from pgm.clustergraph import ClusterGraph
from pgm.errors import ConvergenceWarning, LinearisationWarning, LostWarning, levels_to_user
from pgm.kernels.arrays import Array, Mask
from pgm.posteriors.outcome import B
from pgm.posteriors.posterior import Posterior
from pgm.posteriors.status import Status
from pgm.schedules.damping import LevenbergMarquardt
from pgm.schedules.loopy import GROWN
from pgm.schedules.schedule import Calibration, Filtering, FixedLag, Loopy, Schedule

# Advice to take more iterations is given up to so many times as many as were made, or as a few.
_PATIENCE, _FEW = 10, 10
# Rounds over which a residual that shrinks each time shrinks steadily.
_STEADY = 10


def is_iterated(schedule: Schedule | None) -> bool:
    """Whether a schedule iterates: one for loopy graphs, or of two or more linearisations.

    False for None, the default, which linearises once.
    """
    if isinstance(schedule, Loopy):
        return True
    return schedule is not None and schedule.iterations > 1


def told(posterior: Posterior[B], schedule: Schedule | None) -> Posterior[B]:
    """The same posterior, after warnings of what is wrong with it, once for all runs.

    A `LostWarning` is given if a belief was lost, else a `LinearisationWarning` if no line fits a
    function over its belief; and a `ConvergenceWarning` if some run has not settled: not after a
    single linearisation, for a tolerance of 0 (unless messages diverged), or without a schedule.
    """
    if doubt := posterior._doubt():
        warnings.warn(doubt, LostWarning, stacklevel=levels_to_user())
    elif doubt := posterior._misfit():
        warnings.warn(doubt, LinearisationWarning, stacklevel=levels_to_user())
    if schedule is None or not is_iterated(schedule):
        return posterior
    status = posterior.status
    if isinstance(schedule, Loopy):
        tell_of_messages(status, schedule, posterior.graph, posterior._why_unsettled)
    elif not status.converged.all() and schedule.tolerance > 0.0:
        message = _of_linearisations(status, schedule)
        warnings.warn(message, ConvergenceWarning, stacklevel=levels_to_user())
    return posterior


def tell_of_messages(
    status: Status, schedule: Loopy, graph: ClusterGraph, why: Callable[[], str] = str
) -> None:
    """Warn if messages on a graph have not settled in some run.

    There is no warning with a tolerance of 0, unless they diverged. `why` is called for the cause,
    if it is known, as a sentence with a blank behind it.
    """
    if status.converged.all():
        return
    if schedule.tolerance > 0.0 or _diverged(status, schedule):
        message = _of_messages(graph, status, schedule, why())
        warnings.warn(message, ConvergenceWarning, stacklevel=levels_to_user())


def tell_online(converged: Mask, schedule: Filtering | FixedLag) -> None:
    """Warn if some run has not settled in a step of an online filter.

    `converged` (*runs) marks the runs that have. There is no warning of a single linearisation or
    with a tolerance of 0. The words are the same at each step, so that Python's default filter
    shows them once.
    """
    if is_iterated(schedule) and schedule.tolerance > 0.0 and not converged.all():
        message = (
            f"a step of the online filter had not settled after its {schedule.iterations} "
            f"linearisations (tolerance {schedule.tolerance:g}); belief.status.residuals says how "
            f"far from it. Give more iterations, or {_otherwise(schedule)}"
        )
        warnings.warn(message, ConvergenceWarning, stacklevel=levels_to_user())


def _diverged(status: Status, schedule: Loopy) -> bool:
    """Whether messages diverged in some run that did not settle.

    They did if the run's last residual is not finite or more than 10⁴ times its least, or if fewer
    rounds were sent than the schedule allows: only settled or diverged runs end before.
    """
    record = status.residuals.reshape(len(status.residuals), -1)[:, ~status.converged.reshape(-1)]
    grown = ~np.isfinite(record[-1]) | (record[-1] > GROWN * record.min(axis=0))
    return bool(grown.any()) or status.iterations < schedule.iterations


def _of_messages(graph: ClusterGraph, status: Status, schedule: Loopy, why: str) -> str:
    """The warning's text where messages on a graph have diverged or not settled, with advice."""
    last, of = _last(status)
    if _diverged(status, schedule):
        began = f"messages diverged{of}, and were stopped after {status.iterations} rounds"
        beliefs = ", and beliefs there mean nothing"
    else:
        began = f"messages had not settled{of} after {status.iterations} rounds"
        beliefs = ""
    ways = []
    needed = _needed(status, schedule.tolerance, over=10)
    if needed is not None:
        ways.append(f"iterations={needed}, which will do at this rate")
    if not _shrink_steadily(status):
        ways.append(f"damping={0.5 * (1.0 + schedule.damping):g}")
    if _has_hubs(graph):
        ways.append("pgm.compile(network, method=pgm.LTRIP()), which settles more often")
    ways.append("a junction tree, pgm.compile(network), which is exact")
    return (
        f"{began}: the last changed one by {last} (tolerance {schedule.tolerance:g}; "
        f"status.residuals){beliefs}. {why}Try {', or '.join(ways)}"
    )


def _shrink_steadily(status: Status) -> bool:
    """Whether residuals shrank in each of the last ten rounds, in every run that did not settle.

    False after ten or fewer rounds. Damping is for messages that swing or grow; as a rule it slows
    those that come steadily nearer.
    """
    record: Array = status.residuals.reshape(len(status.residuals), -1)
    last = record[-1 - _STEADY :, ~status.converged.reshape(-1)]
    return len(last) > _STEADY and bool((last[1:] < last[:-1]).all())


def _has_hubs(graph: ClusterGraph) -> bool:
    """Whether a graph has a hub, as a Bethe graph has.

    A hub is a cluster of one variable alone that has two or more neighbours.
    """
    return any(
        len(cluster.scope) == 1 and len(graph.neighbours(k)) > 1
        for k, cluster in enumerate(graph.clusters)
    )


def _of_linearisations(status: Status, schedule: Filtering | FixedLag | Calibration) -> str:
    """The warning's text where the iterated linearisations have not settled, with advice."""
    last, of = _last(status)
    began = f"iterations had not settled{of} after {status.iterations} linearisations"
    how = f" (tolerance {schedule.tolerance:g}; status.residuals)"
    if not len(status.residuals):
        return f"{began}{how}: the weights of robust noise still move. {_otherwise(schedule)}"
    found = f"{began}: the last moved a mean by {last} of its standard deviations{how}"
    needed = _needed(status, schedule.tolerance, over=1)
    if needed is None:
        return f"{found}. They shrink slowly, or not: {_otherwise(schedule)}"
    return f"{found}. At this rate iterations={needed} will do; else {_otherwise(schedule)}"


def _otherwise(schedule: Filtering | FixedLag | Calibration) -> str:
    """The advice of a warning, apart from more iterations: to damp, start nearer, or tolerate more.

    Only what the schedule can do is advised.
    """
    ways = []
    damping = getattr(schedule, "damping", None)
    if isinstance(damping, LevenbergMarquardt):
        ways.append("a number as damping, for with few sigma points no step may lower the cost")
    elif damping is not None:
        ways += [f"damping={0.5 * (1.0 + damping):g}", "damping=pgm.LevenbergMarquardt()"]
    if isinstance(schedule, Calibration):
        ways.append("a start= nearer to the optimum")
    ways.append("a tolerance= that is enough for the purpose")
    return f"try {', or '.join(ways)}"


def _last(status: Status) -> tuple[str, str]:
    """Two parts of a warning's text: the last residual, and how many runs have not settled.

    The first is the largest last residual of the unsettled runs, empty if none was recorded. The
    second, such as " in 2 of 8 runs" with its leading blank, is empty if there is only one run.
    """
    unsettled = ~status.converged
    count, size = int(unsettled.sum()), unsettled.size
    of = f" in {count} of {size} runs" if size > 1 else ""
    if not len(status.residuals):
        return "", of
    last = float(status.residuals[-1][unsettled].max())
    return (f"{last:.3g}" if math.isfinite(last) else "more than float64 holds"), of


def _needed(status: Status, tolerance: float, over: int) -> int | None:
    """The total number of iterations after which the slowest run will have settled, or None.

    The residual of that run is taken to shrink on by the mean factor of its last `over` iterations.
    None if that residual does not shrink, if the tolerance is 0, and if the total would exceed both
    100 and ten times the number of iterations made: other advice is better then.
    """
    record: Array = status.residuals.reshape(len(status.residuals), -1)
    over = min(over, len(record) - 1)
    if over < 1:
        return None
    run = int(np.where(status.converged.reshape(-1), -1.0, record[-1]).argmax())
    before, last = float(record[-1 - over, run]), float(record[-1, run])
    if not tolerance > 0.0 or not 0.0 < last < before < math.inf:
        return None
    rate = math.log(last / before) / over
    found = status.iterations + max(math.ceil(math.log(tolerance / last) / rate), 1)
    return found if found <= _PATIENCE * max(status.iterations, _FEW) else None
