"""Evidence entered into a graph's tables.

Soft weights multiply an axis; an observed axis keeps one state.
"""

from __future__ import annotations

import numpy as np

from pgm.evidence.static import BoundStates
from pgm.factors.axes import States
from pgm.inference.discrete.place import by_state
from pgm.inference.discrete.storage import Storage
from pgm.kernels.arrays import Array, Integers
from pgm.kernels.semirings import LOG_SUM_PRODUCT, Semiring


def multiply(storage: Storage, tables: Array, evidence: BoundStates, semiring: Semiring) -> None:
    """Multiply evidence into tables, (entries, [runs])."""
    for variable, state in evidence.states.items():
        table = storage.by_state[variable].of(tables)
        if isinstance(state, int):
            table[:state] = semiring.zero
            table[state + 1 :] = semiring.zero
        else:
            _weigh(table, one_hot(state, variable.size), semiring)
    runs = tables.ndim > 1
    for variable, soft in evidence.weights.items():
        table = storage.by_state[variable].of(tables)
        _weigh(table, soft.T if runs else soft[0], semiring)


def _weigh(table: Array, weights: Array, semiring: Semiring) -> None:
    """Multiply weights (states, [runs]) into a table (states, others..., [runs])."""
    shape = (len(weights), *(1,) * (table.ndim - weights.ndim), *weights.shape[1:])
    semiring.times(table, semiring.entries(weights.reshape(shape)), table)


def enter_everywhere(storage: Storage, evidence: BoundStates) -> Array:
    """Logarithms of the potentials times the evidence, (entries, runs).

    States enter every cluster that has the variable, so that no message has to bring them; weights
    enter one.
    """
    tables = np.repeat(storage.logs[:, None], evidence.runs, axis=1)
    for variable, state in evidence.states.items():
        shown = one_hot(np.reshape(state, -1), variable.size)
        for cluster in storage.holders[variable]:
            _weigh(by_state(storage.places[cluster], variable).of(tables), shown, LOG_SUM_PRODUCT)
    for variable, soft in evidence.weights.items():
        _weigh(storage.by_state[variable].of(tables), soft.T, LOG_SUM_PRODUCT)
    return tables


def entered(storage: Storage, evidence: BoundStates, cluster: int) -> Array:
    """Logarithms of one cluster's potential times its evidence, (sizes..., runs)."""
    scope = storage.scopes[cluster]
    table = np.repeat(storage.table(storage.logs, cluster)[..., None], evidence.runs, axis=-1)
    for variable, state in evidence.states.items():
        if variable in scope:
            shown = one_hot(np.reshape(state, -1), variable.size)
            _weigh(np.moveaxis(table, scope.index(variable), 0), shown, LOG_SUM_PRODUCT)
    for variable, soft in evidence.weights.items():
        if storage.homes[variable] == cluster:
            _weigh(np.moveaxis(table, scope.index(variable), 0), soft.T, LOG_SUM_PRODUCT)
    return table


def one_hot(states: Integers, size: int) -> Array:
    """One-hot columns (size, runs) of observed states; all ones where nothing is observed."""
    found: Array = ((states == np.arange(size)[:, None]) | (states < 0)).astype(float)
    return found


def put_in(evidence: BoundStates, scope: States) -> tuple[int | slice, ...]:
    """The index that fixes axes whose observed state is equal in all runs."""
    states = evidence.states
    return tuple(s if isinstance(s := states.get(v), int) else slice(None) for v in scope)


def axes_left(evidence: BoundStates, scope: States) -> States:
    """The variables that stay axes of messages and beliefs after `put_in`."""
    return tuple(v for v in scope if not isinstance(evidence.states.get(v), int))
