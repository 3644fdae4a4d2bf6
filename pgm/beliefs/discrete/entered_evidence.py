"""Evidence multiplied into the tables of a graph, in place.

An observed state makes the entries of all other states zero; soft evidence w multiplies the entries
of each state x by w(x). Evidence gives an observed state once for all runs, or as an array with a
state for each run, where −1 stands for "not observed in this run". Soft evidence gives ln w, of any
size, which is divided by the largest w where tables may have numbers as entries. The *home* of a
variable is the smallest cluster that holds it. The tables of all clusters stand in one flat array,
in which `storage` tells the place of each; their entries are those of a semiring: numbers or
logarithms. In shapes, [runs] is an axis that a single run lacks.
"""

from __future__ import annotations

import numpy as np

from pgm.beliefs.discrete.place import by_state
from pgm.beliefs.discrete.storage import Storage
from pgm.evidence.static import BoundStates, scaled
from pgm.factors.axes import States, sizes
from pgm.kernels.arrays import Array, Integers
from pgm.kernels.semirings import LOG_SUM_PRODUCT, Semiring


def multiply(storage: Storage, tables: Array, evidence: BoundStates, semiring: Semiring) -> None:
    """Multiply the evidence of each variable into its home's table, in place.

    `tables` is a flat array, (entries of tables + others, [runs]), in the entries of the semiring:
    first all clusters' tables, laid out by `storage`. The others behind them, such as room for the
    tables of sepsets, are left unchanged. Soft evidence is divided by its largest weight; a ratio
    that is no number of float64 is a `FloatingPointError`.
    """
    for variable, state in evidence.states.items():
        table = storage.by_state[variable].of(tables)
        if isinstance(state, int):
            table[:state] = semiring.zero
            table[state + 1 :] = semiring.zero
        else:
            _weigh(table, semiring.entries(one_hot(state, variable.size)), semiring)
    runs = tables.ndim > 1
    for variable, soft in evidence.weights.items():
        table = storage.by_state[variable].of(tables)
        below, _ = scaled(soft)
        _weigh(table, semiring.of_logs(below.T if runs else below[0]), semiring)


def _weigh(table: Array, weights: Array, semiring: Semiring) -> None:
    """Multiply weights (states, [runs]) of a variable into a table, in place.

    The table, (states, sizes of other variables..., [runs]), and the weights have entries of the
    semiring.
    """
    shape = (len(weights), *(1,) * (table.ndim - weights.ndim), *weights.shape[1:])
    semiring.times(table, weights.reshape(shape), table)


def enter_everywhere(storage: Storage, evidence: BoundStates) -> Array:
    """Flat array of logarithms, (entries, runs): all clusters' potentials times the evidence.

    An observed state enters every cluster that holds its variable, so that no message has to bring
    it; soft evidence, which must count once, enters its variable's home alone.
    """
    tables = np.repeat(storage.logs[:, None], evidence.runs, axis=1)
    for variable, state in evidence.states.items():
        shown = LOG_SUM_PRODUCT.entries(one_hot(np.reshape(state, -1), variable.size))
        for cluster in storage.holders[variable]:
            _weigh(by_state(storage.places[cluster], variable).of(tables), shown, LOG_SUM_PRODUCT)
    for variable, soft in evidence.weights.items():
        _weigh(storage.by_state[variable].of(tables), soft.T, LOG_SUM_PRODUCT)
    return tables


def entered(storage: Storage, evidence: BoundStates, cluster: int) -> Array:
    """Logarithms of one cluster's potential times the evidence that enters it, (sizes..., runs).

    The array is the cluster's table in the result of `enter_everywhere`, with an axis for each
    variable of its scope.
    """
    logs: Array = storage.table(storage.logs, cluster)[..., None]
    return logs + entering(storage, evidence, cluster)


def entering(storage: Storage, evidence: BoundStates, cluster: int) -> Array:
    """Logarithms of the evidence that enters one cluster, (sizes..., runs), as `entered` has it."""
    scope = storage.scopes[cluster]
    table = np.zeros((*sizes(scope), evidence.runs))
    for axis, variable in enumerate(scope):
        own = np.moveaxis(table, axis, 0)
        if variable in evidence.states:
            shown = one_hot(np.reshape(evidence.states[variable], -1), variable.size)
            _weigh(own, LOG_SUM_PRODUCT.entries(shown), LOG_SUM_PRODUCT)
        if variable in evidence.weights and storage.homes[variable] == cluster:
            _weigh(own, evidence.weights[variable].T, LOG_SUM_PRODUCT)
    return table


def one_hot(states: Integers, size: int) -> Array:
    """One-hot columns, (size, runs), of observed states (runs,); all ones where a state is −1.

    −1 stands for "not observed in this run".
    """
    found: Array = ((states == np.arange(size)[:, None]) | (states < 0)).astype(float)
    return found


def put_in(evidence: BoundStates, scope: States) -> tuple[int | slice, ...]:
    """The index that fixes those variables of a table that have one observed state for all runs.

    `scope` are the table's variables, and the index has one element for each of them. The element
    is the observed state if this is given once for all runs, so that the table loses the axis. Else
    the element is a full slice, which keeps the axis: for a hidden variable, and for one that is
    observed by an array of states.
    """
    states = evidence.states
    return tuple(s if isinstance(s := states.get(v), int) else slice(None) for v in scope)


def axes_left(evidence: BoundStates, scope: States) -> States:
    """The variables of `scope`, in its order, except those observed in one state for all runs.

    The tables of messages, beliefs and potentials that the user gets have an axis for each of the
    variables returned, and none for the others.
    """
    return tuple(v for v in scope if not isinstance(evidence.states.get(v), int))
