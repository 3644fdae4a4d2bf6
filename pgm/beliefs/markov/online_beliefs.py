"""The beliefs of an online filter of a discrete dynamic network, and the steps of their lag.

A *slice* is the hidden variables of a step. Arrays are (*states, *runs): an axis for each hidden
variable, then one of runs, or none where the user gave none. Their entries are numbers, or
logarithms where numbers may underflow: a *semiring* is the arithmetic of the one or the other.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np

from pgm.beliefs.markov.chain import TINY, BackwardChain, smallest
from pgm.beliefs.markov.plan import SlicePlan, TableSlices
from pgm.display import Summary
from pgm.errors import EvidenceError, Unanswered
from pgm.factors import GaussianMixture, Table
from pgm.factors.axes import discrete
from pgm.factors.scope import namesake
from pgm.immutable import Immutable
from pgm.kernels.arrays import Array, frozen
from pgm.kernels.semirings import LOG_SUM_PRODUCT, SUM_PRODUCT, Semiring
from pgm.posteriors.belief_kind import Kind
from pgm.posteriors.online_belief import OnlineBelief
from pgm.posteriors.posterior import require_variable
from pgm.posteriors.predictions import require_parents
from pgm.posteriors.status import Status
from pgm.posteriors.summaries import at_a_step
from pgm.schedules.late import NOTHING, Log
from pgm.variables import Variable

if TYPE_CHECKING:
    from pgm.beliefs.markov.online import TableSteps


class Held(NamedTuple):
    """A belief over a slice, of sum one, and the weights of its step's measurements so far.

    entries: (*states, *runs), numbers or logarithms.
    weights: ∝ p(measurements of the step | states), (*states, *runs), as `entries`; None, if there
        were none.
    linear: Whether entries and weights are numbers, not logarithms.
    """

    entries: Array
    weights: Array | None
    linear: bool

    @property
    def semiring(self) -> Semiring:
        """The semiring of the entries, of numbers or of logarithms."""
        return SUM_PRODUCT if self.linear else LOG_SUM_PRODUCT

    def within(self, semiring: Semiring) -> Held:
        """The same belief in entries of a semiring: that of the belief, or one of logarithms.

        A belief of logarithms cannot become one of numbers.
        """
        if semiring.linear == self.linear:
            return self
        weights = None if self.weights is None else semiring.entries(self.weights)
        return Held(semiring.entries(self.entries), weights, semiring.linear)

    @property
    def numbers(self) -> Array:
        """The probabilities of the states."""
        if self.linear:
            return self.entries
        with np.errstate(under="ignore"):
            found: Array = np.exp(self.entries)
        return found

    @property
    def loses(self) -> bool:
        """Whether the belief may lose a state in the next products, by underflow.

        It may if its entries are numbers, not logarithms, and a positive one is below 10⁻¹⁵⁰.
        """
        return self.linear and smallest(self.entries) < TINY


class Passed(NamedTuple):
    """A past step of an online filter.

    held: The belief of the step.
    ahead: The slices with the tables of the transition from this step to the next.
    """

    held: Held
    ahead: TableSlices


class OnlineStates(OnlineBelief, Immutable):
    """The belief of an online filter of a discrete network at one step.

    log_evidence: (*lead): ln p of all measurements so far.
    status: Converged in all runs, since tables need no iterations.
    kind: Filtered after an update, predicted before; of a belief from `lagged`, fixed-lag.
    lead: The user's axes of runs.
    behind: Always None; beliefs of Gaussian filters keep earlier steps here, to smooth them.
    _steps: The filter's steps, which made it.
    _held: The belief over the slice.
    _trail: The past steps within the filter's lag, earliest first, from which `lagged` smooths.
    _log: What late readings ask for.
    """

    step: int
    log_evidence: Array
    status: Status
    kind: Kind
    lead: tuple[int, ...]
    # A window of steps that are linearised again: tables need none.
    behind: None
    _steps: TableSteps
    _held: Held
    _trail: tuple[Passed, ...]
    _log: Log

    beliefs: ClassVar[str] = "tables"
    _arrays: ClassVar[str] = "probabilities by variable, belief[x].probabilities"

    def __init__(
        self,
        steps: TableSteps,
        step: int,
        kind: Kind,
        held: Held,
        log_evidence: Array,
        trail: tuple[Passed, ...] = (),
        log: Log = NOTHING,
    ) -> None:
        lead = log_evidence.shape
        status = Status.of([], np.ones(math.prod(lead), dtype=bool), lead)
        self._set(
            step=step, kind=kind, log_evidence=frozen(np.asarray(log_evidence)), status=status
        )
        self._set(lead=lead, behind=None, _steps=steps, _held=held, _trail=trail, _log=log)

    def restored(self, log: Log) -> OnlineStates:
        """The belief with another log of the steps behind it."""
        parts = self._steps, self.step, self.kind, self._held, np.array(self.log_evidence)
        return OnlineStates(*parts, self._trail, log)

    @property
    def _plan(self) -> SlicePlan:
        return self._steps._plan

    @property
    def _lag(self) -> int | None:
        """The filter's lag in steps; None without one."""
        return self._steps.lag

    def _measurement(
        self, variable: Variable, given: Mapping[Variable, Any]
    ) -> Table | GaussianMixture:
        if variable in self._plan.slice:
            return self[variable]
        require_parents(self._plan.model, variable, given, self.step)
        return self._steps.measurement(self, variable, given)

    def __getitem__(self, variable: Variable) -> Table:
        """The marginal of a hidden variable at the belief's step, (*lead, size).

        Any other variable raises `EvidenceError`.
        """
        plan, template = self._plan, require_variable(variable).template
        hidden = plan.slice if self.step else plan.states
        if template not in hidden or variable.step not in (None, self.step):
            raise EvidenceError(
                f"the belief at step {self.step} is over {list(hidden)}, not {variable!r}"
                f"{namesake(variable, hidden)}",
                variable=variable,
                step=self.step,
            )
        own = plan.labels[template]
        others = tuple(k for k in range(len(plan.slice)) if k != own)
        values = self._held.numbers.sum(axis=others) if others else self._held.numbers
        rows = np.array(values.T).reshape(*self.lead, values.shape[0])
        return Table._plain(discrete((template,)), frozen(rows))

    @property
    def lagged(self) -> OnlineStates:
        """The fixed-lag belief: of the step that lies as many steps back as the filter's lag.

        It is given all measurements so far. If fewer steps have passed, it is that of step 0. A
        belief of a filter without a lag raises `EvidenceError`.
        """
        if self._lag is None:
            raise Unanswered(
                f"{self._title} is of a filter without a lag; make it with OnlineFilter(model, "
                "lag=5)",
                step=self.step,
            )
        if not self._trail:
            return self
        passed = len(self._trail)
        values = _Window(self._trail, self._held, self.lead).smoothed()
        found = Held(values, None, linear=True)
        kind = Kind(passed + self.kind.lag)
        before = self._steps, self.step - passed, kind, found
        return OnlineStates(*before, np.array(self.log_evidence))

    @property
    def _title(self) -> str:
        runs = f", runs {self.lead}" if self.lead else ""
        return f"OnlineBelief({self.kind}, step {self.step}{runs})"

    def _summary(self) -> Summary:
        hidden = self._plan.slice if self.step else self._plan.states
        return at_a_step(self._title, self, hidden, self.lead)


