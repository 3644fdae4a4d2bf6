"""Results of inference in a chain of discrete and continuous variables: tables, and mixtures."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from pgm.beliefs.hypotheses.back import BackwardChain
from pgm.beliefs.hypotheses.cases import Given
from pgm.beliefs.hypotheses.draws import draws
from pgm.beliefs.hypotheses.forward import again
from pgm.beliefs.hypotheses.innovations import innovations
from pgm.beliefs.hypotheses.left_out import without_each
from pgm.beliefs.hypotheses.measurements import Members, is_chosen, measurement, unread
from pgm.beliefs.hypotheses.records import Asked
from pgm.beliefs.hypotheses.regimes import Regimes
from pgm.compile import DynamicGraph, SliceLayout
from pgm.display import NoArray, Shown, Summary
from pgm.errors import EvidenceError, NumericalError, Unanswered
from pgm.evidence import BoundEvidence
from pgm.factors import Gaussian, GaussianMixture, Table
from pgm.factors.axes import discrete
from pgm.factors.scope import Scope, as_scope, listed, positions
from pgm.kernels.arrays import Array, Integers, frozen, quiet
from pgm.posteriors.associations import Found
from pgm.posteriors.belief_kind import FILTERED, PREDICTED, SMOOTHED, Kind, require_smoothed
from pgm.posteriors.hidden import located, measured
from pgm.posteriors.innovations import BySensor
from pgm.posteriors.left_out import LeftOut, require_all
from pgm.posteriors.measurements import as_read, no_readings
from pgm.posteriors.outcome import QUESTIONS, SWITCHING, Outcome
from pgm.posteriors.status import Status
from pgm.posteriors.summaries import marginals_over_time, over_time
from pgm.schedules.options import Call
from pgm.variables import Discrete, Variable


@dataclass(frozen=True, eq=False)
class Beliefs:
    """The beliefs of a mixed chain's steps 0..T.

    Attributes
    ----------
    kind : Kind
        Which measurements they know.
    hidden : tuple of Variable
        The continuous variables, in the order of a slice.
    weights : ndarray
        Those of the K Gaussians, (T+1, K, runs).
    mean, cov : ndarray
        (T+1, K, runs, n) and (T+1, K, runs, n, n).
    regimes : ndarray
        The probabilities of the S regimes, (T+1, S, runs).
    """

    kind: Kind
    hidden: Scope
    weights: Array
    mean: Array
    cov: Array
    regimes: Array

    @classmethod
    def of(
        cls,
        kind: Kind,
        hidden: Scope,
        logs: Array,
        means: Array,
        covs: Array,
        regimes: Array,
    ) -> Beliefs:
        """The beliefs of all steps, of log-weights and log-probabilities."""
        weights = np.exp(logs)
        some = (weights > 0.0).any(axis=(0, 2))
        weights = weights[:, some]
        weights /= weights.sum(axis=1, keepdims=True)
        shares = np.exp(regimes)
        shares /= shares.sum(axis=1, keepdims=True)
        return cls(kind, hidden, weights, means[:, some], covs[:, some], shares)


@dataclass(frozen=True, eq=False)
class Marginals:
    """Tables and mixtures of a mixed chain's variables, read from its beliefs.

    Attributes
    ----------
    layout : SliceLayout
        Of the network.
    beliefs : Beliefs
    regimes : Regimes
    """

    layout: SliceLayout
    beliefs: Beliefs
    regimes: Regimes

    def of(
        self, shown: Scope, scope: Scope, step: int | slice, lead: tuple[int, ...]
    ) -> Table | GaussianMixture:
        """The joint of discrete variables, or of continuous ones, at one step or at several.

        `scope` are the variables as templates, and `shown` as they stand in what is found; `lead`
        are the user's axes of runs. Variables of both kinds are an EvidenceError.
        """
        kinds = {isinstance(v, Discrete) for v in scope}
        if len(kinds) > 1:
            raise EvidenceError(
                f"a joint of discrete and continuous variables, {list(shown)}, is neither a table "
                "nor a mixture; ask for each kind by itself",
                variable=shown[0],
            )
        alone = not isinstance(step, slice)
        rows = step if isinstance(step, slice) else slice(step, step + 1)

        def over_runs(values: Array) -> Array:
            """Values (runs, steps, ...) with the user's axes; of one step without its axis."""
            whole = values.reshape(*lead, *values.shape[1:])
            return whole[(slice(None),) * len(lead) + (0,)] if alone else whole

        if kinds.pop():
            return Table._plain(discrete(shown), frozen(over_runs(self._table(scope, rows))))
        own = self.beliefs
        places = np.arange(own.mean.shape[-1])[positions(own.hidden, scope)]
        weights = np.moveaxis(own.weights[rows], -1, 0)
        mean = np.moveaxis(own.mean[rows][..., places], 2, 0)
        cov = np.moveaxis(own.cov[rows][..., places[:, None], places], 2, 0)
        some = (weights > 0.0).any(axis=(0, 1))
        weights, mean, cov = (over_runs(part[:, :, some]) for part in (weights, mean, cov))
        last = len(own.weights)
        steps = None if alone else np.arange(last)[rows]
        return GaussianMixture._make(weights, Gaussian._make(shown, mean, cov), steps)

    def _table(self, scope: Scope, rows: slice) -> Array:
        """The probabilities of discrete variables, (runs, steps, sizes...)."""
        regimes, shares = self.regimes, self.beliefs.regimes[rows]
        lead = shares.shape[-1], len(shares)
        values = np.moveaxis(shares, -1, 0).reshape(*lead, *regimes.shape)
        order = [regimes.variables.index(v) for v in discrete(scope)]
        others = tuple(k + 2 for k in range(len(regimes.shape)) if k not in order)
        left = sorted(order)
        axes = [2 + left.index(k) for k in order]
        return np.moveaxis(values.sum(axis=others), axes, range(2, 2 + len(order)))


