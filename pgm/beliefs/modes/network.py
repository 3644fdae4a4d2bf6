"""Several modes of the posterior of a network without time: calibrations from many starts.

A start is a point of the prior: white noise, turned by the CPDs into values of all variables.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pgm.beliefs import gaussian
from pgm.beliefs.gaussian.model import Model
from pgm.beliefs.gaussian.outcome import GaussianOutcome
from pgm.beliefs.modes.adapted import Laws, adapt, warn_of_few, without_density
from pgm.beliefs.modes.arrivals import arrived, chosen, patient, warn_of_unsettled
from pgm.beliefs.modes.network_density import NetworkDensity
from pgm.beliefs.modes.outcome import Found, NetworkModes
from pgm.beliefs.modes.points import white_points
from pgm.beliefs.moments.trajectories.density import has_exact
from pgm.beliefs.moments.trajectories.model import Proposing, Weighed
from pgm.beliefs.moments.trajectories.proposal import Path, Proposal
from pgm.clustergraph import ClusterGraph
from pgm.errors import EvidenceError, GraphError, ModelError
from pgm.evidence import Evidence
from pgm.evidence.static import BoundValues
from pgm.factors import Gaussian
from pgm.factors.scope import Scope, angle_mask, as_scope
from pgm.kernels.arrays import Array, Index, Integers
from pgm.kernels.moments import Conditional
from pgm.networks import BayesianNetwork
from pgm.schedules.convergence import is_iterated
from pgm.schedules.options import Call
from pgm.schedules.schedule import Calibration, Loopy
from pgm.variables import Variable


def run(
    graph: ClusterGraph, evidence: Evidence, call: Call, count: int, starts: int, draws: int
) -> NetworkModes:
    """The modes at which calibrations from so many starts arrive, `count` at the most.

    They are adapted by so many `draws`; by none if it is 0.
    """
    if isinstance(call.schedule, Loopy):
        raise GraphError(
            f"{call.schedule!r} sends messages round loops, and starts= weighs modes by their "
            "evidence, which a tree has: compile a junction tree, pgm.compile(network)"
        )
    if not isinstance(graph.network, BayesianNetwork):
        raise ModelError(
            "starts= are points that the CPDs of a Bayesian network make of white noise, and a "
            "MarkovNetwork has none; infer it from several points, start={variable: mean}"
        )
    for cpd in graph.network.cpds:
        cpd.require_proper("starts= are points of the prior")
    if graph.network.lead:
        raise ModelError(
            "starts= are runs beside the evidence's own, and a CPD of this network differs by run: "
            "give one run a call"
        )
    schedule = patient(call, Calibration)
    if not evidence:
        raise EvidenceError(
            "starts= looks for modes that evidence leaves, and there is none: give some, or leave "
            "starts out"
        )
    model, bound = gaussian.linearised(graph, evidence, schedule, call.lineariser)
    hidden, lead = model.layout.hidden, model.lead
    if not hidden:
        raise EvidenceError(
            "starts= looks for modes of hidden variables, and all are observed: leave starts out"
        )
    begun = NetworkDensity.make(model, relative=False).drawn(
        white_points(starts, model.layout.size)
    )

    def infer(some: Integers) -> GaussianOutcome:
        """The calibrations from some starts."""
        start = {
            variable: np.moveaxis(begun[:, some][..., model.layout.places[variable]], 1, 0).reshape(
                some.size, *lead, variable.dimension
            )
            for variable in hidden
        }
        own = _repeated(bound, some.size)
        return gaussian.run(graph, own, schedule, call.lineariser, start, warn=False)

    parts = arrived(infer, starts)
    found = chosen(parts, hidden, lead, 0, count)
    if not is_iterated(call.schedule):  # which warns itself
        warn_of_unsettled(found, schedule.iterations)
    return NetworkModes(graph, _adapted(graph, found, model, draws) if draws else found)


def _repeated(bound: BoundValues, count: int) -> dict[Variable, Array]:
    """The evidence so many times, on an axis before its runs."""
    found = {}
    for variable, values in bound.values.items():
        if variable in bound.taken:
            values = np.where(bound.taken[variable], values, np.nan)
        own = np.broadcast_to(values, (bound.runs, values.shape[-1]))
        own = own.reshape(*bound.lead, values.shape[-1])
        found[variable] = np.broadcast_to(own, (count, *own.shape))
    return found


def _adapted(graph: ClusterGraph, found: Found, model: Model, draws: int) -> Found:
    """The modes adapted by weighed draws."""
    scope = model.layout.hidden
    target, lead = AllVariables(model), np.shape(found.log_evidence)
    joint = NetworkModes(graph, found).joint(*scope).components
    size = joint.mean.shape[-1]
    count, runs = found.weights.shape
    mean = np.moveaxis(joint.mean, -2, 0).reshape(count, 1, runs, size)
    cov = np.moveaxis(joint.cov, -3, 0).reshape(count, 1, runs, size, size)
    none = np.zeros((count, 0, runs, size)), np.zeros((count, 0, runs, size, size))
    adapted = adapt(target, Laws(found.weights, mean, cov, *none), draws)
    warn_of_few(adapted.effective, draws)
    laws = adapted.laws
    beliefs = Joint(
        Gaussian._make(
            scope,
            laws.first.reshape(count, *lead, size),
            laws.spread.reshape(count, *lead, size, size),
        ),
        found.parts[0].outcome,
    )
    return found.with_draws(laws.weights, adapted.log_evidence, adapted.effective, beliefs)


@dataclass(frozen=True, eq=False)
class Joint:
    """Beliefs of K modes by the joint of all hidden variables, (K, *runs, n).

    Other variables are refused as by an outcome that is `unadapted`.
    """

    gaussian: Gaussian
    unadapted: GaussianOutcome

    @property
    def _hidden(self) -> Scope:
        return self.gaussian.scope

    def __getitem__(self, variable: Variable) -> Gaussian:
        """The marginals of a variable."""
        return self.joint(variable)

    def joint(self, *variables: Variable) -> Gaussian:
        """The joints of variables."""
        scope = as_scope(variables)
        for variable in scope:
            self.unadapted._require_hidden(variable)
        return self.gaussian.marginal(*scope)


class AllVariables:
    """All hidden variables of a network, as a `Target` of draws; refused without a density."""

    before = 0

    def __init__(self, model: Model) -> None:
        every = zip(model.layout.groups, model.families, strict=True)
        if has_exact(family for group, family in every if group.observed):
            raise without_density()
        self._density = NetworkDensity.make(model, relative=False, near=False)
        self._free = self._density.free((model.runs, model.layout.size))
        self.states: Index = slice(None)
        self.turned = np.zeros(model.layout.size, dtype=bool)
        self.angles = angle_mask(model.layout.hidden)

    def path(self, laws: Laws, k: int) -> Path:
        """The law of a mode, as it is drawn from."""
        given = np.zeros((*laws.first[k].shape, 0))
        return Path(Proposal.make(Conditional(given, laws.first[k], laws.spread[k]), self._free))

    def draw(self, source: Proposing, shape: tuple[int, int]) -> Weighed:
        """Values that a source proposes."""
        nothing = np.zeros((*shape, 0))
        proposed, afresh = source.propose(nothing)
        found = self._density.at(proposed, afresh, strict=False)
        source.weigh(nothing, found.values, found.log_tails)
        return Weighed(found.log_density, [found.values])
