"""Iterated filters and smoothers: a growth model, a robot's chain, and what step control does."""

from experiments.iterated.experiment import QUICK, run

__all__ = ["QUICK", "run"]
