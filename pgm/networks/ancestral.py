"""Ancestral sampling: drawing children given their parents, one after another."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from pgm.boundary import is_whole
from pgm.cpds.values import Values
from pgm.errors import EvidenceError, ModelError
from pgm.evidence import Evidence, bind_values
from pgm.evidence.arrays import unknown
from pgm.factors.scope import listed
from pgm.sizes import require_memory
from pgm.variables import Variable

if TYPE_CHECKING:
    from pgm.networks.static import BayesianNetwork


def draw(
    network: BayesianNetwork,
    n: int | tuple[int, ...] | None,
    inputs: Evidence,
    rng: np.random.Generator,
) -> dict[Variable, Values]:
    """Draw each variable of a network without time after its parents."""
    shape = _as_shape(n)
    require_memory(
        math.prod(shape) * sum(cpd.child.dimension or 1 for cpd in network.cpds),
        f"{n} draws of {len(network.cpds)} variables",
        "draw fewer at a time",
    )
    for variable in inputs:
        if variable not in network.variables:
            raise unknown(variable, network.variables)
        if variable not in network.inputs:
            raise EvidenceError(
                f"{variable!r} is no input of the network, whose inputs are "
                f"({listed(network.inputs)}); given evidence of other variables one infers, not "
                "samples",
                variable=variable,
            )
    try:
        shape = np.broadcast_shapes(shape, network.lead)
    except ValueError:
        raise ModelError(
            f"draws of shape {shape} do not broadcast with the model's axes of runs "
            f"{network.lead}; n=(1000, 1) draws a thousand for each"
        ) from None
    bound = bind_values(network.cpds, inputs, shape, network.inputs)
    lead, runs = bound.lead, bound.runs
    values: dict[Variable, Values] = dict(bound.values)
    drawn: dict[Variable, Values] = {}
    for cpd in network.cpds:
        parents = {v: values[v] for v in cpd.parents}
        child = cpd._draw(parents, lead, (runs,), cpd.child.step, rng)
        values[cpd.child] = child
        drawn[cpd.child] = child.reshape((*lead, *child.shape[1:]))
    return drawn


def _as_shape(n: Any) -> tuple[int, ...]:
    if n is None:
        return ()
    shape = n if isinstance(n, tuple) else (n,)
    for length in shape:
        if not is_whole(length) or length < 1:
            raise ModelError(f"n is the number of draws, 1 or more, or a tuple of such; not {n!r}")
    return tuple(map(int, shape))
