"""Evidence enters the tables: each variable's at its home."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from pgm.evidence.discrete import BoundStates
from pgm.factors.axes import States
from pgm.inference.discrete.place import Place
from pgm.inference.discrete.storage import Storage
from pgm.kernels.arrays import Array, Integers
from pgm.kernels.semirings import LOG_SUM_PRODUCT, Semiring
from pgm.variables import Discrete

# Runs at once, less than which are computed one by one: loops over a few are short, and the tables
# of one run stay nearer the processor.
FEW = 64


def multiply(storage: Storage, tables: Array, evidence: BoundStates, semiring: Semiring) -> None:
    """Multiply evidence into tables, (entries, [runs])."""
    runs = tables.ndim > 1
    for variable, state in evidence.states.items():
        if runs and not isinstance(state, int):
            weights = semiring.entries(one_hot(state, variable.size))
            _weigh(storage.by_state[variable], tables, variable, weights, semiring)
        else:
            known = state if isinstance(state, int) else int(state[0])
            if known >= 0:
                _exclude(storage.by_state[variable], tables, variable, known, semiring)
    for variable, soft in evidence.weights.items():
        weights = semiring.entries(soft.T if runs else soft[0])
        _weigh(storage.by_state[variable], tables, variable, weights, semiring)


def _weigh(
    source: Integers | Place, tables: Array, variable: Discrete, weights: Array, semiring: Semiring
) -> None:
    """Multiply weights (states, [runs]) in."""
    if isinstance(source, Place):
        table = source.by_state(tables, variable)
        semiring.times(table, weights[:, None], table)
    else:
        tables[source] = semiring.times(tables[source], weights[:, None])


def _exclude(
    source: Integers | Place, tables: Array, variable: Discrete, state: int, semiring: Semiring
) -> None:
    """Clear all states but one."""
    if isinstance(source, Place):
        table = source.by_state(tables, variable)
        table[:, :state] = semiring.zero
        table[:, state + 1 :] = semiring.zero
    else:
        if state:
            tables[source[:state]] = semiring.zero
        if state + 1 < len(source):
            tables[source[state + 1 :]] = semiring.zero


def enter_everywhere(storage: Storage, logs: Array, evidence: BoundStates) -> Array:
    """Logarithms of the potentials times the evidence, (entries, runs).

    States enter every cluster that has the variable, so that no message has to bring them; weights
    enter one.
    """
    tables = np.repeat(logs[:, None], evidence.runs, axis=1)
    for variable, state in evidence.states.items():
        shown = np.reshape(state, -1)
        weights = LOG_SUM_PRODUCT.entries(one_hot(shown, variable.size))
        for cluster in storage.holders[variable]:
            tables[storage.places[cluster].split(variable)] += weights[:, None]
    for variable, soft in evidence.weights.items():
        _weigh(
            storage.by_state[variable],
            tables,
            variable,
            LOG_SUM_PRODUCT.entries(soft.T),
            LOG_SUM_PRODUCT,
        )
    return tables


def one_hot(states: Integers, size: int) -> Array:
    """One where a state is the one observed, or none is: (size, runs)."""
    found: Array = ((states == np.arange(size)[:, None]) | (states < 0)).astype(float)
    return found


def put_in(evidence: BoundStates, scope: States) -> dict[Discrete, int]:
    """The variables of a scope whose state is one and the same for all runs."""
    states = evidence.states
    return {v: s for v in scope if isinstance(s := states.get(v), int)}


def axes_left(evidence: BoundStates, scope: States) -> States:
    """The variables that messages and beliefs have axes of: those that are not put in."""
    return tuple(v for v in scope if not isinstance(evidence.states.get(v), int))


def at_once(entries: int, batch: int) -> int:
    """The runs of a tree that are calibrated at once: as many as fit, or one if only few do."""
    size = batch // entries
    return size if size >= FEW else 1


def tree_pieces(entries: int, evidence: BoundStates, batch: int) -> Iterator[BoundStates]:
    """Some runs after the other, as many as are calibrated at once."""
    return _split(evidence, at_once(entries, batch))


def pieces(entries: int, evidence: BoundStates, batch: int) -> Iterator[BoundStates]:
    """Some runs after the other, as many as fit for tables of so many entries."""
    return _split(evidence, max(1, batch // entries))


def _split(evidence: BoundStates, size: int) -> Iterator[BoundStates]:
    if evidence.runs <= size:
        yield evidence
        return
    for start in range(0, evidence.runs, size):
        yield some_runs(evidence, start, min(start + size, evidence.runs))


def some_runs(evidence: BoundStates, start: int, stop: int) -> BoundStates:
    """The evidence of consecutive runs."""
    states = {
        v: s if isinstance(s, int) or s.size == 1 else s[start:stop]
        for v, s in evidence.states.items()
    }
    weights = {v: w if len(w) == 1 else w[start:stop] for v, w in evidence.weights.items()}
    return BoundStates((stop - start,), states, weights)


def alone(evidence: BoundStates) -> BoundStates:
    """The evidence of a single run without what is not observed in it; of several, itself."""
    if not evidence.lead or evidence.runs > 1:
        return evidence
    return BoundStates(evidence.lead, states_of_one(evidence), evidence.weights)


def states_of_one(evidence: BoundStates) -> Mapping[Discrete, int]:
    """The states that are observed in a single run."""
    known = {v: s if isinstance(s, int) else int(s[0]) for v, s in evidence.states.items()}
    return {v: state for v, state in known.items() if state >= 0}


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
