"""The results of inference on a chain of tables: beliefs over time, joints, messages.

The *slice* of a step is its hidden variables: states, and controls, which the next slice does not
depend on. Arrays inside are (*states, *runs): an axis for each variable of the slice, then one of
runs, or none where the user gave none; (sizes..., [runs]) are over some of the variables. Entries
are numbers or logarithms, as the *semiring* of the chain has them. Cluster 0 has the states of step
0, cluster t the states of step t − 1 and the slice of step t. The last step is T.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from pgm.beliefs.markov.chain import TINY, StateChain
from pgm.beliefs.markov.draws import draws
from pgm.beliefs.markov.impossible_runs import blank, blanked
from pgm.beliefs.markov.joints import joint, pair, potential
from pgm.beliefs.markov.left_out import left_out
from pgm.beliefs.markov.marginals import Beliefs, PredictedStates, StateMarginals
from pgm.beliefs.markov.measurements import unread
from pgm.beliefs.markov.plan import SlicePlan, TableSlices
from pgm.beliefs.markov.shown_slices import ShownTables
from pgm.clustergraph import Cluster
from pgm.compile import DynamicGraph
from pgm.display import Summary
from pgm.errors import GraphError
from pgm.factors import GaussianMixture, Table
from pgm.factors.axes import discrete, require_axes, sizes
from pgm.factors.scope import Scope
from pgm.kernels.arrays import Array, Integers, frozen
from pgm.posteriors.belief_kind import FILTERED, PREDICTED, SMOOTHED, Kind, require_smoothed
from pgm.posteriors.hidden import measured, require_at_steps
from pgm.posteriors.left_out import LeftOut, require_all
from pgm.posteriors.measurements import as_read, no_readings
from pgm.posteriors.outcome import SLICES, Outcome
from pgm.posteriors.shown_slices import Room
from pgm.posteriors.status import Status
from pgm.posteriors.summaries import over_time
from pgm.schedules.limits import require_runs
from pgm.variables import Variable


@dataclass(frozen=True, eq=False, repr=False)
class StateOutcome(Outcome[Table]):
    """The beliefs of a chain of tables after a schedule of messages.

    ``posterior[x]`` is a stacked `Table` with the user's axes of runs, then one of steps: 0..T for
    a state, 1..T for a hidden control; ``posterior[x.at(3)]`` is the table of one step.

    With ``impossible="allow"``, a run whose measurements have probability zero has a log-evidence
    of −∞ and NaN for each belief, joint or message that knows the first impossible one: filtered
    beliefs before its step stay, smoothed ones are NaN at all steps. `potential` is of the evidence
    as it was given.

    Attributes
    ----------
    graph : DynamicGraph
    status : Status
        Tables need no iterations.
    kind : Kind
        Which measurements the beliefs know: filtered, fixed-lag or smoothed.

    Examples
    --------
    >>> from pgm.examples import rain, still, wet
    >>> posterior = pgm.filter(still, {wet: [1, 1]})
    >>> posterior[rain].probabilities
    array([[0.5 , 0.5 ],
           [0.25, 0.75],
           [0.1 , 0.9 ]])
    >>> posterior[rain.at(2)]
    Table(rain[2]: no 0.1, yes 0.9)
    >>> posterior.joint(rain.at(0), rain.at(1))
    Table(rain[0], rain[1]) of (2, 2) states
      rain[0]  rain[1]: no   yes
      no              0.25     0
      yes                0  0.75
    >>> posterior.message(0, 1)
    Table(rain[0]: no 0.5, yes 0.5)
    >>> posterior.belief(2).normalised().marginal(rain.at(2))
    Table(rain[2]: no 0.1, yes 0.9)
    """

    beliefs: ClassVar[str] = "tables"
    form: ClassVar[str] = SLICES

    graph: DynamicGraph
    status: Status
    kind: Kind
    _plan: SlicePlan
    _chain: StateChain

    @property
    def _slices(self) -> TableSlices:
        found: Any = self._chain.slices
        return found  # type: ignore[no-any-return]

    @property
    def _hidden(self) -> Scope:
        return (*self.graph.model.states, *self.graph.model.controls)

    @property
    def _lead(self) -> tuple[int, ...]:
        return self._chain.slices.lead

    def slices(self, span: range, room: Room) -> ShownTables:
        """The slices of these steps, as a page shows them."""
        return ShownTables(self, span, room)

    def __getitem__(self, variable: Variable) -> Any:
        """The marginal of a hidden variable, at one step or at all.

        A measurement that was not taken has a belief, too: a table, or a mixture of Gaussians if it
        is continuous. Any other variable raises EvidenceError.
        """
        if measured(self.graph.layout, variable) is not None:
            return unread(self._plan, self._slices.bound, variable, self._beliefs)
        return self._marginals(self._beliefs, self.kind)[variable]

    def _readings_of(self, variable: Variable) -> tuple[Integers, Array]:
        bound = self._slices.bound
        reading = next((each for each in bound.readings if each.cpd.child == variable), None)
        if reading is None:
            return no_readings(variable, bound.lead)
        marked = np.where(reading.taken, reading.values, np.nan)
        return as_read(reading.step, reading.order, marked, bound.lead)

    def _marginals(self, beliefs: Beliefs, kind: Kind) -> StateMarginals:
        return StateMarginals(self._plan, beliefs, self._lead, kind)

    @property
    def _lost(self) -> Integers | None:
        """The step, ([runs]), from which on measurements are impossible; None if all are possible.

        It is T + 1 in runs whose measurements are all possible.
        """
        return self._slices.lost

    def _blanked(self, beliefs: Beliefs, kind: Kind) -> Beliefs:
        """Beliefs of a kind by step, with NaN where they know an impossible measurement."""
        return blanked(beliefs, self._lost, kind, self.graph.steps)

    @cached_property
    def _beliefs(self) -> Beliefs:
        """The beliefs over the slice by step, (*states, *runs) each, of the posterior's kind."""
        if self.kind == FILTERED:
            return self._filtered
        chain = self._chain
        if self.kind == SMOOTHED:
            return self._blanked(chain.smoothed_beliefs(), self.kind)
        return self._blanked(chain.gathered(chain.lagged(int(self.kind.lag))), self.kind)

    @cached_property
    def _filtered(self) -> Beliefs:
        """The filtered beliefs over the slice by step, (*states, *runs) each, as probabilities."""
        chain = self._chain
        found = chain.known if chain.semiring.linear else [*map(chain.numbers, chain.known)]
        return self._blanked(found, FILTERED)

    @cached_property
    def left_out(self) -> LeftOut:
        """The beliefs of readings given all but their own, by sensor."""
        require_all(self.kind)
        sensors = [weights.cpd.child for weights in self._slices.weights]
        return LeftOut(sensors, self._left_out_of)

    def _left_out_of(self, variable: Variable) -> Table | GaussianMixture:
        return self._each_left_out[variable]

    @cached_property
    def _each_left_out(self) -> dict[Variable, Table | GaussianMixture]:
        """The beliefs of readings given all but their own, of all sensors by one pass back."""
        return left_out(self._plan, self._chain)

    @property
    def filtered(self) -> StateMarginals:
        """Marginals given the measurements up to each step."""
        return self._marginals(self._filtered, FILTERED)

    @cached_property
    def predicted(self) -> PredictedStates:
        """Beliefs of hidden variables and of measurements, given those before each step."""
        chain = self._chain
        found = [chain.start()]
        found += [chain.predict(k + 1, belief) for k, belief in enumerate(chain.known[:-1])]
        beliefs = self._blanked([*map(chain.numbers, found)], PREDICTED)
        return PredictedStates(self._plan, beliefs, self._lead, PREDICTED, self._slices.bound)

    @cached_property
    def log_evidence(self) -> Array:
        """The value ln p(measurements), with the user's axes of runs."""
        return frozen(np.asarray(self._chain.log_density.sum(axis=0)).reshape(self._lead))

    @property
    def log_evidence_kind(self) -> str:
        """The kind of `log_evidence`: always ``"exact"``."""
        return "exact"

    def joint(self, *variables: Variable) -> Table:
        """The joint of hidden variables at steps, ``x.at(3)``.

        It is given the measurements that the belief at the latest of these steps knows.

        Raises
        ------
        EvidenceError
            If no variable is given, or a variable is not hidden, has no step, or is not in the
            model at its step.
        ModelError
            If a variable is given twice.
        GraphError
            If the table, or a table on the way to it, would not fit memory, or has more axes than
            NumPy's arrays.
        """
        scope = discrete(require_at_steps(self.graph.layout, variables, self.graph.steps))
        # Arrays on the way hold those of earlier slices, and the whole of the last one.
        end = max(variable.step or 0 for variable in scope)
        before = discrete(tuple(v for v in scope if v.step != end))
        entries = math.prod((*sizes(before), *self._plan.shape))
        require_runs(entries, self._slices.bound.runs, f"the joint of {len(scope)} variables")
        widest = self._plan.widest(len(before))
        require_axes((*before, *widest), "the joint", "ask for fewer at once, or ")
        values = joint(self._chain, self._plan, scope, self.kind)
        values = blank(values, self._lost, self.kind.last(end, self.graph.steps))
        return Table._plain(scope, frozen(self._over_runs(values, len(scope))))

    def sample(self, count: int, rng: np.random.Generator) -> dict[Variable, Integers]:
        """So many paths for each run: (count, *runs, steps) of state indices by hidden variable."""
        require_smoothed(self.kind)
        drawn = draws(self, count, rng)
        return {
            v: np.moveaxis(own, 0, -1).reshape(count, *self._lead, len(own))
            for v, own in drawn.items()
        }

    def _over_runs(self, values: Array, axes: int) -> Array:
        """Values (sizes..., [runs]) with the user's axes of runs first; `axes` counts the sizes."""
        if not self._lead:
            return values
        return np.moveaxis(values, -1, 0).reshape(*self._lead, *values.shape[:axes])

    def message(self, source: int | Cluster, target: int | Cluster) -> Table:
        """The message from one cluster to a neighbour, over their sepset, unnormalised.

        Its log-scale carries the evidence that went into it. Backward messages, from a later
        cluster to an earlier one, are sent by smoothing alone; without it they raise GraphError.
        Later measurements may favour states that are impossible given the measurements up to a
        step. Where they do so by so much that the entries of possible states would be too small for
        float64, the backward message has zeros for the impossible states.
        """
        source, target = self.graph.index(source), self.graph.index(target)
        scope = discrete(self.graph.sepsets[source, target])
        step = min(source, target)
        runs = self._slices.bound.runs
        if source < target:
            values = self._states(self._filtered[step])
            weight = self._weight(step)
            return self._table(scope, values, weight)
        if self.kind != SMOOTHED:
            raise GraphError(
                f"the message from cluster {source} to {target} was not sent, since the posterior "
                f"is {self.kind}: smoothing sends it; use pgm.smooth, or schedule=pgm.Smoothing()",
                cluster=source,
            )
        with np.errstate(invalid="ignore"):
            plain = self._message_back(step, self._chain.message)
        values, rest = self._scaled_back(step, plain)
        return self._table(scope, values, np.broadcast_to(rest, runs))

    def _scaled_back(self, step: int, message: Array) -> tuple[Array, Array]:
        """The backward message to a step as values, (sizes..., [runs]), and its log-scale.

        p(later measurements | states) is the values, whose largest is one, times exp(log-scale);
        the log-scale is (*runs). `message`, (*states, *runs), is the same message up to a factor.
        Where later measurements favour impossible states so strongly that the possible states'
        entries would be too small for numbers, the message is made anew, with zeros for the
        impossible states.
        """
        chain = self._chain
        with np.errstate(invalid="ignore"):  # 0/0, where numbers hold none of the states
            message, found, top = self._sized(step, message)
        if not (chain.numbers(chain.semiring.over(found, top)) > TINY).all():
            message, found, top = self._sized(step, self._message_back(step, chain.back))
        message = self._states(chain.numbers(chain.semiring.over(message, top)), total=False)
        later = np.asarray(chain.log_density[step + 1 :].sum(axis=0)).reshape(-1)
        if self._lost is not None:  # NaN times a finite scale is NaN
            later = np.where(self._lost > self.graph.steps, later, 0.0)
        rest = later - chain.semiring.logs(found) + chain.semiring.logs(top)
        return blank(message, self._lost, self.graph.steps), rest

    def messages_back(self) -> Iterator[tuple[Array, Array]]:
        """The backward messages to the slices T, T − 1, .., 0, each made from the last one yielded.

        Each is a pair: values over the states of the slice, (sizes..., [runs]), the largest of them
        one, and a log-scale (*runs): p(later measurements | states) is values times exp(log-scale).
        """
        chain, last = self._chain, self.graph.steps
        plain = chain.unit()
        # Nothing is later than the last slice: one for each of its states, its controls apart.
        runs = plain.shape[len(self._plan.shape) :]
        unit = np.ones((*sizes(self._plan.states), *runs))
        yield blank(unit, self._lost, last), np.zeros(runs)
        for step in range(last - 1, -1, -1):
            with np.errstate(invalid="ignore"):
                plain = chain.message(step, plain)
            yield self._scaled_back(step, plain)

    def _sized(self, step: int, message: Array) -> tuple[Array, Array, Array]:
        """A backward message to the slice of a step, with two numbers to scale it by.

        Returns three, in entries of the chain's semiring: `message`, (*states, *runs), as it is;
        the sum over the states of its product with the filtered belief, (*runs); and its largest
        entry, (*runs).
        """
        chain = self._chain
        found = chain.total(chain.semiring.times(chain.known[step], message))
        return message, found, message.max(axis=tuple(range(message.ndim - chain.batch)))

    def _message_back(self, step: int, passed: Callable[[int, Array], Array]) -> Array:
        """The message to the slice of a step, (*states, *runs), from measurements after the step.

        It takes in the measurements that a belief of the posterior's kind at this step knows.
        ``passed(step, message)`` makes the message to a step from that to the next one.
        """
        chain = self._chain
        last = self.kind.last(step, self.graph.steps)
        message = np.full(chain.known[last].shape, chain.semiring.one)
        for before in range(last - 1, step - 1, -1):
            message = passed(before, message)
        return message

    def _states(self, values: Array, *, total: bool = True) -> Array:
        """Values over a slice, (*states, *runs), without the axes of controls.

        With `total` these axes are summed; without it they have length one, and are dropped.
        """
        axes = self._plan.controls
        if not axes:
            return values
        found: Array = values.sum(axis=axes) if total else values.squeeze(axes)
        return found

    def _weight(self, step: int) -> Array:
        """The value ln p of the measurements up to a step, (runs,)."""
        return np.asarray(self._chain.log_density[: step + 1].sum(axis=0)).reshape(-1)

    def belief(self, cluster: int | Cluster) -> Table:
        """The belief of a cluster over its hidden variables, unnormalised.

        Its sum is the probability of the measurements that its messages know: of all of them after
        smoothing. A belief too large for memory raises GraphError.
        """
        step, plan = self.graph.index(cluster), self._plan
        last = self.kind.last(step, self.graph.steps)
        weight = self._weight(last)
        message = self._message_back(step, self._chain.back)
        if not step:
            values = self._states(self._chain.posterior(0, message))
            values = blank(values, self._lost, last)
            scope = discrete(tuple(v.at(0) for v in plan.states))
            return self._table(scope, values, weight)
        entries = math.prod((*sizes(plan.states), *plan.shape))
        require_runs(entries, self._slices.bound.runs, f"the belief of cluster {step}")
        values = blank(pair(self._chain, plan, step, message), self._lost, last)
        scope = discrete(tuple(v.at(step) for v in self.graph.layout.pair))
        return self._table(scope, values, weight)

    def potential(self, cluster: int | Cluster) -> Table:
        """The potential of a cluster: the product of its tables, with their evidence put in.

        It is over the states of the step before and the slice; that of cluster 0 is over its
        states. A potential too large for memory raises GraphError.
        """
        step, plan, chain = self.graph.index(cluster), self._plan, self._chain
        if step:
            entries = math.prod((*sizes(plan.states), *plan.shape))
            require_runs(entries, self._slices.bound.runs, f"the potential of cluster {step}")
        values, weights, log_scale = potential(chain, plan, step)
        if weights is not None:
            values = chain.semiring.times(values, weights)
        if not step:
            values = self._states(values, total=False)
        # Zero throughout where a measurement is impossible, whatever was before.
        top = chain.semiring.divisor(values.max(axis=tuple(range(values.ndim - chain.batch))))
        values = chain.numbers(chain.semiring.over(values, top))
        scale = np.broadcast_to(log_scale + chain.semiring.logs(top), self._slices.bound.runs)
        scope = self.graph.layout.pair if step else plan.states
        return self._table(discrete(tuple(v.at(step) for v in scope)), values, scale)

    def _table(self, scope: Any, values: Array, weight: Array) -> Table:
        """An unnormalised table: values (sizes..., [runs]) times exp(weight), weight (runs,)."""
        scale = weight.reshape(self._lead) if self._lead else weight.reshape(())
        return Table._make(scope, self._over_runs(values, len(scope)), scale)

    @property
    def _title(self) -> str:
        runs = f", runs {self._lead}" if self._lead else ""
        return f"Posterior({self.kind}, steps 0..{self.graph.steps}{runs})"

    def _summary(self) -> Summary:
        hidden, last = self.graph.layout.slice, self.graph.steps
        return over_time(self._title, self, hidden, self._lead, last)
