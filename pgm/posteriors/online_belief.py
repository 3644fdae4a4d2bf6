"""The belief of an online filter at one step, of any family: the record of one step."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar

from pgm.display import NoArray, Shown
from pgm.errors import Unanswered
from pgm.kernels.arrays import Array
from pgm.posteriors.belief_kind import Kind
from pgm.posteriors.status import Status
from pgm.variables import Variable

# What a belief can be asked for beside marginals, in words.
QUESTIONS = {
    "associations": "associations of measurements",
    "lagged": "beliefs of earlier steps",
    "lost": "a watch whether the belief is lost",
    "lost_since": "a watch whether the belief is lost",
    "rejected": "rejections by gates",
}


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
    >>> belief = robot.update(belief, {z: [4.0]})
    >>> belief[x]
    Gaussian(x)
         mean ± deviation
      x       2.00 ± 1.00
    >>> belief.step, str(belief.kind)
    (1, 'filtered')
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

    def __getitem__(self, variable: Variable) -> Any:
        """The marginal of a hidden variable at the belief's step, (*runs, ...).

        Raises
        ------
        EvidenceError
            If the belief is not over the variable, or of another step.
        """
        raise NotImplementedError

    def _moments(self, variable: Variable) -> Any:
        """The marginal of a variable, in a form that has moments, for summaries."""
        return self[variable]

    def __getattr__(self, name: str) -> Any:
        asked = getattr(type(self), name, None)
        if asked is not None:  # a property that is unanswered, which tells why
            return asked.__get__(self, type(self))
        if name in QUESTIONS:
            raise Unanswered(f"{QUESTIONS[name]}: {self.beliefs} have none online")
        raise AttributeError(f"{type(self).__name__} has no attribute {name!r}")
