"""The result of inference in a Gaussian network: marginals, joints, messages and ln p(evidence).

Messages, and the beliefs and potentials of clusters, are given in canonical form, by an information
matrix K, a vector h and a constant g: exp(−½ xᵀK x + hᵀx + g).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import repeat
from typing import ClassVar

import numpy as np

from pgm.beliefs.gaussian.beliefs import Calibrated, runs_first
from pgm.beliefs.gaussian.draws import draws
from pgm.beliefs.gaussian.joints import joint_moments
from pgm.beliefs.gaussian.layout import Layout
from pgm.beliefs.gaussian.messages import RowMessages
from pgm.beliefs.gaussian.model import Model
from pgm.beliefs.gaussian.reweighting import weights_shown
from pgm.beliefs.gaussian.row_buffer import Buffer
from pgm.beliefs.gaussian.tree import TreePlan
from pgm.beliefs.gaussian.walks import shown, spectral_radius
from pgm.clustergraph import Cluster, ClusterGraph
from pgm.display import Summary
from pgm.errors import EvidenceError, GraphError, NumericalError
from pgm.factors import CanonicalForm, Gaussian
from pgm.factors.scope import Scope, as_scope, names, namesake
from pgm.kernels.arrays import Array, Integers, apply, frozen, inner, quiet, transpose
from pgm.kernels.rows import Rows
from pgm.linearisation.weights import bound_kind
from pgm.posteriors.outcome import NETWORK, Outcome
from pgm.posteriors.posterior import require_variable
from pgm.posteriors.status import Status
from pgm.posteriors.summaries import of_network
from pgm.schedules.limits import require_runs
from pgm.variables import Variable


@dataclass(frozen=True, eq=False, repr=False)
class GaussianOutcome(Outcome[Gaussian]):
    """The beliefs of a Gaussian network given its evidence.

    The leading axes of all results are the user's axes of runs. On a tree the beliefs are exact for
    the (linearised) network. On a graph with loops the means are exact where the messages have
    converged; the variances are approximate: too small or too large.

    Attributes
    ----------
    graph : ClusterGraph
    status : Status
        Whether messages and linearisation have converged, and how many digits are correct.
    """

    beliefs: ClassVar[str] = "Gaussian beliefs"
    form: ClassVar[str] = NETWORK

    kind: ClassVar[None] = None
    graph: ClusterGraph
    status: Status
    _plan: TreePlan
    _model: Model
    _done: Calibrated
    _sent: RowMessages | None = None

    @property
    def _hidden(self) -> Scope:
        return self._model.layout.hidden

    @property
    def _level(self) -> float:
        """The logarithm of the network's density less that of its `_model`."""
        return 0.0

    def entered(self, run: int) -> dict[Variable, Array]:
        """The values that were given, by variable, (d,) each."""
        found = dict[Variable, Array]()
        for group, rows in zip(self._model.layout.groups, self._model.readings, strict=True):
            if rows is not None:
                own = rows[:, run if rows.shape[1] > 1 else 0]
                found |= {cpd.child: row for cpd, row in zip(group.cpds, own, strict=True)}
        return found

    @quiet()
    def __getitem__(self, variable: Variable) -> Gaussian:
        """The marginal of a variable without evidence, (*runs, d)."""
        places = places_of(self._plan.layout, variable)
        home, _ = self._done.beliefs.places.blocks.homes
        return self._read((variable,), int(home[places[0]]))

    @quiet()
    def _stacked(self, variables: Sequence[Variable]) -> tuple[Array, Array]:
        starts = self._plan.layout.starts
        first = np.fromiter(map(starts.get, variables, repeat(-1)), np.intp, len(variables))
        if (first < 0).any():
            for variable in variables:
                places_of(self._plan.layout, variable)
        places = first[:, None] + np.arange(variables[0].dimension)
        beliefs, lead = self._done.beliefs, self._model.lead
        homes, columns = (part[places] for part in beliefs.places.blocks.homes)
        at = homes[:, 0], columns  # all components of a variable are in the same blocks
        means, covs = beliefs.moments(beliefs.places.means(*at), beliefs.places.covs(*at), places)
        if not (np.isfinite(means).all() and np.isfinite(covs).all()):
            return super()._stacked(variables)  # which refuses the first that is not
        covs = np.broadcast_to(covs, (*means.shape, places.shape[1]))
        return means.reshape(*lead, *means.shape[1:]), covs.reshape(*lead, *covs.shape[1:])

    def _read(self, scope: Scope, block: int) -> Gaussian:
        """The joint of the variables in `scope`, (*runs, n), from a block that holds them all."""
        components = self._plan.layout.components(scope)
        where, entries = self._done.beliefs.places.of(np.array([block]), components[None])
        mean, cov = self._done.beliefs.moments(where[0], entries[0], components)
        return self._gaussian(scope, mean, cov)

    def _gaussian(self, scope: Scope, mean: Array, cov: Array) -> Gaussian:
        """The Gaussian over `scope` of a mean (runs, n) and a covariance (runs or 1, n, n).

        The axis of runs is replaced by the user's axes. Moments that are not finite are a
        NumericalError.
        """
        lead = self._model.lead
        size = mean.shape[-1]
        if not (np.isfinite(mean).all() and np.isfinite(cov).all()):
            raise NumericalError(
                f"the belief of {names(scope)} has moments beyond the range of float64; give the "
                "model other units",
                variable=scope[0],
            )
        wide = np.broadcast_to(cov, (*mean.shape, size))
        return Gaussian._make(scope, mean.reshape(*lead, size), wide.reshape(*lead, size, size))

    @quiet()
    def joint(self, *variables: Variable) -> Gaussian:
        """The joint of variables without evidence, in the order given, (*runs, n).

        Variables of several clusters are joined along the tree between them. On a graph with loops
        all have to be in one cluster, else it is a GraphError.
        """
        scope = as_scope(variables)
        if not scope:
            raise EvidenceError("joint takes one or more variables")
        for variable in scope:
            places_of(self._plan.layout, variable)
        wanted = self._plan.layout.components(scope)
        blocks = self._done.beliefs.places.blocks
        holders = blocks.hold(wanted)
        if holders.size:
            return self._read(scope, int(holders[blocks.sizes[holders].argmin()]))
        if not self.graph.is_tree:
            raise GraphError(
                f"no cluster holds all of {names(scope)}, and on a graph with loops only "
                "variables of one cluster have a joint; compile a junction tree"
            )
        beliefs = self._done.beliefs
        require_runs(wanted.size**2, len(beliefs.cov), f"the joint of {len(scope)} variables")
        return self._gaussian(scope, *joint_moments(self._plan, beliefs, wanted))

    @quiet()
    def sample(self, count: int, rng: np.random.Generator) -> dict[Variable, Array]:
        """So many draws of each hidden variable for each run, (count, *runs, d)."""
        drawn = draws(self, count, rng)
        lead = self._model.lead
        return {v: values.reshape(count, *lead, v.dimension) for v, values in drawn.items()}

    @cached_property
    def _messages(self) -> RowMessages:
        """The messages between clusters; on a tree they are sent when they are first asked for."""
        if self._sent is not None:
            return self._sent
        buffer = Buffer.make(self._plan.rounds, self._model)
        messages = RowMessages.make(buffer, self._plan.cluster_places, 0.0)
        messages.send_once(self._plan.both_ways)
        return messages

    @quiet()
    def message(self, source: int | Cluster, target: int | Cluster) -> CanonicalForm:
        """The message from one cluster to a neighbour, over their sepset.

        On a tree its constant g carries the evidence that went into it; on a graph with loops its
        scale has no meaning. Where CPDs without noise determine a part of it, it has no canonical
        form, which is a NumericalError.
        """
        i, j = self.graph.index(source), self.graph.index(target)
        edges, edge = list(self.graph.sepsets), (min(i, j), max(i, j))
        if edge not in edges:
            raise GraphError(
                f"clusters {i} and {j} are not joined; the neighbours of {i} are "
                f"{self.graph.neighbours(i)}",
                cluster=i,
            )
        place = edges.index(edge)
        found, scope = self._messages.kept(2 * place + (i > j)), self._plan.layout.sepsets[place]
        return self._form(*found, scope, f"the message from cluster {i} to {j}", i)

    @quiet()
    def belief(self, cluster: int | Cluster) -> CanonicalForm:
        """The belief of a cluster over its variables without evidence, unnormalised.

        It is the product of the cluster's potential and all messages to it. Where CPDs without
        noise determine a part of it, it has no canonical form, which is a NumericalError.
        """
        index = self.graph.index(cluster)
        found, scope = self._messages.belief(index), self._plan.layout.scopes[index]
        return self._form(*found, scope, f"the belief of cluster {index}", index)

    @quiet()
    def potential(self, cluster: int | Cluster) -> CanonicalForm:
        """The potential of a cluster: the product of its CPDs as linearised, with their evidence.

        It is over the cluster's variables without evidence. CPDs without noise have no canonical
        form, which is a NumericalError.
        """
        index = self.graph.index(cluster)
        found, scope = self._messages.potential(index), self._plan.layout.scopes[index]
        return self._form(*found, scope, f"the potential of cluster {index}", index)

    def _form(
        self, factor: Rows, log_scale: Array, scope: Scope, what: str, cluster: int
    ) -> CanonicalForm:
        """The canonical form, in the user's coordinates, of a factor exp(log_scale − ½ |A ξ − r|²).

        ξ are the n components of `scope` in the coordinates of the model's frame: the components
        are mean + scale ξ. `factor` has A (V, k, n) and r (V, k, N), and `log_scale` is (V, N): V =
        1 and N = runs if all runs share A, else V = runs and N = 1. Turned to the user's
        coordinates, A and r make K = AᵀA, h = Aᵀr and g = log_scale − ½ |r|². Relations without
        noise, or numbers that are not finite, are a NumericalError that names the `cluster`; its
        text begins with `what` ("the belief of cluster 2").
        """
        if factor.exact is not None and factor.exact.any():
            raise NumericalError(
                f"{what}, over {names(scope)}, has no canonical form: CPDs without noise "
                "determine a part of it; posterior[...] and joint(...) have its moments",
                cluster=cluster,
            )
        frame, places = self._model.frame, self._plan.layout.components(scope)
        matrix, at = factor.matrix / frame.scale[places], frame.mean[:, places]
        right = runs_first(factor.right) + apply(matrix, at)
        K = np.broadcast_to(transpose(matrix) @ matrix, (*at.shape, places.size))
        h = apply(transpose(matrix), right)
        g = runs_first(log_scale) - 0.5 * inner(right, right)
        if not all(np.isfinite(part).all() for part in (K, h, g)):
            raise NumericalError(
                f"{what}, over {names(scope)}, has no canonical form in float64: its information "
                "is out of range; posterior[...] and joint(...) have its moments",
                cluster=cluster,
            )
        lead = self._model.lead
        return CanonicalForm._make(
            scope, *(part.reshape((*lead, *part.shape[1:])) for part in (K, h, g))
        )

    @property
    def log_evidence(self) -> Array:
        """The value ln p(evidence), (...); see `log_evidence_kind`.

        Exact measurements that repeat one another have no joint density; the value is then ln p of
        measurements of which none repeats another, in a unit that depends on the graph. A value
        beyond the range of float64, of measurements some 10¹⁵⁰ standard deviations from the model,
        is a NumericalError.
        """
        value = self._done.log_evidence
        if not np.isfinite(value).all():
            of = f" in run {int(np.argmin(np.isfinite(value)))}" if value.size > 1 else ""
            raise NumericalError(
                f"ln p(evidence) is beyond the range of float64{of}: a measurement is more than "
                "1e150 deviations from what the model expects; give its CPD more noise"
            )
        return frozen(runs_first(value).reshape(self._model.lead))

    @cached_property
    def weights(self) -> Mapping[Variable, Array]:
        """By observed variable, (*runs): the weight of its measurement, 1 for Gaussian noise.

        NaN where nothing was measured.
        """
        return weights_shown(self._model)

    @property
    def log_evidence_kind(self) -> str:
        """The kind of `log_evidence`: exact, linearised, laplace or bethe.

        With robust noise it is a bound, a linearised bound, or unnormalised. Else on a tree it is
        exact if all CPDs are affine, Laplace's approximation if all are expanded to first order and
        the means have converged, else that of the linearised network. On a graph with loops, and
        while a loopy schedule has not converged, it is Bethe's.
        """
        model = self._model
        sent = self._sent is None or bool(self.status.converged.all())
        if not self.graph.is_tree or not sent:
            return "bethe"
        robust = [family for family in model.families if family.cpd.noise is not None]
        if robust:
            return bound_kind(robust, affine=model.exact)
        if model.exact:
            return "exact"
        return "laplace" if model.taylor and bool(self.status.converged.all()) else "linearised"

    @quiet()
    def _why_unsettled(self) -> str:
        """A sentence for the warning that messages have not converged, on why they may not.

        It tells whether the network is walk-summable in the run furthest from convergence, which
        the spectral radius of its partial correlations decides: from 1 on messages round loops may
        diverge. It is empty if messages were not sent by rounds, or the radius is unknown.
        """
        if self._sent is None or not len(self.status.residuals):
            return ""
        last = np.where(self.status.converged, -1.0, self.status.residuals[-1])
        radius = spectral_radius(self._sent, int(last.argmax()))
        if radius is None:
            return ""
        about = "the spectral radius of |R|, R = I - D^(-1/2) J D^(-1/2) of its information J,"
        if radius >= 1.0:
            return (
                f"The network is not walk-summable: {about} is {shown(radius)}, and from 1 on "
                "messages round loops may diverge. "
            )
        return (
            f"The network is walk-summable ({about} is {shown(radius)}): the nearer 1, the slower. "
        )

    @property
    def _title(self) -> str:
        lead = self._model.lead
        return f"Posterior({self.graph._title}{f', runs {lead}' if lead else ''})"

    def _summary(self) -> Summary:
        return of_network(self._title, self, self._plan.layout.hidden, self._model.lead)


def places_of(layout: Layout, variable: Variable) -> Integers:
    """The indices (d,) of a hidden variable's components in the vector of all hidden ones.

    Any other variable is an EvidenceError, which says why it has no belief.
    """
    if require_variable(variable) in layout.places:
        return layout.places[variable]
    if variable in layout.observed:
        raise EvidenceError(
            f"{variable!r} is observed: its value is its evidence, and a component that is "
            "NaN there is left out of the network; for a belief about it give it no evidence",
            variable=variable,
        )
    if variable in layout.absent:
        raise EvidenceError(
            f"{variable!r} was left out, since nothing depends on it, and inputs of its CPD "
            "have no evidence or its noise is robust, which weighs measurements alone; give "
            "them values, or leave noise= out",
            variable=variable,
        )
    raise EvidenceError(
        f"{variable!r} is not in the network; its variables without evidence are "
        f"{list(layout.hidden)}{namesake(variable, layout.hidden)}",
        variable=variable,
    )
