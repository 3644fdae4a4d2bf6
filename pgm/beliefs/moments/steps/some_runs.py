"""A graph, and evidence bound to it, of some of the runs."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from pgm.compile import DynamicGraph
from pgm.cpds import ConditionalGaussian
from pgm.evidence import BoundEvidence, Reading
from pgm.factors.arrays import flat
from pgm.kernels.arrays import Array, cut


def graph_of(graph: DynamicGraph, bound: BoundEvidence, runs: slice) -> DynamicGraph:
    """The graph with the CPDs of a part of the runs; the same if no CPD differs by run."""
    model, lead = graph.model, bound.lead
    changed = {
        name: tuple(_cpd(cpd, lead, runs) for cpd in getattr(model, name))
        for name in ("prior", "transition")
    }
    if all(new == getattr(model, name) for name, new in changed.items()):
        return graph
    own = copy.copy(model)
    own._set(**changed)
    return type(graph)(own, graph.steps)


def _cpd(cpd: ConditionalGaussian, lead: tuple[int, ...], runs: slice) -> ConditionalGaussian:
    """A CPD with the offsets and covariances of a part of the runs.

    It is the same CPD if all runs have one offset and one covariance.
    """
    if cpd.steps is not None:
        return cpd  # whose arrays are by step, and of no run
    changed: dict[str, Any] = {}
    for name, own in (("offset", 1), ("cov", 2)):
        value = getattr(cpd, name, None)
        if isinstance(value, np.ndarray) and value.ndim > own:
            changed[name] = cut(flat(value, lead, own), runs, 0)
    if not changed:
        return cpd
    part = copy.copy(cpd)
    part._set(**changed, _origin=cpd.origin)
    return part


def evidence_of(bound: BoundEvidence, runs: slice) -> BoundEvidence:
    """The evidence of a part of the runs, with the number of the first of them as `first_run`."""

    def inputs(values: Mapping[Any, Array]) -> dict[Any, Array]:
        """The values of inputs in the part's runs, by variable."""
        return {variable: cut(array, runs) for variable, array in values.items()}

    def part(readings: tuple[Reading, ...]) -> tuple[Reading, ...]:
        return tuple(
            replace(
                reading,
                values=cut(reading.values, runs),
                taken=cut(reading.taken, runs),
                inputs=inputs(reading.inputs),
            )
            for reading in readings
        )

    return replace(
        bound,
        lead=(runs.stop - runs.start,),
        first_run=bound.first_run + runs.start,
        transition=tuple(map(inputs, bound.transition)),
        readings=part(bound.readings),
        unread=part(bound.unread),
    )
