"""Recorded drives whose start is hardly known, where linearisers part company."""

from experiments.wide_start.experiment import QUICK, run

__all__ = ["QUICK", "run"]
