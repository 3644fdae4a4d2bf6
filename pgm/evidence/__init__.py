"""Evidence: values of variables over time, checked against the CPDs and laid out by step."""

from pgm.evidence.binding import bind
from pgm.evidence.bound import BoundEvidence, Reading
from pgm.evidence.values import Constant, Evidence, Sightings, constant, sightings

__all__ = [
    "BoundEvidence",
    "Constant",
    "Evidence",
    "Reading",
    "Sightings",
    "bind",
    "constant",
    "sightings",
]
