"""Exact inference against belief propagation around loops."""

from experiments.belief_propagation.experiment import QUICK, run

__all__ = ["QUICK", "run"]
