"""Kalman filters by cluster graph and by textbook."""

from experiments.kalman.experiment import QUICK, run

__all__ = ["QUICK", "run"]
