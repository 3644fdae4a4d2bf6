"""Evidence of networks without time, continuous or discrete, checked and laid out by run."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence, Set
from dataclasses import dataclass
from typing import Any

import numpy as np

from pgm.cpds import CPD
from pgm.errors import EvidenceError
from pgm.evidence.rows import (
    as_log_weights,
    as_rows,
    no_evidence_for,
    taken_readings,
)
from pgm.evidence.values import Constant, Evidence, Sightings, Soft
from pgm.factors.arrays import common_runs, flat
from pgm.factors.axes import as_indices
from pgm.factors.scope import listed
from pgm.kernels.arrays import Array, Integers, Mask, frozen, is_finite
from pgm.variables import Discrete, Variable

NOT_OBSERVED = "leave a variable that was not observed out of the evidence, in all runs alike"


class Incomplete(EvidenceError):
    """Evidence with gaps where the same variables are to be observed in all runs of a call."""


@dataclass(frozen=True, eq=False)
class BoundValues:
    """Values of the variables with evidence.

    lead: The leading axes, of runs; inside, they are flattened to one.
    values: (runs or 1, d); zero where missing.
    taken: Of the variables some of whose components are missing, which are not, (runs or 1, d).
    """

    lead: tuple[int, ...]
    values: Mapping[Variable, Array]
    taken: Mapping[Variable, Mask]

    @property
    def runs(self) -> int:
        """Number of runs."""
        return math.prod(self.lead)


@dataclass(frozen=True, eq=False)
class Roles:
    """The roles that variables have in the CPDs of a network, found once for many calls.

    known: All variables.
    children: Those that a CPD explains.
    dependent: Of each parent the child of a CPD; of a factor's residual the CPD, named as it.
    """

    known: frozenset[Variable]
    children: frozenset[Variable]
    dependent: Mapping[Variable, Variable | CPD]

    @classmethod
    def of(cls, cpds: Iterable[CPD]) -> Roles:
        """The roles in some CPDs."""
        children: set[Variable] = set()
        dependent: dict[Variable, Variable | CPD] = {}
        for cpd in cpds:
            children.add(cpd.child)
            dependent.update(dict.fromkeys(cpd.parents, cpd.child if cpd._of is None else cpd))
        return cls(frozenset(children.union(dependent)), frozenset(children), dependent)


def bind_values(
    cpds: Sequence[CPD],
    evidence: Evidence,
    lead: tuple[int, ...] = (),
    needed: Iterable[Variable] = (),
    roles: Roles | None = None,
) -> BoundValues:
    """Check the evidence of a continuous network without time.

    evidence: (..., d); leading axes are runs. NaN is a component that was not observed, of a
        variable on which no other depends: it integrates out. Of others it is `Incomplete`.
    lead: Leading axes that the runs have at least.
    needed: Variables that must have evidence: inputs, and what the noise of a CPD depends on.
    roles: The roles of variables in the CPDs, where they are known already.
    """
    roles = roles or Roles.of(cpds)
    known, children, dependent = roles.known, roles.children, roles.dependent
    arrays: dict[Variable, Array] = {}
    masks: dict[Variable, Mask] = {}
    complete = complete_rows(evidence)
    incomplete: Variable | None = None
    for variable, value in evidence.items():
        if variable not in known:
            raise no_evidence_for(variable, known)
        if variable in complete:
            continue
        if isinstance(value, Sightings):
            raise EvidenceError(
                f"sightings of {variable!r} are for dynamic networks; give the value of "
                f"{variable!r} itself, (..., {variable.dimension})",
                variable=variable,
            )
        row = as_rows(variable, value.value if isinstance(value, Constant) else value, None)
        if variable in children and variable not in dependent:
            taken = taken_readings(variable, row[..., None, :])
            if taken is not None:
                masks[variable] = taken[..., 0, :]
                row = np.where(masks[variable], row, 0.0)
        elif taken_readings(variable, row[..., None, :]) is not None:
            incomplete = variable if incomplete is None else incomplete
        arrays[variable] = row
    for variable in needed:
        if variable not in arrays and variable not in complete:
            _refuse_missing(variable, cpds)
    shape = common_runs([*((v, a.shape[:-1]) for v, a in arrays.items()), ("the model", lead)])
    if incomplete is not None:
        why = f"{dependent[incomplete]!r} depends on it; " if incomplete in dependent else ""
        raise Incomplete(
            f"evidence for {incomplete!r} has entries that are NaN or masked; {why}{NOT_OBSERVED}",
            variable=incomplete,
        )
    return BoundValues(
        shape,
        complete | {v: flat(a, shape, 1) for v, a in arrays.items()},
        {v: flat(a, shape, 1) for v, a in masks.items()},
    )


def complete_rows(values: Mapping[Variable, Any]) -> dict[Variable, Array]:
    """The values of one row of floats each, (1, d), of variables of which all values are finite.

    Thousands of them are checked together: numbers, and arrays of one size, as one array.
    """
    numbers: list[Variable] = []
    alike: dict[int, list[Variable]] = {}
    for variable, value in values.items():
        if type(value) is float:
            numbers.append(variable)
        elif type(value) is np.ndarray and value.ndim == 1 and value.dtype == np.float64:
            alike.setdefault(len(value), []).append(variable)
    found: dict[Variable, Array] = {}
    for size, variables in ((1, numbers), *alike.items()):
        if any(getattr(variable, "dimension", None) != size for variable in variables):
            continue
        rows = np.array([values[variable] for variable in variables]).reshape(-1, size)
        if is_finite(rows):
            found.update(zip(variables, frozen(rows)[:, None], strict=True))
    return found


def _refuse_missing(variable: Variable, cpds: Iterable[CPD]) -> None:
    cpd = next(cpd for cpd in cpds if variable in cpd.parents)
    why = (
        "on which its noise depends; a noise can depend on known values alone"
        if variable in cpd.noise_given
        else "a parent that no CPD explains; give its value, or a CPD of its own"
    )
    raise EvidenceError(
        f"no evidence for {variable!r} in {cpd!r}, {why}", variable=variable, cpd=cpd
    )


@dataclass(frozen=True, eq=False)
class BoundStates:
    """Evidence of a discrete network.

    lead: The leading axes, of runs; inside, they are flattened to one.
    states: Hard evidence: one index for all runs, or an index for each, (runs or 1,), where −1 is
        "not observed in this run". A variable that is observed in no run is left out.
    weights: Soft evidence, the logarithms of weights, (runs or 1, size), each row with one above
        −∞. They may be of any size: the tables take them in by `scaled`.
    """

    lead: tuple[int, ...]
    states: Mapping[Discrete, int | Integers]
    weights: Mapping[Discrete, Array]

    @property
    def runs(self) -> int:
        """Number of runs."""
        return math.prod(self.lead)


def bind_discrete(variables: Iterable[Variable], evidence: Mapping[Any, Any]) -> BoundStates:
    """Check evidence against the variables of a discrete network and lay it out by run.

    evidence: The name or index of a state, an array of names or indices (...), with −1 for "not
        observed in this run", or `soft` weights (..., size). Leading axes are runs.
    """
    known = variables if isinstance(variables, Set) else frozenset(variables)
    states: dict[Discrete, int | Integers] = {}
    stacked: dict[Discrete, Integers] = {}
    weighted: dict[Discrete, Array] = {}
    for variable, value in evidence.items():
        if variable not in known:
            raise no_evidence_for(variable, known)
        # A single name or index is what most queries are made of: no array is made for it.
        kind = type(value)
        if kind is str and value in variable.states:
            states[variable] = variable.states.index(value)
        elif kind is int and -1 <= value < len(variable.states):
            if value >= 0:
                states[variable] = value
        elif isinstance(value, Soft):
            weighted[variable] = as_log_weights(variable, value)
        elif isinstance(value, Sightings | Constant):
            raise _of_dynamic(variable, value)
        else:
            stacked[variable] = as_indices(variable, value)
    if not stacked and not weighted:
        return BoundStates((), states, weighted)
    shapes = {v: array.shape for v, array in stacked.items()}
    shapes |= {v: array.shape[:-1] for v, array in weighted.items()}
    lead = common_runs(shapes.items())
    for variable, array in stacked.items():
        if array.max() >= 0:
            states[variable] = array.item() if array.ndim == 0 else flat(array, lead, 0)
    return BoundStates(lead, states, {v: flat(array, lead, 1) for v, array in weighted.items()})


def scaled(weights: Array) -> tuple[Array, Array]:
    """Log-weights (..., size) less the largest of each row, and these largest ones, (...).

    So weights of any size become numbers of at most one, and digits are not lost beside a large
    common factor. A row of which all are −∞, of a part of the assignments that has none, stays.
    """
    top: Array = weights.max(axis=-1)
    top = np.where(top == -np.inf, 0.0, top)
    with np.errstate(over="ignore"):  # a weight next to nothing beside the largest
        return weights - top[..., None], top


def _of_dynamic(variable: Discrete, value: Sightings | Constant) -> EvidenceError:
    what = "sightings" if isinstance(value, Sightings) else "a constant"
    return EvidenceError(
        f"{what} of {variable!r}, a discrete variable: they are for dynamic networks; give the "
        f"state itself, {{{variable!r}: {variable.states[0]!r}}}, or soft weights; its states are "
        f"({listed(variable.states)})",
        variable=variable,
    )
