"""How far evidence has moved beliefs: from the prior, or at each step of a chain."""

from __future__ import annotations

import warnings
from collections.abc import Iterable
from typing import Any

import numpy as np

from pgm.compile import DynamicGraph
from pgm.errors import PgmError
from pgm.factors import Gaussian, Table
from pgm.inference import Flooding, infer
from pgm.kernels.arrays import Array
from pgm.variables import Variable


def moved(posterior: Any, variables: Iterable[Variable]) -> dict[Variable, Array]:
    """KL(posterior ‖ prior) of the marginals of variables without evidence, in nats, (*runs) each.

    The prior is what the same graph gives without any evidence, round loops by `Flooding`. Empty
    where nothing was observed, where messages round loops do not settle without evidence, and where
    the network has no prior, as one with inputs or a Markov network of flat factors.
    """
    graph = posterior.graph
    own = set(graph.network.variables)  # those that factors have beside them have no beliefs
    if isinstance(graph, DynamicGraph) or not posterior.entered(0):
        return {}
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of the prior, for which nobody asked
            prior = infer(graph, {}, schedule=None if graph.is_tree else Flooding())
    except PgmError:
        return {}
    if not (graph.is_tree or prior.status.converged.all()):
        return {}
    return {v: _divergence(posterior[v], prior[v]) for v in variables if v in own}


def moved_by_step(posterior: Any) -> dict[Variable, Array]:
    """KL(filtered ‖ predicted) of the variables of a chain, in nats, (*runs, steps) each.

    It is how far the readings of a step moved the belief that earlier steps predict. NaN where it
    does not exist, as of a state that is known exactly; left out are beliefs that are no Gaussians
    or tables.
    """
    found = {}
    for v in posterior.graph.layout.slice:
        try:
            belief, before = posterior.filtered[v], posterior.predicted[v]
        except PgmError:  # of what `keep=` left out, or a family that predicts nothing
            continue
        if isinstance(belief, Gaussian) and isinstance(before, Gaussian):
            found[v] = _in_parts(belief, before)
        elif isinstance(belief, Table) and isinstance(before, Table):
            found[v] = _divergence(belief, before)
    return found


def _in_parts(belief: Gaussian, before: Gaussian) -> Array:
    """KL of stacked Gaussians (..., steps), NaN at the steps where it does not exist."""
    found = _divergence(belief, before)
    count = belief.mean.shape[-2]
    if found.shape == belief.mean.shape[:-1] or count == 1:
        return np.broadcast_to(found, belief.mean.shape[:-1])
    parts = slice(None, count // 2), slice(count // 2, None)
    return np.concatenate([_in_parts(belief[..., k], before[..., k]) for k in parts], axis=-1)


def _divergence(belief: Any, before: Any) -> Array:
    """KL(belief ‖ before), NaN where it does not exist, as of what is certain."""
    if isinstance(belief, Table | Gaussian) and type(belief) is type(before):
        try:
            return np.maximum(belief.kl(before), 0.0)  # type: ignore[arg-type]
        except PgmError:
            pass
    return np.asarray(np.nan)
