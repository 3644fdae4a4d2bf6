"""Noise learnt by each lineariser."""

from experiments.learning.experiment import QUICK, run

__all__ = ["QUICK", "run"]
