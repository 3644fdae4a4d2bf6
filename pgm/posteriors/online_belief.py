"""The belief of an online filter at one step, of any family: the record of one step."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, ClassVar

from pgm.display import NoArray, Shown
from pgm.errors import Unanswered
from pgm.kernels.arrays import Array
from pgm.posteriors.belief_kind import Kind
from pgm.posteriors.predictions import Predictions
from pgm.posteriors.status import Status
from pgm.variables import Variable


class _Unanswered:
    """A question beside marginals that beliefs of a family do not answer, and say so.

    As a descriptor, since a class with a `__getattr__` looks up all of its attributes slowly, and
    ``belief[x]`` takes a fifth of a microsecond.
    """

    def __init__(self, question: str) -> None:
        self.question = question

    def __set_name__(self, owner: type, name: str) -> None:
        self.name = name

    def __get__(self, belief: OnlineBelief | None, owner: type) -> Any:
        if belief is None:  # else it would be taken for the default of a field of the same name
            raise AttributeError(self.name)
        raise Unanswered(f"{self.question}: {belief.beliefs} have none online")


class OnlineBelief(Shown, NoArray):
    """The belief of an online filter at one step; its leading axes are runs.

    ``belief[x]`` is the marginal of a hidden variable: a `Gaussian`, a `Table` of a discrete
    variable, a `GridBelief` or `ParticleBelief`, or what a `BeliefFamily` of your own shows. What a
    family has not it refuses, in words.

    Attributes
    ----------
    step : int
        The number of the step.
    log_evidence : ndarray
        (*runs): ln p of all measurements so far.
    status : Status
        How the last step went. Its `digits` tell the decimal digits of Gaussian means where
        rounding matters, as where steps are made in twice the digits.
    kind : Kind
        Which measurements it knows: filtered after an update, predicted before.
    associations : mapping of Variable to Associations
        By sensor, of the update's sightings with an `unknown` parent; of Gaussian beliefs.
    innovations : mapping of Variable to StepInnovations
        Of the last update, by sensor: residuals, their covariances and NIS; of Gaussian beliefs,
        which have gains, too, and of mixtures of them. They are found when they are asked for, by
        making the update again.
    predicted : Predictions
        Of a belief that `predict` returned, those of measurements before they are taken:
        ``predicted[z]``, or ``predicted.of(z, given={m: ...})`` with observed parents.
    rejected : mapping of Variable to Rejections
        The decisions of the gates at the last update, by sensor; of Gaussian beliefs.
    lost, lost_since : ndarray
        (*runs): whether the belief is probably wrong, and since which step, −1 where it is not; of
        a filter made with ``watch=True``.
    lagged : OnlineBelief
        The belief at the step a lag before this one, given all measurements so far; of a filter
        made with ``lag=``. As long as fewer steps than the lag have been made, it is that of step
        0. A filter goes on from the belief itself, not from the lagged one.

    Examples
    --------
    >>> from pgm.examples import walk, x, z
    >>> robot = pgm.OnlineFilter(walk)
    >>> belief = robot.predict(robot.initial())
    >>> belief.predicted[z].mean, belief.predicted[z].std
    (array([0.]), array([2.]))
    >>> belief = robot.update(belief, {z: [4.0]})
    >>> belief[x]
    Gaussian(x)
         mean ± deviation
      x       2.00 ± 1.00
    >>> belief.step, str(belief.kind)
    (1, 'filtered')
    >>> found = belief.innovations[z]
    >>> found.residual.item(), found.cov.item(), found.nis.item()
    (4.0, 4.0, 4.0)
    """

    __slots__ = ()

    # Of which beliefs, in the text of a refusal: a plural.
    beliefs: ClassVar[str] = "these beliefs"

    if TYPE_CHECKING:  # a property would be taken for the default of a field of the same name

        @property
        def step(self) -> int:
            """The number of the step."""

        @property
        def lead(self) -> tuple[int, ...]:
            """The shape of the axes of runs."""

        @property
        def log_evidence(self) -> Array:
            """Ln p of all measurements so far, (*runs)."""

        @property
        def status(self) -> Status:
            """How the last step went."""

        @property
        def kind(self) -> Kind:
            """Which measurements it knows: filtered after an update, predicted before."""

    else:
        associations = _Unanswered("associations of measurements")
        innovations = _Unanswered("innovations")
        lagged = _Unanswered("beliefs of earlier steps")
        lost = _Unanswered("a watch whether the belief is lost")
        lost_since = _Unanswered("a watch whether the belief is lost")
        rejected = _Unanswered("rejections by gates")

    def __getitem__(self, variable: Variable) -> Any:
        """The marginal of a hidden variable at the belief's step, (*runs, ...).

        Raises
        ------
        EvidenceError
            If the belief is not over the variable, or of another step.
        """
        raise NotImplementedError

    @property
    def predicted(self) -> Predictions:
        """The beliefs of measurements of its step before they are taken."""
        return Predictions(self)

    def _measurement(self, variable: Variable, given: Mapping[Variable, Any]) -> Any:
        """The belief of a sensor's measurement, of a belief that is predicted."""
        raise Unanswered(f"beliefs of measurements: {self.beliefs} have none online")

    def _moments(self, variable: Variable) -> Any:
        """The marginal of a variable, in a form that has moments, for summaries."""
        return self[variable]
