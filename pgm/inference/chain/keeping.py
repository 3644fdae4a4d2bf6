"""Running a schedule on a chain: all runs at once, or in parts, of which little may be kept."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from pgm.boundary import is_whole
from pgm.compile import DynamicGraph, SliceLayout
from pgm.errors import EvidenceError, GraphError, ModelError
from pgm.evidence import BoundEvidence
from pgm.factors import Gaussian
from pgm.factors.scope import Scope, as_scope, listed
from pgm.inference.chain.joining import joined, one_status
from pgm.inference.chain.kept import KeptPosterior
from pgm.inference.chain.parts import Part, each, split
from pgm.inference.chain.posterior import ChainPosterior
from pgm.inference.chain.run import run as run_chain
from pgm.inference.kind import Kind
from pgm.inference.schedule import Filtering, Schedule
from pgm.inference.start import Start
from pgm.inference.status import Status
from pgm.kernels.arrays import Array, frozen
from pgm.linearisers import Lineariser
from pgm.sizes import require_memory
from pgm.variables import Variable

Keep = Variable | Iterable[Variable]


def run(
    graph: DynamicGraph,
    bound: BoundEvidence,
    schedule: Schedule | None,
    lineariser: Lineariser,
    start: Start | None,
    keep: Keep | None,
    threads: int,
) -> ChainPosterior | KeptPosterior:
    """Send the messages of a schedule.

    Parameters
    ----------
    graph, bound, schedule, lineariser, start
        As `run` of a chain takes them.
    keep : Variable or iterable of Variable, or None
        Whose marginals alone are kept, which bounds what is held at a time; None for everything.
    threads : int
        How many threads share the parts.
    """
    if not is_whole(threads) or threads < 1:
        raise ModelError(f"threads must be a whole number, 1 or more, not {threads!r}")
    kept = None if keep is None else _hidden(graph.layout, keep)
    _require_memory(graph.layout, bound, schedule, kept)
    if kept is None and threads == 1:
        return run_chain(graph, bound, schedule, lineariser, start)

    def solve(part: Part) -> ChainPosterior:
        return run_chain(part.graph, part.bound, schedule, lineariser, part.start)

    parts = split(graph, bound, lineariser, start, threads)
    if kept is None:
        found = list(each(solve, parts, threads))
        if len(found) == 1:
            return found[0]
        if any(each._careful is not None for each in found):
            # Their joints need all that the careful passes leave.
            return run_chain(graph, bound, schedule, lineariser, start)
        return joined(graph, bound, lineariser, found)
    room = {variable: _room(graph.layout, bound, variable) for variable in kept}
    log_evidence = np.empty(bound.runs)

    def reduce(part: Part) -> tuple[Status, Kind, str]:
        found = solve(part)
        for variable, (mean, cov) in room.items():
            belief = found[variable]
            mean[part.runs] = belief.mean.reshape(mean[part.runs].shape)
            cov[part.runs] = belief.cov.reshape(cov[part.runs].shape)
        log_evidence[part.runs] = found.log_evidence.reshape(-1)
        return found.status, found.kind, found.log_evidence_kind

    statuses, kinds, evidence = zip(*each(reduce, parts, threads), strict=True)
    return KeptPosterior(
        graph,
        one_status(statuses, bound.lead),
        kinds[0],
        _gaussians(room, bound),
        frozen(log_evidence.reshape(bound.lead)),
        evidence[0]
        if len(set(evidence)) == 1
        else "linearised",  # a fixed point is one of all runs
    )


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


def _room(layout: SliceLayout, bound: BoundEvidence, variable: Variable) -> tuple[Array, Array]:
    """Room for means (runs, steps, d) and covariances (runs, steps, d, d)."""
    steps = bound.steps + (variable in layout.states)
    shape = (bound.runs, steps, variable.dimension)
    return np.empty(shape), np.empty((*shape, variable.dimension))


def _gaussians(
    room: Mapping[Variable, tuple[Array, Array]], bound: BoundEvidence
) -> dict[Variable, Gaussian]:
    return {
        variable: Gaussian._make(
            (variable,),
            mean.reshape(*bound.lead, *mean.shape[1:]),
            cov.reshape(*bound.lead, *cov.shape[1:]),
            np.arange(bound.steps + 1 - mean.shape[1], bound.steps + 1),
        )
        for variable, (mean, cov) in room.items()
    }
