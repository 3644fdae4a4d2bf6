"""A robot that maps a house of landmarks while it drives through, and closes a loop."""

from experiments.slam.experiment import QUICK, run

__all__ = ["QUICK", "run"]
