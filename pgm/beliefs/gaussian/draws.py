"""Draws of all hidden variables of a Gaussian tree, each cluster's after its parent's.

The joint of a cluster has the lower root L, of the variables that are drawn already before those
that are not. The former are whitened by the first rows of L, and the latter follow from that and
from white noise by the other rows. Where a component is nearly determined by others, its variance
given these is a small difference of large ones, which a covariance does not hold: there the
components are drawn one by one from the rows of the cluster's belief.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pgm.beliefs.gaussian.beliefs import runs_first
from pgm.clustergraph.structure import Forest
from pgm.errors import GraphError
from pgm.factors import Gaussian
from pgm.factors.scope import Scope, dimension
from pgm.kernels import normal_density, roots, rows
from pgm.kernels.arrays import Array, transpose
from pgm.resources import require_memory
from pgm.variables import Variable

if TYPE_CHECKING:
    from pgm.beliefs.gaussian.outcome import GaussianOutcome


# A variance given other components, as a part of the variance, from which on covariances hold it to
# seven digits.
HELD = 1e-9


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
                joint = outcome.joint(*given, *own)
                lower = roots.root(joint.cov)
                if roots.is_regular(joint.cov, HELD, lower):
                    found |= _given(joint, lower, given, own, found, count, rng)
                else:
                    found |= _by_rows(outcome, k, given, own, found, count, rng)
    return found


def _given(
    joint: Gaussian,
    lower: Array,
    given: Scope,
    own: Scope,
    drawn: dict[Variable, Array],
    count: int,
    rng: np.random.Generator,
) -> dict[Variable, Array]:
    """Draws of some variables of a cluster given those of others, which are `drawn`.

    `lower` are the roots of the covariances of their joint, those of others first.
    """
    size, before = joint.mean.shape[-1], dimension(given)
    mean, lower = joint.mean.reshape(-1, 1, size), lower.reshape(-1, size, size)
    white = rng.standard_normal((len(mean), count, size - before))
    values = mean[..., before:] + white @ transpose(lower[:, before:, before:])
    if given:
        residual = _joined(given, drawn) - mean[..., :before]
        whitened, _ = normal_density.whitened(lower[:, :before, :before], residual)
        values = values + whitened @ transpose(lower[:, before:, :before])
    return _parted(own, values)


def _by_rows(
    outcome: GaussianOutcome,
    cluster: int,
    given: Scope,
    own: Scope,
    drawn: dict[Variable, Array],
    count: int,
    rng: np.random.Generator,
) -> dict[Variable, Array]:
    """The same draws, one component after another, each given those drawn before it."""
    layout, frame = outcome._plan.layout, outcome._model.frame
    factor, _ = outcome._messages.belief(cluster)
    places = layout.components((*own, *given))
    index = {place: k for k, place in enumerate(layout.components(layout.scopes[cluster]).tolist())}
    columns = [index[place] for place in places.tolist()]
    exact = None if factor.exact is None else factor.exact[..., columns]
    factor = factor._replace(matrix=factor.matrix[..., columns], exact=exact)
    size = dimension(own)
    steps = []
    for _ in range(size):
        steps.append(rows.eliminate(factor, 1))
        factor = steps[-1].rest
    # In the coordinates of the frame, (runs, count, components).
    runs = outcome._model.runs
    mean, scale = np.broadcast_to(frame.mean, (runs, frame.mean.shape[-1])), frame.scale
    known = np.zeros((runs, count, 0))
    if given:
        offset = _joined(given, drawn) - mean[:, None, places[size:]]
        known = offset / scale[places[size:]]
    for step in reversed(steps):
        offset = runs_first(step.offset)[:, None]
        white = np.sqrt(step.noise) * rng.standard_normal((runs, count, 1))
        known = np.concatenate([known @ transpose(step.gain) + offset + white, known], axis=-1)
    values = mean[:, None, places[:size]] + scale[places[:size]] * known[..., :size]
    return _parted(own, values)


def _joined(given: Scope, drawn: dict[Variable, Array]) -> Array:
    """Draws by variable, (count, runs, d), as those of all of them together, (runs, count, n)."""
    return np.concatenate([drawn[v] for v in given], axis=-1).swapaxes(0, 1)


def _parted(own: Scope, values: Array) -> dict[Variable, Array]:
    """Draws (runs, count, n) of several variables, by variable, (count, runs, d)."""
    ends = np.cumsum([v.dimension for v in own])[:-1]
    parts = np.split(values.swapaxes(0, 1), ends, axis=-1)
    return dict(zip(own, parts, strict=True))
