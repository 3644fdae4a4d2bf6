"""How far the evidence of a network without time has moved its beliefs."""

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


def _divergence(belief: Any, before: Any) -> Array:
    """KL(belief ‖ before), NaN where it does not exist, as of what is certain."""
    if isinstance(belief, Table | Gaussian) and type(belief) is type(before):
        try:
            return belief.kl(before)  # type: ignore[arg-type]
        except PgmError:
            pass
    return np.asarray(np.nan)
