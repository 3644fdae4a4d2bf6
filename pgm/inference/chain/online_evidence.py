"""Evidence of one step online, checked and laid out."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from pgm.errors import EvidenceError
from pgm.evidence import BoundEvidence, Constant, Sightings, bind, constant, sightings
from pgm.evidence.arrays import as_rows
from pgm.inference.chain.online_belief import OnlineBelief
from pgm.inference.chain.online_window import Sliding
from pgm.networks import DynamicBayesianNetwork
from pgm.variables import Variable


def mapping(value: Any, method: str, what: str) -> Mapping[Variable, Any]:
    """Refuse what is no mapping."""
    if not isinstance(value, Mapping):
        raise EvidenceError(f"{method} takes a mapping of {what}, not {type(value).__name__}")
    return value


def inputs(
    model: DynamicBayesianNetwork, belief: OnlineBelief, values: Mapping[Variable, Any]
) -> BoundEvidence:
    """The inputs of a prediction."""
    needed = {v for cpd in model.transition for v in cpd.parents}
    for variable in values:
        if variable not in needed or variable not in model.inputs:
            raise EvidenceError(
                f"predict takes inputs of the transition, not {variable!r}; readings go to update",
                variable=variable,
                step=belief.step + 1,
            )
    evidence = {v: _constant(value) for v, value in values.items()}
    return _same_runs(belief, bind(model.transition, (), evidence, 1, belief.lead))


def readings(
    model: DynamicBayesianNetwork, belief: OnlineBelief, values: Mapping[Variable, Any]
) -> BoundEvidence:
    """The readings of an update."""
    evidence = {v: _reading(model, v, value) for v, value in values.items()}
    parts = model.transition, model.observation, evidence, 0, belief.lead
    return _same_runs(belief, bind(*parts, transition_inputs=False))


def _same_runs(belief: OnlineBelief, bound: BoundEvidence) -> BoundEvidence:
    """Refuse runs other than those of a window before, but for many after one."""
    lead = belief.lead
    if isinstance(belief.behind, Sliding) and lead and lead != bound.lead:
        raise EvidenceError(
            f"evidence of runs {bound.lead} after such of runs {lead}: the steps of a window, with "
            f"{belief.behind.schedule!r}, are of the same runs; give the first evidence, or the "
            f"prior's mean, all axes {bound.lead}",
            step=belief.step,
        )
    return bound


def _constant(value: Any) -> Constant:
    return value if isinstance(value, Constant) else constant(value)


def _reading(model: DynamicBayesianNetwork, variable: Variable, value: Any) -> Any:
    if variable not in model.sensors:
        return _constant(value)
    if not isinstance(value, Sightings):
        value = sightings(as_rows(variable, value, None)[..., None, :])
    if value.step is not None:
        raise EvidenceError(
            f"sightings of {variable!r} online belong to the belief's step; leave step= out",
            variable=variable,
        )
    if value.values is None:
        return Sightings(None, np.zeros(0, dtype=np.intp), value.given)
    rows = as_rows(variable, value.values, "M")
    return Sightings(rows, np.zeros(rows.shape[-2], dtype=np.intp), value.given)
