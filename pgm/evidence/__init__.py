"""Evidence: values of variables, checked against the model and laid out by step and by run."""

from pgm.evidence.dynamic import BoundEvidence, Reading, bind
from pgm.evidence.form import Form
from pgm.evidence.records import records
from pgm.evidence.static import BoundStates, BoundValues, bind_discrete, bind_values
from pgm.evidence.values import (
    Constant,
    Evidence,
    OneOf,
    Sightings,
    Soft,
    Unknown,
    UnknownVariable,
    constant,
    sightings,
    soft,
    unknown,
)

__all__ = [
    "BoundEvidence",
    "BoundStates",
    "BoundValues",
    "Constant",
    "Evidence",
    "Form",
    "OneOf",
    "Reading",
    "Sightings",
    "Soft",
    "Unknown",
    "UnknownVariable",
    "bind",
    "bind_discrete",
    "bind_values",
    "constant",
    "records",
    "sightings",
    "soft",
    "unknown",
]
