"""The belief of an online filter at a step, and what it carries from one step to the next."""

from __future__ import annotations

from functools import cached_property

from pgm.compile import SliceLayout
from pgm.errors import EvidenceError
from pgm.factors import Gaussian
from pgm.immutable import Immutable, set_writeable
from pgm.inference.chain.careful_belief import Belief
from pgm.inference.kind import Kind
from pgm.inference.online.window import Sliding, Trail
from pgm.inference.posterior import require_variable
from pgm.inference.status import Status
from pgm.kernels.arrays import Array, block, symmetric
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
    careful: Belief | None
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
        careful: Belief | None = None,
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
