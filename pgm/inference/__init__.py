"""Inference: schedules of messages, and what they leave."""

from pgm.inference.engine import filter, infer, smooth
from pgm.inference.innovations import Innovations
from pgm.inference.marginals import Marginals
from pgm.inference.online import OnlineBelief, OnlineFilter
from pgm.inference.posterior import Posterior
from pgm.inference.schedule import Filtering, Schedule, Smoothing, Status

__all__ = [
    "Filtering",
    "Innovations",
    "Marginals",
    "OnlineBelief",
    "OnlineFilter",
    "Posterior",
    "Schedule",
    "Smoothing",
    "Status",
    "filter",
    "infer",
    "smooth",
]
