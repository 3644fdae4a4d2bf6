"""Filtering with point masses, cells or particles, in a robot's loop."""

from collections.abc import Mapping
from typing import Any, ClassVar, Generic, TypeVar

from pgm.boundary import as_mapping
from pgm.display import InCode, titled
from pgm.errors import ModelError
from pgm.evidence import BoundEvidence
from pgm.immutable import Immutable
from pgm.networks import DynamicBayesianNetwork
from pgm.posteriors.associations import by_density
from pgm.schedules import step_evidence
from pgm.variables import Variable

Belief = TypeVar("Belief", bound=step_evidence.Place)


class PointFilter(InCode, Immutable, Generic[Belief]):
    """Base of online filters by point masses; their methods return new beliefs and change none.

    model: The network that is filtered.
    belief: The family of beliefs that the user gave, with its settings: which cells, or how many
        draws.
    """

    model: DynamicBayesianNetwork
    belief: Any
    # The options of `OnlineFilter`, beside the belief, by which the same steps are made.
    options: ClassVar[Mapping[str, Any]] = {}

    def __getstate__(self) -> dict[str, Any]:
        # What was tested or compiled is not part of the value.
        return {"model": self.model, "belief": self.belief}

    def __repr__(self) -> str:
        return f"OnlineFilter(over {list(self.model.states)}, belief={self.belief!r})"

    def predict(self, belief: Belief, inputs: Mapping[Variable, Any] | None = None) -> Belief:
        """The belief one step later, given the inputs of that step.

        Parameters
        ----------
        belief : OnlineBelief
            A belief of this filter.
        inputs : mapping of Variable to array_like
            Values (..., d) of the transition's inputs.

        Raises
        ------
        EvidenceError
            If an input is missing or of a wrong shape, or a variable given is no input.
        ModelError
            If the belief is none of this filter's, or a function returns a wrong shape.
        LinearisationError, NumericalError
            If a function has no value at a point mass, or all probability has left the bounds.
        """
        self._check(belief)
        given = as_mapping(inputs, "the inputs of predict")
        return self._predicted(belief, step_evidence.inputs(self.model, belief, given))

    def update(self, belief: Belief, readings: Mapping[Variable, Any]) -> Belief:
        """The belief given measurements of its step.

        Parameters
        ----------
        belief : OnlineBelief
            A belief of this filter.
        readings : mapping of Variable to array_like
            By sensor, its measurement (..., d), or several as `pgm.sightings`; by input of a
            sensor, its value.

        Raises
        ------
        EvidenceError
            If a measurement does not fit its sensor, or is impossible.
        ModelError, LinearisationError
            If the belief is none of this filter's, or a function has no value at a point mass.
        """
        self._check(belief)
        given = step_evidence.mapping(readings, "update", "sensors to measurements")
        bound = by_density(step_evidence.readings(self.model, belief, given))
        return self._updated(belief, step_evidence.at_step(bound, belief.step))

    def _check(self, belief: Any) -> None:
        """Refuse, by a ModelError, a belief of another model, or of other cells or particles."""
        if not self._owns(belief):
            kind = type(self.belief).__name__.lower()
            raise ModelError(
                f"{titled(belief)} is no belief of this filter's model and {kind}; begin with "
                "initial(). One that was pickled goes on with the filter pickled beside it, "
                "pickle.dumps((robot, belief))"
            )

    def _owns(self, belief: Any) -> bool:
        """Whether a belief was made by a filter of this model and choice of beliefs."""
        raise NotImplementedError

    def _predicted(self, belief: Belief, bound: BoundEvidence) -> Belief:
        """The belief one step later; `bound` has the inputs of that step."""
        raise NotImplementedError

    def _updated(self, belief: Belief, bound: BoundEvidence) -> Belief:
        """The belief given the measurements of its step, which `bound` has."""
        raise NotImplementedError
