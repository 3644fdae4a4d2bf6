"""The results of inference on a chain: beliefs over time, joints and messages on request.

A `ChainOutcome` keeps the moments that the passes over a Gaussian dynamic network found, and
computes from them, when asked, marginals, joints, and the messages, beliefs and potentials of
clusters. The steps are 0..T. A canonical form (K, h, g) is exp(−½ xᵀK x + hᵀx + g). A pass in
*twice the digits* works with pairs of float64.

The private fields of a posterior are what it computes from. `_planned` is the plan, the CPDs with
their evidence and linearisations; `_swept` is the forward pass, all of it or its filtered moments
alone. The others are None where there is no such thing: `_smoothed`, the smoothed beliefs;
`_reverse_given`, the reversed chain, if the passes have made it; `_careful`, the forward pass in
twice the digits; and `_windows`, the results of a fixed lag's sliding windows.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import ClassVar

import numpy as np

from pgm.beliefs.moments.digits import adjoint
from pgm.beliefs.moments.digits.adjoint_belief import Smooth
from pgm.beliefs.moments.digits.careful_belief import rounded_belief
from pgm.beliefs.moments.digits.careful_pass import Careful
from pgm.beliefs.moments.outcomes import doubts
from pgm.beliefs.moments.outcomes.draws import draws
from pgm.beliefs.moments.outcomes.innovated import Innovated
from pgm.beliefs.moments.outcomes.left_out import left_out
from pgm.beliefs.moments.outcomes.marginals import Marginals, Predicted
from pgm.beliefs.moments.outcomes.measurements import unread
from pgm.beliefs.moments.outcomes.nonlinear import nonlinearities
from pgm.beliefs.moments.outcomes.shown_slices import ShownMoments
from pgm.beliefs.moments.passes import backward
from pgm.beliefs.moments.passes.backward import Beliefs, Reverse
from pgm.beliefs.moments.passes.forward import Filtered, Forward
from pgm.beliefs.moments.passes.joints import joint_moments
from pgm.beliefs.moments.passes.messages import backward_messages, first_potential, potentials
from pgm.beliefs.moments.passes.reweighting import evidence_kind, weights
from pgm.beliefs.moments.smoothers.fixed_lag import Windows
from pgm.beliefs.moments.steps.diffuse import Diffuse
from pgm.beliefs.moments.steps.plan import ChainPlan
from pgm.clustergraph import Cluster
from pgm.compile import DynamicGraph
from pgm.display import Summary
from pgm.errors import GraphError, NumericalError
from pgm.factors import CanonicalForm, Gaussian
from pgm.factors.scope import Scope, names
from pgm.kernels import canonical
from pgm.kernels.arrays import Array, Integers, block, quiet
from pgm.posteriors.associations import Found
from pgm.posteriors.belief_kind import FILTERED, PREDICTED, SMOOTHED, Kind, require_smoothed
from pgm.posteriors.hidden import measured, require_at_steps
from pgm.posteriors.left_out import LeftOut, require_all
from pgm.posteriors.measurements import as_read, no_readings
from pgm.posteriors.nonlinearity import Nonlinearities
from pgm.posteriors.outcome import CHAIN, Outcome
from pgm.posteriors.shown_slices import Room
from pgm.posteriors.status import Status
from pgm.posteriors.summaries import over_time
from pgm.schedules.limits import require_runs
from pgm.variables import Variable


@dataclass(frozen=True, eq=False, repr=False)
class ChainOutcome(Innovated, Outcome[Gaussian]):
    """The beliefs of a chain of clusters after a schedule of messages.

    ``posterior[x]`` is a stacked `Gaussian`: states at steps 0..T, hidden controls at
    1..T (``.steps`` says); ``posterior[x.at(3)]`` is that of one step. Leading axes are runs. A
    slice is the vector of all hidden variables of a step.

    Attributes
    ----------
    graph : DynamicGraph
        Its clusters are numbered by step: 0 is over the states at step 0, t = 1..T over the states
        at t − 1 and the slice at t.
    status : Status
        Linearisations, residuals, and whether they converged.
    kind : Kind
        Which measurements the beliefs know: filtered, fixed-lag or smoothed.
    log_evidence_kind : str
        ``exact``; ``linearised``, of the linearised model; or ``laplace``, at the fixed point of
        Taylor relinearisation. With robust noise a lower ``bound``, a ``linearised bound``, or
        ``unnormalised``, if a density has no finite integral.
    weights : mapping of Variable to ndarray
        By sensor, (*runs, M): the weight w of each of its M measurements, which counts as a
        Gaussian of covariance R / w, R being the covariance of its noise; 1 for Gaussian noise.
    associations : mapping of Variable to Associations
        By sensor: the candidate, such as a landmark, that each measurement was taken to be of,
        where the evidence left that open, by `unknown`.

    Examples
    --------
    >>> from pgm.examples import walk, x, z
    >>> posterior = pgm.smooth(walk, {z: [[4.0]]})
    >>> posterior[x].mean.ravel(), posterior[x].cov.ravel()
    (array([1., 2.]), array([0.75, 1.  ]))
    >>> posterior.filtered[x].mean.ravel()
    array([0., 2.])
    >>> posterior.joint(x.at(0), x.at(1)).cov
    array([[0.75, 0.5 ],
           [0.5 , 1.  ]])
    >>> posterior.belief(0).gaussian().mean
    array([1.])
    >>> posterior.message(0, 1).gaussian().cov
    array([[1.]])
    """

    beliefs: ClassVar[str] = "Gaussian beliefs"
    form: ClassVar[str] = CHAIN
    moving: ClassVar[bool] = True

    graph: DynamicGraph
    status: Status
    kind: Kind
    _planned: ChainPlan
    _swept: Forward | Filtered
    _smoothed: Beliefs | None
    _reverse_given: Reverse | None
    _careful: Careful | None = None
    _windows: Windows | None = None
    associations: Found = field(default_factory=dict)

    def slices(self, span: range, room: Room) -> ShownMoments:
        """The slices of these steps, as a page shows them."""
        return ShownMoments(self, span, room)

    def __getitem__(self, variable: Variable) -> Gaussian:
        """The marginal of a hidden variable, or of a measurement not taken, at one step or at all.

        Any other variable, or a step where it does not stand, raises EvidenceError.
        """
        if measured(self.graph.layout, variable) is not None:
            return self._unread(variable)
        return self._marginals(self._beliefs, self.kind)[variable]

    @quiet()
    def _unread(self, variable: Variable) -> Gaussian:
        """The belief of a measurement that was not taken, given all that the beliefs know."""
        return unread(self._plan, variable, self._beliefs.mean, self._spread)

    def _readings_of(self, variable: Variable) -> tuple[Integers, Array]:
        plan = self._planned
        sensor = next((each for each in plan.sensors if each.variable == variable), None)
        if sensor is None:
            return no_readings(variable, plan.lead)
        marked = sensor.marked if sensor.gated is None else sensor.given_marked
        return as_read(sensor.family.step, sensor.order, marked, plan.lead)

    @property
    def _spread(self) -> Diffuse:
        """The covariances of `_beliefs`, along known and unknown directions."""
        cov, careful = self._beliefs.cov, self._careful
        if not np.isinf(cov).any():
            return Diffuse.known(cov)
        slices = self._careful_slices
        if careful is None or (slices is None and self.kind != FILTERED):
            raise NumericalError(
                f"{self.kind} beliefs keep no directions of which nothing is known, which the "
                "belief of a measurement needs; pgm.filter and pgm.smooth keep them"
            )
        unknown = careful.steps[-1].taken.unknown
        every = (
            [step.taken.spread for step in careful.steps]
            if slices is None
            else [rounded_belief(each.belief, unknown)[1] for each in slices]
        )
        return Diffuse(*map(np.stack, zip(*every, strict=True)))

    @property
    @quiet()
    def _forward(self) -> Forward:
        """The forward pass of all steps, made again if only its filtered moments were kept."""
        swept = self._swept
        return swept.whole if isinstance(swept, Filtered) else swept

    @property
    def _plan(self) -> ChainPlan:
        """The plan, linearised as the forward pass left it.

        If the pass kept no linearisations in the plan, the pass is made again first.
        """
        assert self._forward is not None
        return self._planned

    def _marginals(self, beliefs: Beliefs, kind: Kind) -> Marginals:
        """The marginals of hidden variables, cut out of `beliefs`, the moments of all slices.

        `kind` tells which measurements they know: predicted, filtered, fixed-lag or smoothed.
        """
        return Marginals(self.graph.layout, beliefs, self._lead, kind)

    @cached_property
    def _lead(self) -> tuple[int, ...]:
        """The axes of runs that users see."""
        return self._planned.lead

    @property
    def _beliefs(self) -> Beliefs:
        """Moments of all slices: smoothed where a smoother ran, filtered otherwise."""
        return self._smoothed or Beliefs(self._swept.mean, self._swept.cov)

    @property
    def _hidden(self) -> Scope:
        """States and hidden controls, in the order of a slice."""
        return (*self.graph.model.states, *self.graph.model.controls)

    @property
    def predicted(self) -> Predicted:
        """Beliefs given the measurements before each step, as CPDs were linearised last.

        They are of hidden variables, and of measurements.
        """
        plan, forward = self._plan, self._forward
        beliefs = Beliefs(forward.predicted_mean, forward.predicted_cov)
        shown = self.graph.layout, beliefs, self._lead, PREDICTED
        return Predicted(*shown, plan, forward.ahead)

    @cached_property
    def left_out(self) -> LeftOut:
        """The beliefs of readings given all but their own, by sensor."""
        require_all(self.kind)
        return LeftOut([sensor.variable for sensor in self._planned.sensors], self._left_out_of)

    @quiet()
    def _left_out_of(self, variable: Variable) -> Gaussian:
        plan, mean, spread = self._plan, self._beliefs.mean, self._spread
        sensor = next(each for each in plan.sensors if each.variable == variable)
        return left_out(plan, sensor, mean, spread)

    @cached_property
    @quiet()
    def nonlinearity(self) -> Nonlinearities:
        """How nonlinear CPDs are over the beliefs where they were linearised, by their children."""
        return Nonlinearities(nonlinearities(self))

    @property
    def filtered(self) -> Marginals:
        """Marginals given the measurements up to each step: the forward pass.

        A fixed-lag smoother that iterates slides a window of lag + 1 steps along the chain: then
        they are the marginals of each window at its newest step.
        """
        beliefs = Beliefs(self._swept.mean, self._swept.cov)
        return self._marginals(beliefs if self._windows is None else self._windows.newest, FILTERED)

    @cached_property
    def weights(self) -> Mapping[Variable, Array]:
        """By sensor, (*runs, M): the weights of its M measurements, 1 for Gaussian noise.

        NaN where nothing was measured.
        """
        return weights(self._plan)

    @property
    def log_evidence(self) -> Array:
        """The log-evidence ln p(measurements), in nats, (...): a sum of log-densities by step."""
        total: Array = self._swept.log_density.sum(axis=0)
        return total.reshape(self._lead)

    @property
    def log_evidence_kind(self) -> str:
        """The kind of `log_evidence`, one of those that the class lists, such as ``exact``."""
        settled = bool(self.status.converged.all())
        return evidence_kind(self._planned, fixed=settled and self.kind == SMOOTHED)

    @cached_property
    def _reverse(self) -> Reverse:
        """The reversed chain p(x[t] | x[t + 1], measurements up to t).

        If the passes have made it, it is theirs; else it is made here, when first asked for.
        """
        return self._reverse_given or Reverse.make(self._plan, self._forward)

    @cached_property
    def _backward_messages(self) -> canonical.Canonical:
        """The canonical messages p(measurements after t | states at t), (T+1, runs, ...)."""
        return backward_messages(self._plan, self._forward)

    @quiet()
    def joint(self, *variables: Variable) -> Gaussian:
        """The joint belief of hidden variables at any steps.

        It knows the measurements that the belief at the latest of the steps knows: after filtering
        those up to that step, after smoothing all of them, as `kind` says.

        Parameters
        ----------
        *variables : Variable
            Concrete ones, ``x.at(3)``, in the order of the result.

        Returns
        -------
        Gaussian
            (*runs, n), without steps.

        Raises
        ------
        EvidenceError, ModelError
            If one is not hidden, has no such step or stands twice, or none is given.
        GraphError
            If the covariance, of all runs together, would not fit in memory.
        NumericalError
            If windows of an iterated fixed lag were solved in twice the digits.
        """
        require_at_steps(self.graph.layout, variables, self.graph.steps)
        size = sum(variable.dimension for variable in variables)
        what = f"the joint of {len(variables)} variables, {size} components in all,"
        require_runs(size * size, self._planned.runs, what)
        if self._careful is not None:
            return self._careful_joint(self._careful, tuple(variables))
        if self._windows is not None and not self._windows.plain:
            raise NumericalError(
                "joints of an iterated fixed lag are not kept where windows of it were solved in "
                "twice the digits; posterior[x] has marginals, pgm.smooth and pgm.filter joints"
            )
        mean, cov = joint_moments(self._reverse, self._beliefs, self.graph.layout, variables)
        shape = self._plan.lead
        return Gaussian._make(
            tuple(variables),
            mean.reshape(*shape, -1),
            cov.reshape(*shape, *cov.shape[1:]),
        )

    @quiet()
    def sample(self, count: int, rng: np.random.Generator) -> dict[Variable, Array]:
        """So many trajectories for each run: (count, *runs, steps, d) by hidden variable.

        A NumericalError is raised if a belief has no finite root.
        """
        require_smoothed(self.kind)
        found = draws(self, count, rng)
        if not np.isfinite(found).all():
            raise NumericalError(
                "there are no draws of a belief that is infinite, as under a flat prior that no "
                "measurement bounds, or whose covariance is none; give its variables finite "
                "variances"
            )
        layout, shape = self.graph.layout, (count, *self._lead)
        drawn: dict[Variable, Array] = {}
        for variable in self._hidden:
            first = 0 if variable in layout.states else 1
            own = np.moveaxis(found[first:, ..., layout.places[variable]], (2, 1), (0, 1))
            drawn[variable] = own.reshape(*shape, *own.shape[2:])
        return drawn

    @cached_property
    def _careful_slices(self) -> Sequence[Smooth] | None:
        """The beliefs over the slices given all measurements, in twice the digits, one a step.

        None if the pass was in float64, or did not smooth.
        """
        if self._careful is None or self.kind != SMOOTHED:
            return None
        return adjoint.smoothed(self._careful, self.graph.steps)

    def _careful_joint(self, careful: Careful, variables: Scope) -> Gaussian:
        """The joint of hidden variables, each with a step, from the pass in twice the digits.

        `careful` is the forward pass. The joint of the S distinct steps' slices has means
        (runs, S n), n components a slice; the variables' components are cut out of it, in the order
        given.
        """
        steps = [variable.step for variable in variables if variable.step is not None]
        distinct = sorted(set(steps))
        last = self.kind.last(distinct[-1], self.graph.steps)
        slices = self._careful_slices
        if slices is None:
            slices = adjoint.smoothed(careful, last, distinct[0])
        mean, cov = adjoint.joint(careful, distinct, slices)
        if self.kind == SMOOTHED:  # a step control may have kept other means
            mean = np.concatenate(list(self._beliefs.mean[distinct]), axis=-1)
        layout, size = self.graph.layout, self.graph.layout.slice_size
        wanted = np.concatenate(
            [
                distinct.index(step) * size + np.arange(size)[layout.places[variable.template]]
                for step, variable in zip(steps, variables, strict=True)
            ]
        )
        shape = self._plan.lead
        mean, cov = mean[:, wanted], block(cov, wanted, wanted)
        return Gaussian._make(
            variables, mean.reshape(*shape, -1), cov.reshape(*shape, *cov.shape[1:])
        )

    @quiet()
    def message(self, source: int | Cluster, target: int | Cluster) -> CanonicalForm:
        """The message from one cluster to a neighbour, over their sepset, unnormalised.

        Parameters
        ----------
        source, target : int or Cluster

        Returns
        -------
        CanonicalForm
            Its g includes the log-density of the measurements that went into the message.

        Raises
        ------
        GraphError
            If the clusters are not joined, or the message was not sent: backward messages are
            those of smoothing alone.
        NumericalError
            If the message has no canonical form.
        """
        source, target = self.graph.index(source), self.graph.index(target)
        scope = self.graph.sepsets[source, target]
        if source < target:
            parts = self._past(source)
        elif self.kind == SMOOTHED:
            K, h, g = self._backward_messages
            parts = K[target], h[target], g[target]
        else:
            raise self._unsent(source, target)
        what = f"the message from cluster {source} to {target}"
        return self._form(scope, parts, what, source)

    def _unsent(self, source: int, target: int) -> GraphError:
        """The error for a backward message that the schedule does not send."""
        return GraphError(
            f"the message from cluster {source} to {target} was not sent, since the posterior "
            f"is {self.kind}: smoothing sends it; use pgm.smooth, or schedule=pgm.Smoothing()",
            cluster=source,
        )

    def _weight(self, step: int) -> Array:
        """The log-evidence of the measurements that the belief at a step knows, (runs,).

        By `kind` these are the measurements up to the step, up to a lag after it, or all.
        """
        last = self.kind.last(step, self.graph.steps)
        weight: Array = self._forward.log_density[: last + 1].sum(axis=0)
        return weight if self._windows is None else self._windows.log_evidence[last]

    def _past(self, step: int) -> canonical.Canonical:
        """The forward message of a step: p(states at t, measurements up to t) as (K, h, g).

        Its arrays are (runs, ...).
        """
        places = self.graph.layout.state_places
        weight = self._forward.log_density[: step + 1].sum(axis=0)
        mean = self._forward.mean[step][:, places]
        cov = block(self._forward.cov[step], places, places)
        return canonical.from_moments(mean, cov, weight)

    @quiet()
    def belief(self, cluster: int | Cluster) -> CanonicalForm:
        """The belief of a cluster over its hidden variables, unnormalised.

        Parameters
        ----------
        cluster : int or Cluster

        Returns
        -------
        CanonicalForm
            Its integral is the evidence that its messages know: all of it after smoothing.

        Raises
        ------
        GraphError
            If there is no such cluster.
        NumericalError
            If the belief has no canonical form, since its covariance is singular.
        """
        step = self.graph.index(cluster)
        layout, beliefs = self.graph.layout, self._beliefs
        weight = self._weight(step)
        if step:
            scope: Scope = tuple(variable.at(step) for variable in layout.pair)
            if self._careful is None and (self._windows is None or self._windows.plain):
                pair = backward.pairs(beliefs, self._reverse, step - 1)
                mean, cov = pair.mean, pair.cov
            else:
                joint = self.joint(*scope)
                runs, size = self._plan.runs, joint.mean.shape[-1]
                mean, cov = joint.mean.reshape(runs, size), joint.cov.reshape(runs, size, size)
            parts = canonical.from_moments(mean, cov, weight)
        else:
            places = layout.state_places
            scope = tuple(variable.at(0) for variable in layout.states)
            parts = canonical.from_moments(
                beliefs.mean[0][:, places], block(beliefs.cov[0], places, places), weight
            )
        return self._form(scope, parts, f"the belief of cluster {step}", step)

    @cached_property
    def _potentials(self) -> canonical.Canonical:
        """The potentials of clusters 1..T in canonical form, (T, runs, ...)."""
        return potentials(self._plan, self._forward)

    @quiet()
    def potential(self, cluster: int | Cluster) -> CanonicalForm:
        """The potential of a cluster: its CPDs as they were linearised, with their evidence.

        Parameters
        ----------
        cluster : int or Cluster

        Returns
        -------
        CanonicalForm
            Over the cluster's hidden variables.

        Raises
        ------
        GraphError
            If there is no such cluster.
        NumericalError
            If it has no canonical form, since a noise is singular.
        """
        step, layout = self.graph.index(cluster), self.graph.layout
        if step:
            scope: Scope = tuple(variable.at(step) for variable in layout.pair)
            K, h, g = self._potentials
            parts = K[step - 1], h[step - 1], g[step - 1]
        else:
            scope = tuple(variable.at(0) for variable in layout.states)
            parts = first_potential(self._plan, self._forward)
        return self._form(scope, parts, f"the potential of cluster {step}", step)

    def _form(
        self, scope: Scope, parts: canonical.Canonical, what: str, cluster: int
    ) -> CanonicalForm:
        """A canonical form for a user, with the leading axes of runs, from (K, h, g), (runs, ...).

        Where g is NaN, a covariance was singular, and the form does not exist: a NumericalError
        says that `what`, such as "the belief of cluster 3", has none, and carries the number
        `cluster`.
        """
        if np.isnan(parts[2]).any():
            raise NumericalError(
                f"{what}, over {names(scope)}, has no canonical form: its covariance, or that of "
                "what it is made of, is singular; posterior[...] and joint(...) have its moments",
                cluster=cluster,
                step=cluster if cluster <= self.graph.steps else None,
            )
        lead = self._plan.lead
        return CanonicalForm._make(
            scope, *(part.reshape((*lead, *part.shape[1:])) for part in parts)
        )

    def _doubt(self) -> str:
        return doubts.doubt(held=doubts.is_held(self))

    @quiet()
    def _misfit(self) -> str:
        return doubts.misfit(self)

    @property
    def _title(self) -> str:
        runs = f", runs {self._planned.lead}" if self._planned.lead else ""
        return f"Posterior({self.kind}, steps 0..{self.graph.steps}{runs})"

    def _summary(self) -> Summary:
        hidden, last = self.graph.layout.slice, self.graph.steps
        told = [f"{v!r}: {found._title}" for v, found in self.rejected.items()]
        told += doubts.told(self)
        return over_time(self._title, self, hidden, self._planned.lead, last, told)