@dataclass(frozen=True, eq=False)
class Predicted(Shown, NoArray):
    """Tables and mixtures given the measurements before each step, of measurements too.

    `kind` is that of predictions; `given` and `members` are the evidence and the Gaussians of the
    forward pass, `marginals` their marginals.
    """

    kind: Kind
    given: Given
    members: Members
    marginals: Marginals
    lead: tuple[int, ...]

    def __getitem__(self, variable: Variable) -> Table | GaussianMixture:
        """The marginal of a hidden variable, or the belief of a measurement, by row or of one."""
        layout = self.marginals.layout
        if measured(layout, variable) is not None:
            return measurement(layout, self.given, self.marginals.regimes, self.members, variable)
        template, first = located(layout, variable, self.last)
        rows = slice(first, None) if variable.step is None else variable.step
        return self.marginals.of((variable,), (template,), rows, self.lead)

    @property
    def last(self) -> int:
        """The last step."""
        return len(self.members.logs) - 1

    @property
    def _title(self) -> str:
        runs = f", runs {self.lead}" if self.lead else ""
        return f"Marginals({self.kind}, steps 0..{self.last}{runs})"

    def _summary(self) -> Summary:
        layout = self.marginals.layout
        return marginals_over_time(self._title, self, layout, self.lead, self.last)


