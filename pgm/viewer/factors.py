"""Factors written into the numbers of a page one by one, run by run."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import numpy as np

from pgm.clustergraph import Cluster
from pgm.compile import DynamicGraph
from pgm.errors import GraphError, NumericalError
from pgm.factors import CanonicalForm, Gaussian, Table
from pgm.factors.scope import Scope
from pgm.inference import Posterior
from pgm.inference.gaussian.posterior import GaussianPosterior
from pgm.variables import Variable
from pgm.viewer.limits import Limits, Run
from pgm.viewer.numbers import Numbers, lower
from pgm.viewer.words import variable

# Of a table that is left out, so many of its largest entries are shown.
_LARGEST = 64
Factor = CanonicalForm | Table | Gaussian


class Writer:
    """The factors of a posterior in the numbers of a page, and the variables that they are over.

    Attributes
    ----------
    variables : list of dict
        Those met so far, as the page names them.
    scopes : dict of int to tuple of Variable
        The variables without evidence of each cluster whose belief was written.
    """

    def __init__(
        self, posterior: Posterior, numbers: Numbers, runs: list[Run], limits: Limits
    ) -> None:
        self.posterior, self.numbers, self.runs, self.limits = posterior, numbers, runs, limits
        self.variables: list[dict[str, Any]] = []
        self.scopes: dict[int, Scope] = {}
        self._places: dict[Variable, int] = {}

    def names(self, scope: Iterable[Variable]) -> list[int]:
        """The variables of a scope, by their place in the page's list."""
        found = []
        for each in scope:
            if each not in self._places:
                self._places[each] = len(self.variables)
                self.variables.append(variable(each))
            found.append(self._places[each])
        return found

    def factors(self, make: Callable[..., Factor], *of: int, scope: Scope) -> list[dict[str, Any]]:
        """A factor in each run, in the order of a scope, or why there is none."""
        try:
            factor = make(*of)
        except (NumericalError, GraphError) as error:
            return self._absent(str(error))
        if isinstance(factor, CanonicalForm):
            factor = factor.rearrange(scope)
        return [self._written(factor, run) for run in self.runs]

    def belief(self, cluster: Cluster) -> list[dict[str, Any]]:
        """The belief of a cluster in each run: a table or moments, which singular ones have too."""
        k, posterior = cluster.index, self.posterior
        belief, why = None, None
        try:
            belief = posterior.belief(k)
        except NumericalError as error:
            why = str(error)
        self.scopes[k] = scope = _hidden(posterior, cluster) if belief is None else belief.scope
        if isinstance(belief, Table):
            return [self._written(belief, run) for run in self.runs]
        if not scope:
            return self._absent("all its variables are observed")
        try:
            gaussian = posterior.joint(*scope)
        except (GraphError, NumericalError) as error:
            return self._absent(str(error))
        return [self._written(gaussian, run) | {"why": why} for run in self.runs]

    def _absent(self, why: str) -> list[dict[str, Any]]:
        return [{"form": "none", "why": why} for _ in self.runs]

    def _written(self, factor: Factor, run: Run) -> dict[str, Any]:
        if isinstance(factor, Table):
            return self._table(factor, run)
        if isinstance(factor, Gaussian):
            moments = factor.mean[run], lower(factor.cov[run])
            return {"form": "moments", "at": self.numbers.flat(np.concatenate(moments))}
        form = lower(factor.K[run]), factor.h[run], np.atleast_1d(factor.g[run])
        return {"form": "canonical", "at": self.numbers.flat(np.concatenate(form))}

    def _table(self, table: Table, run: Run) -> dict[str, Any]:
        run = run if table.log_scale.ndim else ()
        values, scale = table.values[run], np.atleast_1d(table.log_scale[run])
        found: dict[str, Any] = {"scope": self.names(table.scope)}
        flat = values.reshape(-1)
        full = self.numbers.count > self.limits.numbers
        if flat.size <= (_LARGEST if full else self.limits.entries):
            return found | {"form": "table", "at": self.numbers.flat(np.append(flat, scale))}
        top = np.argpartition(flat, -_LARGEST)[-_LARGEST:]
        top = top[np.argsort(-flat[top], kind="stable")]
        axes = range(values.ndim)
        sums = [values.sum(axis=tuple(a for a in axes if a != axis)) for axis in axes]
        at = self.numbers.flat(np.concatenate([top.astype(float), flat[top], scale, *sums]))
        return found | {"form": "largest", "at": at, "count": _LARGEST, "entries": flat.size}


def _hidden(posterior: Posterior, cluster: Cluster) -> Scope:
    """The variables of a cluster that have a marginal."""
    if isinstance(posterior, GaussianPosterior):
        return posterior._plan.layout.scopes[cluster.index]
    assert isinstance(posterior.graph, DynamicGraph)
    slice_ = posterior.graph.layout.slice
    return tuple(v for v in cluster.scope if v.template in slice_)
