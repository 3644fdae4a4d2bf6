"""Runs of equal evidence, which are computed once: records of a few variables repeat themselves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pgm.evidence.discrete import BoundStates
from pgm.kernels.arrays import Array, Integers

# Codes of runs are whole numbers of 64 bits.
CODES = 2**62


@dataclass(frozen=True, eq=False)
class Distinct:
    """The runs of some evidence, each different one once.

    Attributes
    ----------
    evidence : BoundStates
        Of the runs that differ.
    which : ndarray of int or None
        (runs,): which of them each run is; None if all differ.
    """

    evidence: BoundStates
    which: Integers | None

    @classmethod
    def of(cls, evidence: BoundStates) -> Distinct:
        """Find the runs that differ; those with weights of their own are not compared."""
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
        states = {
            v: s if isinstance(s, int) or s.size == 1 else s[first]
            for v, s in evidence.states.items()
        }
        return cls(BoundStates((first.size,), states, evidence.weights), which)

    def spread(self, values: Array) -> Array:
        """Values (..., [runs that differ]) as those of all runs, (..., [runs])."""
        if self.which is None:
            return values
        if self.evidence.runs == 1:
            return np.broadcast_to(values[..., None], (*values.shape, self.which.size))
        return values[..., self.which]
