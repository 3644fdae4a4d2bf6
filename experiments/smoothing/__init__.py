"""Filters, smoothers and iterated smoothers over many runs: how wrong, and do they know it."""

from experiments.smoothing.experiment import QUICK, run

__all__ = ["QUICK", "run"]
