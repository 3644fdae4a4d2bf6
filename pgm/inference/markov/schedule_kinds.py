"""Checks of the schedules for chains whose beliefs are tables, grids or particles.

A schedule tells which messages are sent, and so the kind of the beliefs: filtered, fixed-lag or
smoothed. Nothing is linearised on these chains, so that there is nothing to iterate or damp.
"""

from __future__ import annotations

from pgm.compile import BalancedGraph, DynamicGraph
from pgm.display import titled
from pgm.errors import GraphError, ModelError
from pgm.inference.belief_kind import Kind
from pgm.inference.schedule import Calibration, Filtering, FixedLag, Schedule, Smoothing


def require_chain(graph: DynamicGraph, beliefs: str) -> None:
    """Raise `GraphError` for a balanced tree of slices, since these beliefs need a chain of them.

    `beliefs` names the beliefs in the error's text: a plural such as "tables".
    """
    if isinstance(graph, BalancedGraph):
        raise GraphError(
            f"{beliefs} go along a chain of slices, which {titled(graph)} is not: leave method= "
            "out of pgm.compile or pgm.smooth"
        )


def kind_of(schedule: Schedule | None, beliefs: str) -> Kind:
    """The kind of beliefs that a schedule gives; smoothed without a schedule.

    `Filtering`, `FixedLag` and `Smoothing` are taken, and `Calibration` counts as `Smoothing`. Any
    other schedule raises a `ModelError`, and so does one with damping, more than one iteration, or
    a gate, which would leave out measurements that lie too far from their prediction.
    `beliefs` names the beliefs in the error's text: a plural such as "tables".
    """
    if schedule is None or type(schedule) is Calibration:
        schedule = Smoothing() if schedule is None else Smoothing(schedule.iterations)
    if not isinstance(schedule, Filtering | FixedLag | Smoothing):
        raise ModelError(
            f"{beliefs} take pgm.Filtering(), pgm.FixedLag(...) or pgm.Smoothing(), not "
            f"{schedule!r}"
        )
    if schedule.gate is not None:
        raise ModelError(
            f"{schedule!r}: a gate is for Gaussian beliefs, whose innovations have a covariance; "
            f"{beliefs} weigh measurements: leave it out"
        )
    if schedule.iterations != 1 or schedule.damping:
        raise ModelError(
            f"{schedule!r}: {beliefs} need no linearising, so that there is nothing to "
            "iterate or damp; leave iterations and damping out"
        )
    return schedule.kind
