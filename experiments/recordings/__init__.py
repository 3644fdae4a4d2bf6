"""Recorded drives, each estimated in every way that the library has."""

from experiments.recordings.experiment import QUICK, run

__all__ = ["QUICK", "run"]