class _Window:
    """A window of the last steps of an online filter with lag, to be smoothed at its first step.

    A `BackwardChain` sends its messages back through the window, as through a chain (`Behind`)
    whose step 0 is the first step of the window.

    held: The filtered beliefs of the steps, all in one semiring.
    ahead: Of each step but the last, the slices with the transition out of it.
    """

    def __init__(self, passed: Sequence[Passed], last: Held, lead: tuple[int, ...]) -> None:
        every = [*(each.held for each in passed), last]
        linear = all(each.linear for each in every)
        self.semiring = SUM_PRODUCT if linear else LOG_SUM_PRODUCT
        self.held = [each.within(self.semiring) for each in every]
        self.ahead = [each.ahead for each in passed]
        self.steps, self.lead = len(passed), lead

    def smoothed(self) -> Array:
        """The probabilities of the states at the window's first step, (*states, *runs).

        They are given all measurements up to the window's last step.
        """
        chain = BackwardChain(self, self.semiring)
        chain.known = [each.entries for each in self.held]
        message = chain.unit()
        for step in range(self.steps - 1, -1, -1):
            message = chain.back(step, message)
        return chain.posterior(0, message)

    def likelihood(self, step: int) -> tuple[Array | None, Array | float]:
        """The weights of a step's measurements, ∝ p(z_t | x_t), or None; their log-scale is 0."""
        return self.held[step].weights, 0.0

    def backward(self, step: int, message: Array) -> Array:
        """The sum Σ_x p(x | x') message(x), x being the slice of `step` and x' the one before."""
        ahead = self.ahead[step - 1].within(self.semiring)
        return ahead.backward(ahead.first, message)  # whose only row is of its own step
