"""Draws of all hidden variables of a Gaussian tree, each cluster's after its parent's.

The joint of a cluster has the lower root L, of the variables that are drawn already before those
that are not. The former are whitened by the first rows of L, and the latter follow from that and
from white noise by the other rows: singular covariances need no care.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pgm.clustergraph.structure import Forest
from pgm.errors import GraphError
from pgm.factors.scope import Scope, dimension
from pgm.kernels import normal_density, roots
from pgm.kernels.arrays import Array, transpose
from pgm.resources import require_memory
from pgm.variables import Variable

if TYPE_CHECKING:
    from pgm.beliefs.gaussian.outcome import GaussianOutcome


def draws(outcome: GaussianOutcome, count: int, rng: np.random.Generator) -> dict[Variable, Array]:
    """So many draws of each hidden variable, (count, runs, d), for each run of the evidence."""
    graph, runs = outcome.graph, outcome._model.runs
    if not graph.is_tree:
        raise GraphError(
            "draws of all variables together are of graphs without loops, whose clusters are drawn "
            "one after another; compile a junction tree, pgm.compile(network)"
        )
    hidden = outcome._hidden
    require_memory(
        2 * count * runs * dimension(hidden),
        f"{count:,} draws of {len(hidden):,} variables in {runs:,} runs",
        "draw fewer at a time",
    )
    found: dict[Variable, Array] = {}
    known = frozenset(hidden)
    forest, clusters = Forest.of(graph), graph.clusters
    for level in forest.levels:
        for k in level.tolist():
            scope = tuple(v for v in clusters[k].scope if v in known)
            own = tuple(v for v in scope if v not in found)
            if own:
                given = tuple(v for v in scope if v in found)
                found |= _given(outcome, given, own, found, count, rng)
    return found


def _given(
    outcome: GaussianOutcome,
    given: Scope,
    own: Scope,
    drawn: dict[Variable, Array],
    count: int,
    rng: np.random.Generator,
) -> dict[Variable, Array]:
    """Draws of some variables of a cluster given those of others, which are `drawn`."""
    joint = outcome.joint(*given, *own)
    size = joint.mean.shape[-1]
    mean, cov = joint.mean.reshape(-1, 1, size), joint.cov.reshape(-1, size, size)
    lower, before = roots.root(cov), dimension(given)
    white = rng.standard_normal((len(mean), count, size - before))
    values = mean[..., before:] + white @ transpose(lower[:, before:, before:])
    if given:
        seen = np.concatenate([drawn[v] for v in given], axis=-1).swapaxes(0, 1)
        residual = seen - mean[..., :before]
        whitened, _ = normal_density.whitened(lower[:, :before, :before], residual)
        values = values + whitened @ transpose(lower[:, before:, :before])
    ends = np.cumsum([v.dimension for v in own])[:-1]
    parts = np.split(values.swapaxes(0, 1), ends, axis=-1)
    return dict(zip(own, parts, strict=True))
