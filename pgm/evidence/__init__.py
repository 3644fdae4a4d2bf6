"""Evidence: values of variables, checked against the model and laid out by step and by run."""

from pgm.evidence.continuous import BoundValues, bind_values
from pgm.evidence.discrete import BoundStates, bind_discrete
from pgm.evidence.dynamic import BoundEvidence, Reading, bind
from pgm.evidence.records import records
from pgm.evidence.unidentified import Unknown, unknown
from pgm.evidence.values import Constant, Evidence, Sightings, Soft, constant, sightings, soft

__all__ = [
    "BoundEvidence",
    "BoundStates",
    "BoundValues",
    "Constant",
    "Evidence",
    "Reading",
    "Sightings",
    "Soft",
    "Unknown",
    "bind",
    "bind_discrete",
    "bind_values",
    "constant",
    "records",
    "sightings",
    "soft",
    "unknown",
]
