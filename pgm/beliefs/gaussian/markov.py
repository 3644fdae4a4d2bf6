"""Inference in a continuous Markov network, as in the Bayesian one that measures its residuals."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any

import numpy as np

from pgm.beliefs.gaussian.model import Model
from pgm.beliefs.gaussian.outcome import GaussianOutcome
from pgm.beliefs.gaussian.reweighting import weights_shown
from pgm.beliefs.gaussian.run import linearised, run
from pgm.beliefs.gaussian.undirected import BEYOND, NEARLY_FLAT, Directed, directed, side
from pgm.clustergraph import Cluster, ClusterGraph
from pgm.cpds import NonlinearGaussianFactor
from pgm.cpds.base import naming_factors
from pgm.cpds.conditional import ConditionalGaussian
from pgm.errors import NumericalError
from pgm.evidence import Evidence
from pgm.evidence.rows import no_evidence_for
from pgm.evidence.static import BoundValues
from pgm.factors import CanonicalForm
from pgm.kernels.arrays import Array, frozen
from pgm.linearisers import Lineariser
from pgm.networks import BayesianNetwork
from pgm.networks.markov import Factor
from pgm.posteriors.status import ENOUGH_DIGITS
from pgm.posteriors.weights import FactorWeights
from pgm.schedules.schedule import Schedule
from pgm.schedules.starting_points import Start
from pgm.variables import Variable


def run_factors(
    graph: ClusterGraph,
    evidence: Evidence,
    schedule: Schedule | None,
    lineariser: Lineariser,
    start: Start | None = None,
    *,
    values: Mapping[Variable, Array] | None = None,
    warn: bool = True,
) -> GaussianOutcome:
    """The posterior of a continuous network of any factors; of CPDs alone as by `run`.

    `values` are those of the residuals where they have axes of runs, (*runs, d), as a start without
    evidence asks for. `warn` is False where the caller warns of few digits.
    """
    if isinstance(graph.network, BayesianNetwork):
        return run(graph, evidence, schedule, lineariser, start, warn=warn)
    made, known = _measured(graph, evidence)
    known |= values or {}
    with naming_factors():
        found = run(made.graph, known, schedule, lineariser, start, warn=False)
    status = found.status
    if made.measured.lost > 10.0**-ENOUGH_DIGITS:
        status = status._losing(np.full(status.converged.size, made.measured.lost), NEARLY_FLAT)
    if warn:
        status._warn()
    own = {field.name: getattr(found, field.name) for field in fields(found)}
    return MarkovOutcome(**(own | {"graph": graph, "status": status}), _made=made)


def linearised_factors(
    graph: ClusterGraph, evidence: Evidence, schedule: Schedule, lineariser: Lineariser
) -> tuple[Model, BoundValues, float]:
    """A network of any factors linearised where it begins, with its evidence; nothing is solved.

    The last result is the logarithm of its density less that of the model.
    """
    if isinstance(graph.network, BayesianNetwork):
        return *linearised(graph, evidence, schedule, lineariser), 0.0
    made, known = _measured(graph, evidence)
    with naming_factors():
        model, bound = linearised(made.graph, known, schedule, lineariser)
    return model, bound, float(made.levels.sum())


def _measured(graph: ClusterGraph, evidence: Evidence) -> tuple[Directed, dict[Variable, Any]]:
    """A Markov network with measurements in the place of its factors, and the evidence of both."""
    made = graph.derived(directed)
    known = graph.network._places
    for variable in evidence:
        if variable not in known:
            raise no_evidence_for(variable, known)
    return made, {**evidence, **made.measured.values}


@dataclass(frozen=True, eq=False, repr=False)
class MarkovOutcome(GaussianOutcome):
    """The beliefs of a network of factors, whose log-evidence is ln Z, the factors' integral."""

    _made: Directed | None = None

    @property
    def _levels(self) -> Array:
        assert self._made is not None
        return self._made.levels

    @property
    def _level(self) -> float:
        return float(self._levels.sum())

    @property
    def log_evidence(self) -> Array:
        """The value ln Z, (...), of all factors with the evidence put in."""
        value = np.asarray(super().log_evidence + self._level)
        if not np.isfinite(value).all():
            raise NumericalError(BEYOND)
        return frozen(value)

    def entered(self, run: int) -> dict[Variable, Array]:
        """The values that were given, by variable, (d,) each."""
        assert self._made is not None
        found = super().entered(run)
        return {v: value for v, value in found.items() if v not in self._made.measured.residuals}

    @cached_property
    def weights(self) -> Mapping[Any, Array]:
        """By factor, (*runs): the weight of its residual, 1 for Gaussian noise."""
        assert self._made is not None
        factors = self._made.measured.residuals
        by_child = weights_shown(self._model)
        return FactorWeights(
            {
                factor: by_child[child]
                for child, factor in factors.items()
                if child in by_child and _is_measured(factor)
            }
        )

    def message(self, source: int | Cluster, target: int | Cluster) -> CanonicalForm:
        """The message from one cluster to a neighbour, over their sepset, unnormalised."""
        found = super().message(source, target)
        if not self.graph.is_tree:
            return found
        i, j = self.graph.index(source), self.graph.index(target)
        return _raised(found, self._levels[side(self.graph, i, j)].sum())

    def belief(self, cluster: int | Cluster) -> CanonicalForm:
        """The belief of a cluster over its variables without evidence, unnormalised."""
        found = super().belief(cluster)
        k = self.graph.index(cluster)
        return _raised(found, self._levels[side(self.graph, k, -1)].sum())

    def potential(self, cluster: int | Cluster) -> CanonicalForm:
        """The potential of a cluster: the product of its factors, with their evidence put in."""
        return _raised(super().potential(cluster), self._levels[self.graph.index(cluster)])


def _raised(form: CanonicalForm, level: float) -> CanonicalForm:
    """A canonical form with a level added to its logarithm."""
    return CanonicalForm._make(form.scope, form.K, form.h, form.g + level)


def _is_measured(factor: Factor) -> bool:
    """Whether a factor is a residual, or a CPD that counts as one: of robust noise."""
    if isinstance(factor, ConditionalGaussian):
        return factor.noise is not None
    return isinstance(factor, NonlinearGaussianFactor)
