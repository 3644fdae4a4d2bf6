"""Batches of evidence: pieces that fit into memory, and the different runs, each once.

A run is one set of evidence of a batch. Evidence gives an observed state once for all runs, or as
an array with a state for each run, where −1 is "not observed in this run". On a tree as many runs
are *calibrated at once*, in one set of arrays, as fit into a limit; if that would be fewer than 64
(`FEW`), they are calibrated one by one.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from pgm.evidence.static import BoundStates
from pgm.kernels.arrays import Array, Integers
from pgm.progress import counted

# If fewer runs than this fit at once, they are computed one by one: loops over a few are short, and
# the tables of one run stay nearer the processor.
FEW = 64


def at_once(entries: int, batch: int) -> int:
    """How many runs of a tree are calibrated at once: as many as fit into a limit, or one.

    `entries` is the number of entries of the tree's tables in one run, `batch` the limit on entries
    times runs. If fewer than 64 runs (`FEW`) fit, the result is one.
    """
    size = batch // entries
    return size if size >= FEW else 1


def tree_pieces(entries: int, evidence: BoundStates, batch: int) -> Iterator[BoundStates]:
    """The evidence in consecutive parts, each of as many runs as a tree calibrates at once.

    `entries` is the number of entries of the tree's tables in one run, `batch` the limit on entries
    times runs. Where a part of a batch has one run alone, the variables that this run does not
    observe are left out of its evidence, so that the evidence has no states −1.
    """
    for piece in pieces(evidence, at_once(entries, batch)):
        yield of_one(piece) if piece.lead and piece.runs == 1 else piece


def of_one(evidence: BoundStates) -> BoundStates:
    """The evidence of one run, without the variables whose state is −1, "not observed".

    States in arrays of length one become whole numbers; soft evidence stays as it is.
    """
    known = {v: s if isinstance(s, int) else int(s[0]) for v, s in evidence.states.items()}
    observed = {v: state for v, state in known.items() if state >= 0}
    return BoundStates(evidence.lead, observed, evidence.weights)


def pieces(evidence: BoundStates, size: int) -> Iterator[BoundStates]:
    """The evidence in consecutive parts of `size` runs or fewer; unchanged if one part will do."""
    size = max(1, size)
    if evidence.runs <= size:
        yield evidence
        return
    for start in counted(range(0, evidence.runs, size), "parts of the runs"):
        yield some_runs(evidence, slice(start, start + size))


def some_runs(evidence: BoundStates, which: slice | Integers) -> BoundStates:
    """The evidence of the runs `which`, a slice or indices; the result has one axis of runs."""
    count = np.arange(evidence.runs)[which].size
    states = {
        v: s if isinstance(s, int) or s.size == 1 else s[which] for v, s in evidence.states.items()
    }
    weights = {v: w if len(w) == 1 else w[which] for v, w in evidence.weights.items()}
    return BoundStates((count,), states, weights)


# Runs are compared by codes of their states: whole numbers below this, for 64 bits.
CODES = 2**62


@dataclass(frozen=True, eq=False)
class Distinct:
    """The runs of a batch that differ in evidence, each once: runs of equal evidence share results.

    evidence: The evidence of the different runs.
    which: (runs,): for each run of the batch, the index of the run in `evidence` that equals it.
        None if all runs are different, or are taken to be so without comparison.
    """

    evidence: BoundStates
    which: Integers | None

    @classmethod
    def of(cls, evidence: BoundStates) -> Distinct:
        """Find the different runs.

        If any soft evidence has weights for each run, all runs count as different.
        """
        if evidence.runs == 1 or any(len(weights) > 1 for weights in evidence.weights.values()):
            return cls(evidence, None)
        codes = np.zeros(evidence.runs, dtype=np.int64)
        count = 1
        for variable, state in evidence.states.items():
            if isinstance(state, int) or state.size == 1:
                continue
            if count * (variable.size + 1) > CODES:
                codes = np.unique(codes, return_inverse=True)[1]
                count = evidence.runs
            codes = codes * (variable.size + 1) + state + 1
            count *= variable.size + 1
        _, first, which = np.unique(codes, return_index=True, return_inverse=True)
        if first.size == evidence.runs:
            return cls(evidence, None)
        return cls(some_runs(evidence, first), which)

    def spread(self, values: Array) -> Array:
        """Copy values of the different runs to all runs of the batch that equal them.

        Shape (..., [different runs]) becomes (..., [runs]); a single run has no axis.
        """
        if self.which is None:
            return values
        if self.evidence.runs == 1:
            return np.broadcast_to(values[..., None], (*values.shape, self.which.size))
        return values[..., self.which]
