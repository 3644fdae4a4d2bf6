"""Several modes of the posterior of a network without time: calibrations from many starts.

A start is a point of the prior: white noise, turned by the CPDs into values of all variables. Where
there is no prior of finite variance, as of a Markov network, the linear part takes its place.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from pgm.beliefs import gaussian
from pgm.beliefs.gaussian.layout import Layout
from pgm.beliefs.gaussian.model import Model
from pgm.beliefs.gaussian.outcome import GaussianOutcome, places_of
from pgm.beliefs.modes.adapted import adapt, warn_of_few
from pgm.beliefs.modes.arrivals import patient, warn_of_unsettled
from pgm.beliefs.modes.laws import Laws, Scoped, without_density
from pgm.beliefs.modes.linear_part import LinearPart, linear_part
from pgm.beliefs.modes.network_density import NetworkDensity
from pgm.beliefs.modes.outcome import Found, NetworkModes
from pgm.beliefs.modes.points import white_points
from pgm.beliefs.modes.search import Search
from pgm.beliefs.moments.trajectories.density import Peak, has_exact
from pgm.beliefs.moments.trajectories.model import Proposing, Weighed
from pgm.beliefs.moments.trajectories.proposal import Path, Proposal
from pgm.clustergraph import ClusterGraph
from pgm.cpds.base import naming_factors
from pgm.errors import EvidenceError, GraphError, ModelError
from pgm.evidence import Evidence
from pgm.evidence.static import BoundValues
from pgm.factors import Gaussian
from pgm.factors.scope import Scope, angle_mask, as_scope, dimension, listed
from pgm.kernels.arrays import Array, Index, Integers, deviation
from pgm.kernels.moments import Conditional
from pgm.networks import BayesianNetwork
from pgm.schedules.convergence import is_iterated
from pgm.schedules.options import Call
from pgm.schedules.schedule import Calibration, Loopy
from pgm.schedules.starting_points import Start
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
    search = NetworkSearch.make(graph, evidence, call._replace(schedule=schedule))
    found = search.chosen(search.arrived(starts), count)
    if not is_iterated(call.schedule):  # which warns itself
        warn_of_unsettled(found, schedule.iterations)
    if draws:
        with naming_factors():
            laws = search.laws(found)
            adapted = adapt(search.target(laws), laws, draws)
        warn_of_few(adapted.effective, draws)
        beliefs = search.beliefs(adapted.laws)
        found = found.with_draws(
            adapted.laws.weights, adapted.log_evidence, adapted.effective, beliefs
        )
    return search.outcome(found)


@dataclass(frozen=True, eq=False)
class NetworkSearch(Search):
    """A network with its evidence, in whose posterior modes are looked for; see `Search`.

    graph : ClusterGraph
        The cluster tree.
    asked : dict of Variable to ndarray
        The values of observed variables, (*runs, d), NaN where not measured, those of factors'
        residuals among them.
    evidence : tuple of Variable
        The variables that the user observed.
    call : Call
        With the schedule of each calibration.
    model : Model
        The network, linearised where it begins.
    base : LinearPart or None
        The law of variables without a prior of finite variance; None if all have one.
    level : float
        The logarithm of the density less that of the model.
    """

    schedule = Calibration

    graph: ClusterGraph
    asked: Mapping[Variable, Array]
    evidence: Scope
    call: Call
    model: Model
    base: LinearPart | None
    level: float

    @classmethod
    def make(cls, graph: ClusterGraph, evidence: Evidence, call: Call) -> NetworkSearch:
        """The search; errors refuse networks of which nothing is hidden, or is left open."""
        assert call.schedule is not None
        if not evidence and isinstance(graph.network, BayesianNetwork):
            raise EvidenceError(
                "no evidence is given, and modes are looked for that evidence leaves; beliefs "
                "without any are the network's own, which pgm.infer has"
            )
        made = gaussian.linearised_factors(graph, evidence, call.schedule, call.lineariser)
        model, bound, level = made
        if not model.layout.hidden:
            raise EvidenceError(
                "modes of hidden variables are looked for, and all are observed, which needs no "
                "starts"
            )
        values = _repeated(bound, 1)
        return cls(graph, values, tuple(evidence), call, model, _base(model), level)

    @property
    def lead(self) -> tuple[int, ...]:
        """The axes of runs."""
        return self.model.lead

    @property
    def runs(self) -> int:
        """How many runs there are."""
        return self.model.runs

    @property
    def steps(self) -> int:
        """None: there is no time."""
        return 0

    @property
    def together(self) -> bool:
        """Whether runs are asked together alone, as CPDs differ by run."""
        return bool(self.graph.network.lead)

    @property
    def hidden(self) -> Scope:
        """The hidden variables."""
        return self.model.layout.hidden

    @property
    def width(self) -> int:
        """The components of the largest nonlinear function."""
        sizes = (dimension(f.hidden) for f in self.model.families if not f.exact)
        return max(sizes, default=1)  # none if all that is not exact is robust noise

    def _of(self, runs: Integers) -> NetworkSearch:
        asked = {v: values.reshape(-1, values.shape[-1])[runs] for v, values in self.asked.items()}
        known = {v: asked[v] for v in self.evidence}
        return NetworkSearch.make(self.graph, known, self.call)

    def _called(self, call: Call) -> NetworkSearch:
        return replace(self, call=call)

    def _begun(self, starts: int) -> dict[Variable, Array]:
        """White noise, turned by the CPDs into values of all variables."""
        layout = self.model.layout
        begun = self._density(near=True).drawn(white_points(starts, layout.size)).swapaxes(0, 1)
        return {
            variable: begun[..., layout.places[variable]].reshape(
                starts, *self.lead, variable.dimension
            )
            for variable in layout.hidden
        }

    def _inferred(self, count: int, start: Start | None) -> GaussianOutcome:
        own = {
            v: np.broadcast_to(values, (count, *values.shape[1:]))
            for v, values in self.asked.items()
        }
        asked = {v: own.pop(v) for v in self.evidence}
        schedule, lineariser = self.call.schedule, self.call.lineariser
        return gaussian.run_factors(
            self.graph, asked, schedule, lineariser, start, values=own, warn=False
        )

    def target(self, laws: Laws) -> AllVariables:
        """The exact density, of one turn about the laws; a NumericalError where there is none."""
        means, stds = laws.first[:, 0], deviation(laws.spread[:, 0])
        density = self._density(near=False)
        places = np.flatnonzero(density.unturned(means[0]))
        turning = density.turning(places, means[..., places], stds[..., places])
        return AllVariables(self.model, turning, isinstance(self.graph.network, BayesianNetwork))

    def _density(self, *, near: bool) -> NetworkDensity:
        density = NetworkDensity.make(self.model, relative=False, near=near, level=self.level)
        return density if self.base is None else density.based(self.base.mean, self.base.cov)

    def laws(self, found: Found) -> Laws:
        """The Gaussian laws of the modes, of all hidden variables."""
        joint = self.outcome(found).joint(*self.model.layout.hidden).components
        size = joint.mean.shape[-1]
        count, runs = found.weights.shape
        mean = np.moveaxis(joint.mean, -2, 0).reshape(count, 1, runs, size)
        cov = np.moveaxis(joint.cov, -3, 0).reshape(count, 1, runs, size, size)
        none = np.zeros((count, 0, runs, size)), np.zeros((count, 0, runs, size, size))
        return Laws(found.weights, mean, cov, *none)

    def beliefs(self, laws: Laws) -> Joint:
        """The beliefs of laws."""
        scope, lead, count = self.model.layout.hidden, self.lead, len(laws.weights)
        size = laws.first.shape[-1]
        mean = laws.first.reshape(count, *lead, size)
        cov = laws.spread.reshape(count, *lead, size, size)
        return Joint(Gaussian._make(scope, mean, cov), self.model.layout)

    def outcome(self, found: Found) -> NetworkModes:
        """The mixtures of the modes."""
        return NetworkModes(self.graph, found, {v: self.asked[v] for v in self.evidence})


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


@dataclass(frozen=True, eq=False)
class Joint:
    """Beliefs of K modes by the joint of all hidden variables, (K, *runs, n)."""

    gaussian: Gaussian
    layout: Layout

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
            places_of(self.layout, variable)
        return self.gaussian.marginal(*scope)


class AllVariables:
    """All hidden variables of a network, as a `Target` of draws; refused without a density."""

    before = 0
    chain = None

    def __init__(self, model: Model, density: NetworkDensity, directed: bool) -> None:
        every = zip(model.layout.groups, model.families, strict=True)
        if has_exact(family for group, family in every if group.observed):
            raise without_density()
        self._density, self._directed = density, directed
        self._free = density.free((model.runs, model.layout.size))
        self.states: Index = slice(None)
        self.turned = np.zeros(model.layout.size, dtype=bool)
        self.angles = angle_mask(model.layout.hidden)
        places = model.layout.places.values()
        self.scopes = [Scoped(each, each, 0) for each in places]

    @property
    def peak(self) -> Peak | None:
        """The peak of the density; None of a Markov network, whose measurements are of no law."""
        return self._density.peak if self._directed else None

    def path(self, laws: Laws, k: int) -> Path:
        """The law of a mode, as it is drawn from."""
        given = np.zeros((*laws.first[k].shape, 0))
        return Path(Proposal.make(Conditional(given, laws.first[k], laws.spread[k]), self._free))

    def draw(self, source: Proposing, shape: tuple[int, int]) -> Weighed:
        """Values that a source proposes."""
        nothing = np.zeros((*shape, 0))
        proposed, afresh = source.propose(nothing)
        found = self._density.at(proposed, afresh, strict=False)
        source.weigh(nothing[None], found.values[None], found.log_tails[None])
        return Weighed(found.log_density, found.values[None])
