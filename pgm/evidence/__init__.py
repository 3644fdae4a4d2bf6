"""Evidence: values of variables, checked against the model and laid out by step and by run."""

from pgm.evidence.binding import bind
from pgm.evidence.bound import BoundEvidence, Reading
from pgm.evidence.discrete import BoundStates, bind_discrete
from pgm.evidence.values import Constant, Evidence, Sightings, Soft, constant, sightings, soft

__all__ = [
    "BoundEvidence",
    "BoundStates",
    "Constant",
    "Evidence",
    "Reading",
    "Sightings",
    "Soft",
    "bind",
    "bind_discrete",
    "constant",
    "sightings",
    "soft",
]
