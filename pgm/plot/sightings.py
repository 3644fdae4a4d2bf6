"""The number of readings of each sensor of a chain at each step."""

from __future__ import annotations

import numpy as np

from pgm.clustergraph import ClusterGraph
from pgm.compile import DynamicGraph
from pgm.errors import EvidenceError
from pgm.evidence import Evidence, bind
from pgm.variables import Variable


def reading_counts(graph: ClusterGraph, evidence: Evidence) -> dict[Variable, int]:
    """Readings of each sensor of a dynamic network at each step, zeros included for all sensors.

    A reading counts if one run or more took it.

    Parameters
    ----------
    graph : ClusterGraph
        One that no dynamic network lies behind has none.
    evidence : mapping of Variable
        As for `pgm.infer`.

    Raises
    ------
    EvidenceError
        As by `pgm.infer`.
    """
    if not isinstance(graph, DynamicGraph):
        return {}
    if not hasattr(evidence, "items"):
        raise EvidenceError(f"evidence maps variables to values; found {type(evidence).__name__}")
    model, span = graph.model, range(graph.steps + 1)
    bound = bind(model.transition, model.observation, evidence, graph.steps, model.lead)
    counts = {sensor.at(step): 0 for sensor in model.sensors for step in span}
    for reading in bound.readings:
        steps = reading.step[reading.taken.any(axis=(1, 2))]
        for step, count in zip(*np.unique(steps, return_counts=True), strict=True):
            counts[reading.cpd.child.at(int(step))] = int(count)
    return counts
