"""The work on a part of the runs: what is handed out, what is done, and what is told of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from pgm.compile import BalancedGraph, DynamicGraph
from pgm.evidence import BoundEvidence
from pgm.factors.scope import Scope
from pgm.inference.chain.parts import Part
from pgm.inference.chain.posterior import ChainPosterior
from pgm.inference.chain.run import run
from pgm.inference.executors import Shape, address
from pgm.inference.kind import Kind
from pgm.inference.schedule import Calibration, Filtering, Schedule
from pgm.inference.start import Start
from pgm.inference.status import Status
from pgm.kernels.arrays import Array
from pgm.linearisers import Lineariser


@dataclass(frozen=True)
class Wanted:
    """The share of a posterior that is wanted: beliefs as arrays, or all of it.

    Attributes
    ----------
    kept : tuple of Variable or None
        Whose marginals alone are.
    beliefs : bool
        Whether the beliefs of all are enough, since a sweep finds all else from them.
    smoothed : bool
        Whether there are smoothed ones.
    """

    kept: Scope | None
    beliefs: bool
    smoothed: bool

    @classmethod
    def of(
        cls, graph: DynamicGraph, schedule: Schedule | None, start: Start | None, kept: Scope | None
    ) -> Wanted:
        """A posterior of one linearisation is found again from its beliefs; others are not."""
        once = schedule is None or (
            isinstance(schedule, Filtering | Calibration) and schedule.iterations == 1
        )
        plain = start is None and not isinstance(graph, BalancedGraph)
        return cls(kept, kept is None and once and plain, not isinstance(schedule, Filtering))

    def shapes(self, graph: DynamicGraph, bound: BoundEvidence) -> list[Shape]:
        """The shapes of the arrays for all runs."""
        layout, everywhere = graph.layout, (bound.steps + 1, bound.runs)
        found: list[Shape] = []
        if self.kept is not None:
            for variable in self.kept:
                lead = (bound.steps + (variable in layout.states), bound.runs)
                found += [(lead, (variable.dimension,)), (lead, (variable.dimension,) * 2)]
            return [*found, ((1, bound.runs), ())]
        if self.beliefs:
            moments = [(everywhere, (layout.slice_size,)), (everywhere, (layout.slice_size,) * 2)]
            return [*moments, (everywhere, ()), *(moments if self.smoothed else ())]
        return []

    def arrays(self, found: ChainPosterior, runs: int) -> list[Array]:
        """These arrays of a part."""
        if self.kept is None:
            swept, smoothed = found._swept, found._smoothed
            last = [] if smoothed is None else [smoothed.mean, smoothed.cov]
            return [swept.mean, swept.cov, swept.log_density, *last]
        arrays: list[Array] = []
        for variable in self.kept:
            belief, size = found[variable], variable.dimension
            arrays += [
                belief.mean.reshape(runs, -1, size).swapaxes(0, 1),
                belief.cov.reshape(runs, -1, size, size).swapaxes(0, 1),
            ]
        return [*arrays, found.log_evidence.reshape(1, runs)]


@dataclass(frozen=True, eq=False)
class Job:
    """Some runs, and what to make of them.

    Attributes
    ----------
    part : Part
    schedule, lineariser
        As of `run`.
    wanted : Wanted
    room : sequence of ndarray or None
        Where the arrays wanted are written to; None, where they are told.
    """

    part: Part
    schedule: Schedule | None
    lineariser: Lineariser
    wanted: Wanted
    room: Sequence[Array] | None


class Told(NamedTuple):
    """The result of a part of the runs.

    Attributes
    ----------
    status : Status
    kind : Kind
    log_evidence_kind : str
    careful : bool
        Whether it took twice the digits; then nothing else is told, unless variables are kept.
    arrays : list of ndarray or None
        Those wanted, if they have not been written.
    found : ChainPosterior or None
        All of it, if that is wanted.
    """

    status: Status
    kind: Kind
    log_evidence_kind: str
    careful: bool
    arrays: Sequence[Array] | None = None
    found: ChainPosterior | None = None


def do(job: Job) -> Told:
    """Send the messages of the runs of a job."""
    part, wanted = job.part, job.wanted
    slice_, room = part.graph.layout.slice, None
    if job.room and (wanted.kept is None or wanted.kept == slice_):
        room = job.room[0], job.room[1]
    found = run(part.graph, part.bound, job.schedule, job.lineariser, part.start, room)
    careful = found._careful is not None
    told = Told(found.status, found.kind, found.log_evidence_kind, careful)
    if wanted.kept is None and told.careful:
        return told
    if wanted.kept is None and not wanted.beliefs:
        return told._replace(found=found)
    arrays = wanted.arrays(found, part.bound.runs)
    if job.room is None:
        return told._replace(arrays=arrays)
    write(job.room, arrays)
    return told


def write(room: Sequence[Array], arrays: Sequence[Array]) -> None:
    """Put arrays in their room."""
    for place, array in zip(room, arrays, strict=True):
        if address(place) != address(array):  # it has not been made there
            np.copyto(place, array)
