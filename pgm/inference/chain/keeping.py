"""Running a schedule on a chain: all runs at once, or in parts, of which little may be kept."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from pgm.compile import DynamicGraph, SliceLayout
from pgm.errors import EvidenceError, ExecutorError, GraphError, PgmError
from pgm.evidence import BoundEvidence
from pgm.factors import Gaussian
from pgm.factors.scope import Scope, as_scope, listed
from pgm.inference.chain.jobs import Job, Told, Wanted, do, write
from pgm.inference.chain.joining import joined, one_status, swept_once
from pgm.inference.chain.kept import KeptPosterior
from pgm.inference.chain.parts import Part, split
from pgm.inference.chain.posterior import ChainPosterior
from pgm.inference.chain.run import run as run_chain
from pgm.inference.executors import Workers
from pgm.inference.schedule import Filtering, Schedule
from pgm.inference.start import Start
from pgm.kernels.arrays import Array, frozen
from pgm.linearisers import Lineariser
from pgm.sizes import require_memory
from pgm.variables import Variable

if TYPE_CHECKING:
    from concurrent.futures import Executor

Keep = Variable | Iterable[Variable]


def run(
    graph: DynamicGraph,
    bound: BoundEvidence,
    schedule: Schedule | None,
    lineariser: Lineariser,
    start: Start | None,
    keep: Keep | None,
    executor: Executor | None,
) -> ChainPosterior | KeptPosterior:
    """Send the messages of a schedule.

    Parameters
    ----------
    graph, bound, schedule, lineariser, start
        As `run` of a chain takes them.
    keep : Variable or iterable of Variable, or None
        Whose marginals alone are kept, which bounds what is held at a time; None for everything.
    executor : Executor or None
        Whose workers share the parts.
    """
    workers = Workers(executor)
    kept = None if keep is None else _hidden(graph.layout, keep)
    _require_memory(graph.layout, bound, schedule, kept)
    parts = [Part(slice(0, bound.runs), graph, bound, start)]
    if kept is not None or executor is not None:
        parts = list(split(graph, bound, lineariser, start, workers.count))
    if len(parts) == 1:
        workers = Workers(None)
        if kept is None:
            return run_chain(graph, bound, schedule, lineariser, start)
    wanted = Wanted.of(graph, schedule, start, kept)
    room = workers.room(wanted.shapes(graph, bound))
    jobs = [
        Job(part, schedule, lineariser, wanted, _of(room, part) if workers.shares else None)
        for part in parts
    ]
    model, told = graph.model, list[Told]()
    named = (*model.prior, *model.transition, *model.observation, lineariser)
    work = workers.each(do, jobs, [part.runs for part in parts], large=not room, named=named)
    for part, done in zip(parts, work, strict=True):
        if isinstance(done.error, PgmError) and not isinstance(done.error, ExecutorError):
            # The error is to be that of one process, whose first one is of other runs maybe.
            whole = [Part(slice(0, bound.runs), graph, bound, start)]
            for own in whole if kept is None else split(graph, bound, lineariser, start, 1):
                if own.runs.stop > part.runs.start and own.runs.start < part.runs.stop:
                    run_chain(own.graph, own.bound, schedule, lineariser, own.start)
        each = done.result()
        if each.careful and kept is None:
            # Its joints need all that the careful pass leaves.
            return run_chain(graph, bound, schedule, lineariser, start)
        if each.arrays is not None:
            write(_of(room, part), each.arrays)
        told.append(each._replace(arrays=None))
    status = one_status((each.status for each in told), bound.lead)
    if kept is not None:
        kinds = {each.log_evidence_kind for each in told}
        return KeptPosterior(
            graph,
            status,
            told[0].kind,
            _gaussians(kept, room, bound),
            frozen(room[-1].reshape(bound.lead).copy()),
            kinds.pop() if len(kinds) == 1 else "linearised",  # a fixed point is one of all runs
        )
    if wanted.beliefs:
        return swept_once(graph, bound, lineariser, status, room)
    found = [each.found for each in told if each.found is not None]
    return joined(graph, bound, lineariser, status, found)


def _of(room: Sequence[Array], part: Part) -> list[Array]:
    return [array[:, part.runs] for array in room]


def _require_memory(
    layout: SliceLayout, bound: BoundEvidence, schedule: Schedule | None, kept: Scope | None
) -> None:
    """Refuse beliefs that would not fit: a smoother has those before and after each reading too."""
    sizes = [layout.slice_size] if kept is None else [v.dimension for v in kept]
    sets = 4 if kept is None and not isinstance(schedule, Filtering) else 1
    require_memory(
        sets * (bound.steps + 1) * bound.runs * sum(size * (size + 1) for size in sizes),
        f"the beliefs at {bound.steps + 1} steps in {bound.runs} runs",
        "give fewer runs or steps to a call"
        + ("" if kept is not None else "; keep=[x] keeps the marginals of x alone"),
        error=GraphError,
    )


def _hidden(layout: SliceLayout, keep: Keep) -> Scope:
    kept = as_scope(keep, "keep", ordered=False)
    for variable in kept:
        if variable not in layout.slice:
            raise EvidenceError(
                f"keep has {variable!r}, which is not hidden; it takes {listed(layout.slice)}",
                variable=variable,
            )
    return kept


def _gaussians(
    kept: Scope, room: Sequence[Array], bound: BoundEvidence
) -> dict[Variable, Gaussian]:
    found = {}
    for variable, mean, cov in zip(kept, room[::2], room[1::2], strict=False):
        found[variable] = Gaussian._make(
            (variable,),
            mean.swapaxes(0, 1).reshape(*bound.lead, len(mean), variable.dimension),
            cov.swapaxes(0, 1).reshape(*bound.lead, len(mean), *cov.shape[2:]),
            np.arange(bound.steps + 1 - len(mean), bound.steps + 1),
        )
    return found
