"""Many runs cut into parts, slices of the runs with their evidence.

`lead` is the shape of the user's axes of runs, which are flattened to one.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from pgm.beliefs.moments.steps.some_runs import evidence_of, graph_of
from pgm.compile import DynamicGraph
from pgm.cpds import NonlinearGaussianCPD
from pgm.evidence import BoundEvidence
from pgm.evidence.rows import as_rows
from pgm.kernels.arrays import frozen
from pgm.linearisers import Lineariser
from pgm.schedules.starting_points import Start, over_runs, require_hidden

# What the working arrays of all parts at work may take, in bytes.
ROOM = 2**30
# Runs to a part at the most: with more, the numbers of a step leave the processor's cache.
MOST = 5000


@dataclass(frozen=True, eq=False)
class Part:
    """A slice of the runs, with a graph and evidence that have these runs alone.

    `start` has the means at which CPDs are linearised first in these runs; None without such means.
    """

    runs: slice
    graph: DynamicGraph
    bound: BoundEvidence
    start: Start | None


def split(whole: Part, lineariser: Lineariser, workers: int) -> Iterator[Part]:
    """The parts of all runs, in order: of equal size but for the last, which may be smaller.

    `whole` is the part of all runs. Parts are as large as memory and a limit of 5,000 runs allow,
    but their number is such that all `workers` get equally many, or some get one less, since sizes
    are rounded up.
    """
    graph, bound, start = whole.graph, whole.bound, whole.start
    size = _size(graph, bound, lineariser, workers)
    if size >= bound.runs:
        yield whole
        return
    if start is not None:
        require_hidden(start, graph.layout.slice)
        start = {v: over_runs(v, as_rows(v, a, "T+1"), bound.lead, 2) for v, a in start.items()}
    edges = [*range(0, bound.runs, size), bound.runs]
    for runs in (slice(first, last) for first, last in pairwise(edges)):
        own = None if start is None else {v: frozen(np.asarray(a)[runs]) for v, a in start.items()}
        yield Part(runs, graph_of(graph, bound, runs), evidence_of(bound, runs), own)


def _size(graph: DynamicGraph, bound: BoundEvidence, lineariser: Lineariser, workers: int) -> int:
    """The number of runs in a part, rounded up, so that each worker gets one part, or equally many.

    A part has 5,000 runs at the most, and fewer where memory would not hold them; each worker then
    gets several parts. A run needs about 5 (n + s) (n + 1) floats for each step, of a slice with n
    components, s of them of states, and 5 d (d + 1) for each measurement of d components. If a
    lineariser draws its points afresh for each run, the one part is all runs.
    """
    model = graph.model
    rules = [lineariser]
    for cpd in (*model.prior, *model.transition, *model.observation):
        if isinstance(cpd, NonlinearGaussianCPD) and cpd.lineariser is not None:
            rules.append(cpd.lineariser)
    if any(getattr(rule, "fresh_per_run", False) for rule in rules):
        return bound.runs  # what a run draws depends on how many come before it
    # About ten matrices and vectors of the slice for each step, five of each measurement.
    width = graph.layout.slice_size + graph.layout.state_size
    numbers = (bound.steps + 1) * 5 * width * (graph.layout.slice_size + 1)
    for reading in bound.readings:
        height = reading.cpd.child.dimension
        numbers += reading.step.size * 5 * height * (height + 1)
    most = min(max(ROOM // (8 * numbers * workers), 1), MOST)
    count = workers * math.ceil(bound.runs / (most * workers))
    return math.ceil(bound.runs / count)