@dataclass(frozen=True, eq=False, repr=False)
class HypothesisOutcome(Outcome[Any]):
    """The beliefs of a chain of discrete and continuous variables; leading axes are runs.

    ``posterior[v]`` is a `Table` of a discrete variable, with the user's axes of runs, then one of
    steps; and a `GaussianMixture` of a continuous one, with the same axes. The kind of log-evidence
    is ``merged``, exact but for what was merged and linearised; with robust noise ``bound``, or
    ``linearised bound``.
    """

    beliefs: ClassVar[str] = "mixtures of a mixed chain"
    silent: ClassVar[str] = "mixtures go from slice to slice, and no messages are kept"
    moving: ClassVar[bool] = True
    form: ClassVar[str] = SWITCHING

    graph: DynamicGraph
    status: Status
    log_evidence: Array
    log_evidence_kind: str
    _beliefs: Beliefs
    _regimes: Regimes
    associations: Found
    # What was asked, by which it may be asked again.
    _asked: tuple[BoundEvidence, Call, Asked]
    # The forward pass of a smoother; None of a filter, which is one.
    _forward: HypothesisOutcome | None = None

    @property
    def kind(self) -> Kind:
        """Which measurements the beliefs know."""
        return self._beliefs.kind

    @property
    def filtered(self) -> HypothesisOutcome:
        """The beliefs of the forward pass; of a filter, the same."""
        return self if self._forward is None else self._forward

    @property
    def _lead(self) -> tuple[int, ...]:
        return np.shape(self.log_evidence)

    @property
    def _hidden(self) -> Scope:
        return (*self.graph.model.states, *self.graph.model.controls)

    def __getitem__(self, variable: Variable) -> Table | GaussianMixture:
        """The marginal of a hidden variable, or of a measurement not taken, by step or of one."""
        if measured(self.graph.layout, variable) is not None:
            return self._unread(variable)
        return self._of((variable,))

    @quiet()
    def _unread(self, variable: Variable) -> Table | GaussianMixture:
        """The belief of a measurement that was not taken, given all that the beliefs know."""
        own, backward = self._beliefs, self._forward_for("predicted")
        members = self._by_regime if is_chosen(self.graph.layout, variable) else None
        if members is None:
            with np.errstate(divide="ignore"):
                logs, regimes = np.log(own.weights), np.log(own.regimes)
            members = Members(logs, own.mean, own.cov, regimes, None)
        given = backward.chain.given
        return unread(self.graph.layout, given, self._regimes, members, variable)

    @cached_property
    def _by_regime(self) -> Members | None:
        """The Gaussians of each step, each of one regime; None of a fixed lag, which has none."""
        backward = self._forward_for("predicted")
        if self.kind == FILTERED:
            return Members.filtered(backward.chain)
        return Members.smoothed(backward) if self.kind == SMOOTHED else None

    @cached_property
    @quiet()
    def innovations(self) -> BySensor:
        """The innovations of each continuous sensor with evidence: of the mixture of Gaussians."""
        chain = self._forward_for("innovations").chain
        members = Members.predicted(chain)
        return BySensor(
            {
                reading.cpd.child: innovations(chain.given, chain.regimes, members, reading)
                for reading in chain.given.bound.readings
                if not reading.cpd.discrete
            }
        )

    @cached_property
    def left_out(self) -> LeftOut:
        """The beliefs of readings given all but their own, by sensor."""
        require_all(self.kind)
        self._forward_for("left_out")
        bound, *_ = self._asked
        return LeftOut([reading.cpd.child for reading in bound.readings], self._left_out_of)

    @quiet()
    def _left_out_of(self, variable: Variable) -> Table | GaussianMixture:
        bound, call, asked = self._asked

        def smoothed(some: BoundEvidence) -> tuple[Given, Members]:
            """The evidence and the Gaussians of a smoother of other evidence."""
            backward = again(self.graph, some, call, asked)
            return backward.chain.given, Members.smoothed(backward)

        place = [reading.cpd.child for reading in bound.readings].index(variable)
        return without_each(self.graph.layout, self._regimes, bound, place, smoothed)

    def _forward_for(self, question: str) -> BackwardChain:
        """The forward pass that was kept for a pass back, which one of `QUESTIONS` is asked of.

        One of Gaussians that were cut or drawn is refused, since it has none.
        """
        *_, asked = self._asked
        if asked.prune or asked.pieces > 1:
            raise Unanswered(
                f"{QUESTIONS[question][0]}: a prior cut into pieces (starts=) and Gaussians that "
                "are drawn (draws=) keep no pass for them; leave these options out"
            )
        return self._backward

    @cached_property
    @quiet()
    def predicted(self) -> Predicted:
        """Beliefs of hidden variables and of measurements, given those before each step."""
        chain, layout = self._forward_for("predicted").chain, self.graph.layout
        members = Members.predicted(chain)
        beliefs = Beliefs.of(
            PREDICTED,
            self._beliefs.hidden,
            members.logs,
            members.mean,
            members.cov,
            members.regimes,
        )
        marginals = Marginals(layout, beliefs, self._regimes)
        return Predicted(PREDICTED, chain.given, members, marginals, self._lead)

    def _readings_of(self, variable: Variable) -> tuple[Integers, Array]:
        bound = self._asked[0]
        reading = next((each for each in bound.readings if each.cpd.child == variable), None)
        if reading is None:
            return no_readings(variable, bound.lead)
        marked = np.where(reading.taken, reading.values, np.nan)
        return as_read(reading.step, reading.order, marked, bound.lead)

    def joint(self, *variables: Variable) -> Table | GaussianMixture:
        """The joint of discrete variables, or of continuous ones, of one step or of all steps."""
        if not variables:
            raise EvidenceError("joint takes variables of one step, like x.at(3), m.at(3)")
        return self._of(as_scope(variables, "a joint"))

    def _of(self, scope: Scope) -> Table | GaussianMixture:
        layout = self.graph.layout
        places = [located(layout, v, self.graph.steps) for v in scope]
        steps = {v.step for v in scope}
        if len(steps) > 1:
            raise EvidenceError(
                f"{self.beliefs} have joints of variables of one step, not of {listed(scope)}",
                variable=scope[0],
            )
        first = max(start for _, start in places)
        step = steps.pop()
        templates = tuple(template for template, _ in places)
        shown, rows = (templates, slice(first, None)) if step is None else (scope, step)
        return Marginals(layout, self._beliefs, self._regimes).of(
            shown, templates, rows, self._lead
        )

    @cached_property
    def _backward(self) -> BackwardChain:
        """The pass back over the forward pass, which is made again, once draws are asked for."""
        return again(self.graph, *self._asked)

    @quiet()
    def sample(self, count: int, rng: np.random.Generator) -> dict[Variable, Any]:
        """So many trajectories for each run: (count, *runs, steps, d), of discrete ones without d.

        Modes, and the sources of sightings that leave these open, are drawn first, and the states
        given these; a NumericalError is raised if a belief has no finite root.
        """
        require_smoothed(self.kind)
        values, regimes = draws(self._backward, count, rng)
        if not np.isfinite(values).all():
            raise NumericalError(
                "there are no draws of a belief that is infinite, or whose covariance is none; "
                "give its variables finite variances"
            )
        hidden, layout, found = self._beliefs.hidden, self.graph.layout, dict[Variable, Any]()
        for variable in self._hidden:
            first = 0 if variable in layout.states else 1
            own: Any
            if isinstance(variable, Discrete):
                own = self._regimes.states(variable)[regimes]
            else:
                own = values[..., positions(hidden, (variable,))]
            own = np.moveaxis(own[first:], 0, 2)
            found[variable] = own.reshape(count, *self._lead, *own.shape[2:])
        return found

    @property
    def _title(self) -> str:
        runs = f", runs {self._lead}" if self._lead else ""
        return f"Posterior({self.kind}, steps 0..{self.graph.steps}{runs})"

    def _summary(self) -> Summary:
        return over_time(self._title, self, self._hidden, self._lead, self.graph.steps)
