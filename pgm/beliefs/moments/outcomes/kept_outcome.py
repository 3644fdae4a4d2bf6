"""Posteriors of dynamic networks that keep the marginals of some variables alone.

Of sensors among these they keep the beliefs of measurements before they are taken, and their
innovations. They take less memory than a `ChainOutcome`, which keeps the beliefs over all hidden
variables, and answers for joints, messages and innovations too. The steps are 0..T.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import ClassVar

from pgm.beliefs.moments.outcomes import doubts
from pgm.beliefs.moments.outcomes.kept_sensor import KeptPredictions, KeptSensor
from pgm.compile import DynamicGraph
from pgm.display import Summary
from pgm.errors import EvidenceError, PgmError
from pgm.factors import Gaussian
from pgm.factors.scope import Scope, listed
from pgm.kernels.arrays import Array
from pgm.posteriors.associations import Found
from pgm.posteriors.belief_kind import FILTERED, Kind
from pgm.posteriors.hidden import located, measured
from pgm.posteriors.innovations import BySensor
from pgm.posteriors.outcome import QUESTIONS, Outcome
from pgm.posteriors.status import Status
from pgm.posteriors.summaries import over_time
from pgm.variables import Variable


@dataclass(frozen=True, eq=False, repr=False)
class KeptOutcome(Outcome[Gaussian]):
    """A posterior of which only the marginals of some hidden variables, at all steps, are kept.

    `filter`, `smooth` and `infer` return it with ``keep=[x]``. ``posterior[x]`` has means
    (..., T+1, d) of a state and (..., T, d) of a hidden control, of d components, and
    ``posterior[x.at(3)]`` is the marginal at one step. With ``keep=[z]``, z being a sensor, it has
    ``posterior.predicted[z]`` and ``posterior.innovations[z]``. Leading axes are runs.

    Attributes
    ----------
    graph : DynamicGraph
    status : Status
        Linearisations, residuals, and whether they converged.
    kind : Kind
        Which measurements the marginals know: filtered, fixed-lag or smoothed.
    log_evidence : ndarray
        (...): the value ln p(measurements), in nats.
    log_evidence_kind : str
        ``exact``; ``linearised``, of the linearised model; or ``laplace``, at the fixed point of
        Taylor relinearisation. With robust noise a lower ``bound``, a ``linearised bound``, or
        ``unnormalised``, if a density has no finite integral.
    associations : mapping of Variable to Associations
        By sensor: the candidate, such as a landmark, that each measurement was taken to be of,
        where the evidence left that open, by `unknown`.

    Raises
    ------
    EvidenceError, GraphError
        If a result that was not kept is asked for: GraphError by `message`, `belief` and
        `potential`, else EvidenceError.

    Examples
    --------
    >>> from pgm.examples import walk, x, z
    >>> posterior = pgm.smooth(walk, {z: [[4.0]]}, keep=x)
    >>> posterior[x].mean.ravel()
    array([1., 2.])
    >>> posterior[x.at(0)].cov
    array([[0.75]])
    """

    silent: ClassVar[str] = "keep= kept marginals alone: no messages; leave it out to have them"

    graph: DynamicGraph
    status: Status
    kind: Kind
    _kept: Mapping[Variable, Gaussian]
    _log_evidence: Array
    _log_evidence_kind: str
    _sensors: Mapping[Variable, KeptSensor]
    _held: bool
    associations: Found = field(default_factory=dict)

    def __getitem__(self, variable: Variable) -> Gaussian:
        """The marginal of a variable that was kept, at all its steps or at one.

        Raises
        ------
        EvidenceError
            If it was not kept, is not hidden, or has no such step.
        """
        layout = self.graph.layout
        if measured(layout, variable) in self._sensors:
            raise EvidenceError(
                f"{variable!r} is a measurement, of which keep= keeps predicted[{variable!r}] and "
                "innovations alone; leave keep= out to have its belief where nothing was read",
                variable=variable,
            )
        template, first = located(layout, variable, self.graph.steps)
        if template not in self._kept:
            wanted = ", ".join(v.name for v in (*self._kept, template))
            raise EvidenceError(
                f"{template!r} was not kept; ask for it, keep=[{wanted}]", variable=variable
            )
        found = self._kept[template]
        if variable.step is None:
            return found
        at = variable.step - first
        return Gaussian._make((variable,), found.mean[..., at, :], found.cov[..., at, :, :])

    @property
    def predicted(self) -> KeptPredictions:
        """The beliefs of measurements before they are taken, of sensors that were kept."""
        if not self._sensors:
            raise self.refusal("predicted")
        return KeptPredictions({v: kept.predicted for v, kept in self._sensors.items()})

    @property
    def innovations(self) -> BySensor:
        """The innovations of sensors that were kept."""
        if not self._sensors:
            raise self.refusal("innovations")
        every = {v: kept.innovations for v, kept in self._sensors.items()}
        return BySensor({v: found for v, found in every.items() if found is not None})

    @property
    def _hidden(self) -> Scope:
        """The variables whose marginals were kept."""
        return tuple(self._kept)

    @property
    def log_evidence(self) -> Array:
        """The log-evidence ln p(measurements), in nats, (...)."""
        return self._log_evidence

    @property
    def log_evidence_kind(self) -> str:
        """The kind of `log_evidence`, one of those that the class lists, such as ``exact``."""
        return self._log_evidence_kind

    def refusal(self, question: str) -> PgmError:
        """The error for what was not kept, such as joints, saying how to have it."""
        what, error = QUESTIONS[question]
        text = (
            f"{what}: not kept, since keep= keeps {self.kind} marginals, log-evidence and status "
            "alone; leave keep= out to have everything"
        )
        if question in ("predicted", "innovations"):
            text += "; those of measurements z are kept by keep=[..., z]"
        if question == "filtered":
            here = self.kind == FILTERED
            text += "; filtered marginals "
            text += "are posterior[x] here" if here else "are kept by pgm.filter(..., keep=[x])"
        return error(text)

    def _doubt(self) -> str:
        return doubts.doubt(held=self._held, whole=False)

    @property
    def _title(self) -> str:
        runs = self._log_evidence.shape
        return (
            f"Posterior({self.kind}, kept [{listed((*self._kept, *self._sensors))}], "
            f"steps 0..{self.graph.steps}"
            f"{f', runs {runs}' if runs else ''})"
        )

    def _summary(self) -> Summary:
        runs, last = self._log_evidence.shape, self.graph.steps
        return over_time(self._title, self, tuple(self._kept), runs, last)
