"""Running a schedule on a cluster graph of a Gaussian network."""

from __future__ import annotations

from collections.abc import Mapping

import numpy.typing as npt

from pgm.clustergraph import ClusterGraph
from pgm.evidence import Evidence
from pgm.inference.posterior import Posterior
from pgm.inference.schedule import Schedule
from pgm.linearisers import Lineariser
from pgm.variables import Variable


def run(
    graph: ClusterGraph,
    evidence: Evidence,
    schedule: Schedule | None,
    lineariser: Lineariser,
    start: Mapping[Variable, npt.ArrayLike] | None,
) -> Posterior:
    """Send the messages of a schedule."""
    raise NotImplementedError
