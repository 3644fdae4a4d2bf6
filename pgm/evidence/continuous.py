"""Evidence of a continuous network without time, checked against its CPDs."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pgm.cpds import CPD
from pgm.errors import EvidenceError
from pgm.evidence.arrays import as_rows, no_evidence_for, require_finite, taken_readings
from pgm.evidence.values import Constant, Evidence, Sightings
from pgm.factors.runs import common_runs, flat
from pgm.kernels.arrays import Array, Mask
from pgm.variables import Variable

NOT_OBSERVED = "leave a variable that was not observed out of the evidence, in all runs alike"


@dataclass(frozen=True, eq=False)
class BoundValues:
    """Values of the variables with evidence.

    Attributes
    ----------
    lead : tuple of int
        The leading axes, of runs; inside, they are flattened to one.
    values : mapping of Variable to ndarray
        (runs or 1, d); zero where missing.
    taken : mapping of Variable to ndarray of bool
        Of the variables some of whose components are missing, which are not, (runs or 1, d).
    """

    lead: tuple[int, ...]
    values: Mapping[Variable, Array]
    taken: Mapping[Variable, Mask]

    @property
    def runs(self) -> int:
        """Number of runs."""
        return math.prod(self.lead)


def bind_values(
    cpds: Sequence[CPD],
    evidence: Evidence,
    lead: tuple[int, ...] = (),
    needed: Iterable[Variable] = (),
) -> BoundValues:
    """Check the evidence of a continuous network without time.

    Parameters
    ----------
    cpds : sequence of CPD
    evidence : mapping of Variable to array_like
        (..., d); leading axes are runs. NaN is a component that was not observed, of a variable
        on which no other depends: it integrates out.
    lead : tuple of int
        Leading axes that the runs have at least.
    needed : iterable of Variable
        Variables that must have evidence: inputs, and what the noise of a CPD depends on.

    Raises
    ------
    EvidenceError
        If evidence is missing, unknown, of a wrong shape, not finite where it has to be, or the
        axes of runs do not broadcast.
    """
    known = {v for cpd in cpds for v in cpd.scope}
    children = {cpd.child for cpd in cpds}
    dependent = {parent: cpd.child for cpd in cpds for parent in cpd.parents}
    arrays: dict[Variable, Array] = {}
    masks: dict[Variable, Mask] = {}
    for variable, value in evidence.items():
        if variable not in known:
            raise no_evidence_for(variable, known)
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
        else:
            advice = NOT_OBSERVED
            if variable in dependent:
                advice = f"{dependent[variable]!r} depends on it; {NOT_OBSERVED}"
            require_finite(variable, row[..., None, :], advice=advice)
        arrays[variable] = row
    for variable in needed:
        if variable not in arrays:
            _refuse_missing(variable, cpds)
    shape = common_runs([*((v, a.shape[:-1]) for v, a in arrays.items()), ("the model", lead)])
    return BoundValues(
        shape,
        {v: flat(a, shape, 1) for v, a in arrays.items()},
        {v: flat(a, shape, 1) for v, a in masks.items()},
    )


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
