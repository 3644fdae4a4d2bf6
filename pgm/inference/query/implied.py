"""Evidence on intermediate variables of independent causes, where it follows from other evidence.

Where a noisy-or is observed to be off, so is all that its causes amount to: each cause is then
apart from the others, and no table joins them, as in the quickscore algorithm (Heckerman, 1989).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from pgm.cpds import TableCPD
from pgm.cpds.causal_independence import Intermediate
from pgm.evidence.static import BoundStates
from pgm.kernels.arrays import Mask
from pgm.networks import MarkovNetwork
from pgm.variables import Discrete


def has_intermediate(network: MarkovNetwork) -> bool:
    """Whether a network has intermediate variables of independent causes."""
    return any(isinstance(v, Intermediate) for v in network.variables)


def with_implied(network: MarkovNetwork, evidence: BoundStates) -> BoundStates:
    """The evidence, with the states of intermediate variables that are the only possible ones.

    They follow from evidence that is given once for all runs, against the steps of each CPD.
    `network` has CPDs of independent causes in their factors.
    """
    if not has_intermediate(network):
        return evidence
    possible: dict[Discrete, Mask] = {}
    # The child before the intermediate variables, the last of them first.
    for factor in reversed(network.factors):
        if not isinstance(factor, TableCPD) or not factor.given:
            continue
        before, child = factor.given[0], factor.child
        if not isinstance(before, Intermediate):
            continue
        after = possible[child] if child in possible else _allowed(child, evidence)
        if after is None:
            continue
        cause = evidence.states.get(factor.given[1])
        rows = slice(cause, cause + 1) if isinstance(cause, int) else slice(None)
        found: Mask = np.logical_or.reduce(factor.table[:, rows, after] > 0.0, axis=(1, 2))
        if found.any():  # else the evidence is impossible, as summing tells
            possible[before] = found
    states: Mapping[Discrete, int] = {
        v: int(mask.argmax()) for v, mask in possible.items() if np.count_nonzero(mask) == 1
    }
    return replace(evidence, states={**evidence.states, **states}) if states else evidence


def _allowed(variable: Discrete, evidence: BoundStates) -> Mask | None:
    """The states that evidence allows a variable, (size,); None without, or by run."""
    state, weights = evidence.states.get(variable), evidence.weights.get(variable)
    if isinstance(state, int):
        return np.asarray(np.arange(variable.size) == state)
    if weights is None or len(weights) > 1:
        return None
    return np.asarray(weights[0] > -np.inf)
