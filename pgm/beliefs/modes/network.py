"""Several modes of the posterior of a network without time: calibrations from many starts.

A start is a point of the prior: white noise, turned by the CPDs into values of all variables. Where
there is no prior of finite variance, as of a Markov network, the linear part takes its place.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pgm.beliefs import gaussian
from pgm.beliefs.gaussian.model import Model
from pgm.beliefs.gaussian.outcome import GaussianOutcome
from pgm.beliefs.modes.adapted import Laws, adapt, warn_of_few, without_density
from pgm.beliefs.modes.arrivals import arrived, chosen, patient, warn_of_unsettled
from pgm.beliefs.modes.linear_part import LinearPart, linear_part
from pgm.beliefs.modes.network_density import NetworkDensity
from pgm.beliefs.modes.outcome import Found, NetworkModes
from pgm.beliefs.modes.points import white_points
from pgm.beliefs.moments.trajectories.density import has_exact
from pgm.beliefs.moments.trajectories.model import Proposing, Weighed
from pgm.beliefs.moments.trajectories.proposal import Path, Proposal
from pgm.clustergraph import ClusterGraph
from pgm.cpds.base import naming_factors
from pgm.errors import EvidenceError, GraphError, ModelError
from pgm.evidence import Evidence
from pgm.evidence.static import BoundValues
from pgm.factors import Gaussian
from pgm.factors.scope import Scope, angle_mask, as_scope, listed
from pgm.kernels.arrays import Array, Index, Integers, deviation
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
    if graph.network.lead:
        raise ModelError(
            "starts= are runs beside the evidence's own, and a CPD of this network differs by run: "
            "give one run a call"
        )
    schedule = patient(call, Calibration)
    if not evidence and isinstance(graph.network, BayesianNetwork):
        raise EvidenceError(
            "starts= looks for modes that evidence leaves, and there is none: give some, or leave "
            "starts out"
        )
    model, bound, level = gaussian.linearised_factors(graph, evidence, schedule, call.lineariser)
    hidden, lead = model.layout.hidden, model.lead
    if not hidden:
        raise EvidenceError(
            "starts= looks for modes of hidden variables, and all are observed: leave starts out"
        )
    base = _base(model)
    begun = _density(model, base, level, near=True).drawn(white_points(starts, model.layout.size))

    def infer(some: Integers) -> GaussianOutcome:
        """The calibrations from some starts."""
        start = {
            variable: np.moveaxis(begun[:, some][..., model.layout.places[variable]], 1, 0).reshape(
                some.size, *lead, variable.dimension
            )
            for variable in hidden
        }
        own = _repeated(bound, some.size)
        asked = {v: own.pop(v) for v in evidence}
        return gaussian.run_factors(
            graph, asked, schedule, call.lineariser, start, values=own, warn=False
        )

    parts = arrived(infer, starts)
    found = chosen(parts, hidden, lead, 0, count)
    if not is_iterated(call.schedule):  # which warns itself
        warn_of_unsettled(found, schedule.iterations)
    if draws:
        with naming_factors():
            target = AllVariables(model, _density(model, base, level, near=False))
            found = _adapted(graph, found, target, model, draws)
    return NetworkModes(graph, found)


def _base(model: Model) -> LinearPart | None:
    """The law of variables without a prior of finite variance; None if all have one.

    A ModelError if affine factors leave some open.
    """
    density = NetworkDensity.make(model, relative=False, near=False)
    if not density.open.size:
        return None
    centre = model.frame.mean
    part = linear_part(model, density.open, density.unturned(centre), centre)
    if part.open:
        raise ModelError(
            "starts= are points of a prior of finite variance, or of the law that affine factors "
            f"with Gaussian noise make together, and neither bounds {listed(part.open)}: give "
            "a wide GaussianCPD or CanonicalForm of it; or infer from several points, "
            "start={variable: mean}, and compare log_evidence",
            variable=part.open[0],
        )
    return part


def _density(model: Model, base: LinearPart | None, level: float, *, near: bool) -> NetworkDensity:
    density = NetworkDensity.make(model, relative=False, near=near, level=level)
    return density if base is None else density.based(base.mean, base.cov)


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


def _adapted(
    graph: ClusterGraph, found: Found, target: AllVariables, model: Model, draws: int
) -> Found:
    """The modes adapted by weighed draws."""
    scope, lead = model.layout.hidden, np.shape(found.log_evidence)
    joint = NetworkModes(graph, found).joint(*scope).components
    size = joint.mean.shape[-1]
    count, runs = found.weights.shape
    mean = np.moveaxis(joint.mean, -2, 0).reshape(count, 1, runs, size)
    cov = np.moveaxis(joint.cov, -3, 0).reshape(count, 1, runs, size, size)
    none = np.zeros((count, 0, runs, size)), np.zeros((count, 0, runs, size, size))
    target.about(mean[:, 0], deviation(cov[:, 0]))
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

    def __init__(self, model: Model, density: NetworkDensity) -> None:
        every = zip(model.layout.groups, model.families, strict=True)
        if has_exact(family for group, family in every if group.observed):
            raise without_density()
        self._density = density
        self._free = self._density.free((model.runs, model.layout.size))
        self.states: Index = slice(None)
        self.turned = np.zeros(model.layout.size, dtype=bool)
        self.angles = angle_mask(model.layout.hidden)

    def about(self, means: Array, stds: Array) -> None:
        """Take one turn of angles without turns about modes, (K, runs, n) each."""
        places = np.flatnonzero(self._density.unturned(means[0]))
        self._density = self._density.turning(places, means[..., places], stds[..., places])

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
