"""The belief of an online filter, and its steps in twice the digits where float64 has too few.

A step in float64 leaves all the digits that are promised where its beliefs are regular: no
component is determined to 5·10⁻⁸ of its variance by others, nor suddenly to that by a reading. Then
neither what a transition nor what a reading sums up is much smaller than its parts. Other
steps are made in twice the digits, and the belief is carried in these until it is regular.
"""

from __future__ import annotations

from functools import cached_property
from typing import NamedTuple

import numpy as np

from pgm.compile import SliceLayout
from pgm.errors import EvidenceError
from pgm.factors import Gaussian
from pgm.immutable import Immutable, set_writeable
from pgm.inference.chain import careful, careful_motion
from pgm.inference.chain.careful_update import Belief, variances
from pgm.inference.chain.certificate import MODERATE, is_ordinary, moments, solved
from pgm.inference.chain.iterated_update import IteratedUpdate, iterated
from pgm.inference.chain.plan import ChainPlan
from pgm.inference.kind import Kind
from pgm.inference.online.window import Sliding, Trail
from pgm.inference.posterior import require_variable
from pgm.inference.schedule import Filtering
from pgm.inference.status import Status
from pgm.kernels.arrays import Array, block, symmetric
from pgm.kernels.twofold import Twofold
from pgm.variables import Variable


class OnlineBelief(Immutable):
    """The belief of an online filter at one step.

    Attributes
    ----------
    step : int
    log_evidence : ndarray
        (...): ln p of all readings so far.
    status : Status
        How the linearisations of the last update went; with the digits that are left, where
        deviations lie too far apart for float64 and steps are made in twice the digits.
    kind : Kind
        Which readings it knows: filtered after an update, predicted before.
    """

    step: int
    layout: SliceLayout
    lead: tuple[int, ...]
    mean: Array
    cov: Array
    log_evidence: Array
    status: Status
    kind: Kind
    careful: CarefulBelief | None
    behind: Trail | Sliding | None

    def __init__(
        self,
        step: int,
        layout: SliceLayout,
        lead: tuple[int, ...],
        mean: Array,
        cov: Array,
        log_evidence: Array,
        status: Status,
        kind: Kind,
        careful: CarefulBelief | None = None,
        behind: Trail | Sliding | None = None,
    ) -> None:
        set_writeable(mean, False)
        set_writeable(cov, False)
        set_writeable(log_evidence, False)
        values = self.__dict__  # as `_set`, in a third of the time
        values["step"] = step
        values["layout"] = layout
        values["lead"] = lead
        values["mean"] = mean
        values["cov"] = cov
        values["log_evidence"] = log_evidence
        values["status"] = status
        values["kind"] = kind
        values["careful"] = careful
        values["behind"] = behind

    def __getitem__(self, variable: Variable) -> Gaussian:
        """The marginal of a hidden variable at the belief's step."""
        if type(variable) is not Variable:
            require_variable(variable)
        layout, template = self.layout, variable.template
        known = layout.slice if self.step else layout.states
        if template not in known or variable.step not in (None, self.step):
            raise EvidenceError(
                f"the belief at step {self.step} is over {list(known)}, not {variable!r}",
                variable=variable,
                step=self.step,
            )
        mean, cov = self.mean, self.cov
        if layout.slice != (template,):
            places = layout.places[template]
            mean, cov = mean[..., places], block(cov, places, places)
        # That of one run is exactly symmetric.
        return Gaussian._make((variable,), mean, symmetric(cov) if self.lead else cov)

    @cached_property
    def lagged(self) -> OnlineBelief:
        """The belief at the step a lag before, given all readings so far; at step 0 until then.

        It is there where the filter's schedule is a `FixedLag`: ``belief.lagged[x]`` is x at
        ``belief.lagged.step``, and ``belief.lagged.kind`` says how many steps it knows more. A
        filter goes on from the belief itself, not from this one.

        Raises
        ------
        EvidenceError
            If the filter has no lag.
        NumericalError
            If float64 has too few digits to go back.
        """
        if self.behind is None:
            raise EvidenceError(
                f"{self!r} is of a filter without a lag; make it with OnlineFilter(model, lag=5)",
                step=self.step,
            )
        step, mean, cov = self.behind.lagged(self.step, self.mean, self.cov)
        if step == self.step:
            return self
        kind = Kind(self.step - step + self.kind.lag)
        mean, cov = mean.copy(), cov.copy()
        parts = self.layout, self.lead, mean, cov, self.log_evidence, self.status, kind
        return OnlineBelief(step, *parts)

    def __repr__(self) -> str:
        return f"OnlineBelief({self.kind}, step {self.step}, over {list(self.layout.slice)})"


# The share of its variance below which a component counts as determined.
REGULAR = 1.0 / MODERATE


class CarefulBelief(NamedTuple):
    """A belief in twice the digits.

    Attributes
    ----------
    belief : Belief
    largest : ndarray
        (runs, n): the largest variances since it is carried so.
    """

    belief: Belief
    largest: Array

    @property
    def error(self) -> Array:
        """The error of the means, (runs,); see `Belief.error`."""
        return self.belief.error(self.largest)

    @property
    def moments(self) -> tuple[Array, Array]:
        """The moments in float64."""
        return moments(self.belief, solved(_nothing(self.belief)))

    @property
    def is_ordinary(self) -> bool:
        """Whether float64 can carry it: covariances, and means beside their deviations."""
        return is_ordinary(*self.moments)

    def over(self, before: tuple[int, ...], after: tuple[int, ...]) -> CarefulBelief:
        """The same for runs on other axes, which those before broadcast to."""
        if before == after:
            return self

        def wide(array: Array) -> Array:
            own = array.shape[1:]
            return np.broadcast_to(array.reshape(*before, *own), (*after, *own)).reshape(-1, *own)

        columns, cov = (Twofold(wide(part.hi), wide(part.lo)) for part in self.belief[:2])
        rounding, drift = map(wide, self.belief[2:])
        return CarefulBelief(Belief(columns, cov, rounding, drift), wide(self.largest))


def first(plan: ChainPlan) -> CarefulBelief:
    """The prior."""
    belief = careful_motion.start(plan, linearise=True)
    return CarefulBelief(belief, variances(belief.cov.hi))


def beginning(mean: Array, cov: Array) -> CarefulBelief:
    """A belief of moments in float64, (runs, n) and (runs, n, n)."""
    return CarefulBelief(Belief.of(mean, cov), variances(cov))


def predict(plan: ChainPlan, step: int, known: CarefulBelief) -> CarefulBelief:
    """The belief one step later, at `step`."""
    move = careful_motion.moving(plan, 1, *known.moments)
    belief = careful_motion.predict(known.belief, move)
    careful.require_proper(plan, step, belief)
    return CarefulBelief(belief, np.maximum(known.largest, variances(belief.cov.hi)))


def update(
    plan: ChainPlan, step: int, known: CarefulBelief, schedule: Filtering
) -> tuple[CarefulBelief, IteratedUpdate[careful.CarefulUpdate]]:
    """The belief given the readings of its step."""
    nothing = _nothing(known.belief)
    taken = iterated(
        careful.CarefulReading.of(plan, 0, known.moments, known.belief, nothing, schedule), schedule
    )
    belief = taken.solution.at(taken.mean).belief
    careful.require_proper(plan, step, belief)
    return CarefulBelief(belief, known.largest), taken


def _nothing(belief: Belief) -> Twofold:
    """No information about an unknown δ, which an online filter has not."""
    return Twofold.zeros((len(belief.cov.hi), 1, 1))
