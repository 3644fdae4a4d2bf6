"""A recorded robot that turns, goes and turns, and hears ranges of landmarks: an exercise."""

from experiments.freiburg.experiment import QUICK, run

__all__ = ["QUICK", "run"]
