"""The most probable assignments of a discrete network, one after another.

The best assignment of a *part* of all assignments is a maximum; the rest of the part is divided
into smaller ones, whose maxima are searched for in one call: in part k the first variables have the
best assignment's states, and variable k has another. The next assignment of all is the best of the
parts that are left, since each assignment but those found is in one of them.

Source: Lawler (1972), A procedure for computing the K best solutions. Nilsson (1998), An efficient
algorithm for finding the M most probable configurations.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from heapq import heappop, heappush
from itertools import count

import numpy as np

from pgm.evidence.static import BoundStates
from pgm.factors.axes import States
from pgm.kernels.arrays import Array, Integers, Mask
from pgm.variables import Discrete


@dataclass(order=True)
class _Part:
    """The assignments that agree with the best one on the first variables, but for one's states.

    below: What its best assignment lacks of ln p, negative: parts are ordered by it.
    number: One each, in the order in which they were made.
    best: The indices of all variables' states.
    fixed: How many of the first free variables have the best one's states.
    allowed: The states that the next free variable may have.
    """

    below: float
    number: int
    best: Integers = field(compare=False)
    fixed: int = field(compare=False)
    allowed: Mask = field(compare=False)


def likeliest(
    search: Callable[[BoundStates], tuple[Integers, Array]],
    evidence: BoundStates,
    variables: States,
    free: States,
) -> Iterator[tuple[Integers, float]]:
    """Assignments of one set of evidence, the most probable first, with ln p(assignment, evidence).

    search: Of some runs of evidence the most probable states of `variables`, (variables, runs), as
        indices, and ln p, (runs,), which is −∞ where the evidence is impossible.
    free: Those of the variables whose states may differ.
    """
    places = {v: k for k, v in enumerate(variables)}
    order = [places[v] for v in free]
    numbers, waiting = count(), list[_Part]()

    def divide(best: Integers, fixed: int, allowed: Mask) -> None:
        """Put the parts of what is left beside an assignment, with their maxima."""
        some = list[tuple[int, Mask]]()
        for k in range(fixed, len(free)):
            mask = np.arange(free[k].size) != best[order[k]]
            if k == fixed:
                mask &= allowed
            if mask.any():
                some.append((k, mask))
        if not some:
            return
        own = _evidence(evidence, free, best[order], some)
        states, levels = search(own)
        for run, (k, mask) in enumerate(some):
            if levels[run] > -np.inf:
                lacking = -float(levels[run])
                heappush(waiting, _Part(lacking, next(numbers), states[:, run], k, mask))

    states, levels = search(evidence)
    best = states[:, 0]
    yield best, float(levels[0])
    first = free[0].size if free else 0
    divide(best, 0, np.ones(first, dtype=bool))
    while waiting:
        part = heappop(waiting)
        yield part.best, -part.below
        divide(part.best, part.fixed, part.allowed)


def _evidence(
    evidence: BoundStates, free: States, best: Integers, parts: list[tuple[int, Mask]]
) -> BoundStates:
    """The evidence of the parts as runs: weights of one or zero of the free variables' states.

    All weights are logarithms.
    """
    runs = len(parts)
    weights: dict[Discrete, Array] = {
        v: np.broadcast_to(soft, (runs, v.size)) for v, soft in evidence.weights.items()
    }
    for k, variable in enumerate(free[: parts[-1][0] + 1]):
        own = np.zeros((runs, variable.size), dtype=bool)
        for run, (end, mask) in enumerate(parts):
            if k < end:
                own[run] = np.arange(variable.size) != best[k]
            elif k == end:
                own[run] = ~mask
        weights[variable] = np.where(own, -np.inf, weights.get(variable, 0.0))
    return BoundStates((runs,), evidence.states, weights)
