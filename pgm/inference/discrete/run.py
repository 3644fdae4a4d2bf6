"""Running a schedule on a cluster graph of a discrete network."""

from __future__ import annotations

from pgm.clustergraph import ClusterGraph
from pgm.evidence import Evidence
from pgm.inference.posterior import Posterior
from pgm.inference.schedule import Schedule


def run(graph: ClusterGraph, evidence: Evidence, schedule: Schedule | None) -> Posterior:
    """Send the messages of a schedule."""
    raise NotImplementedError
