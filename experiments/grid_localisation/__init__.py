"""A robot that does not know where it is: a grid, and Gaussians started right and wrong."""

from experiments.grid_localisation.experiment import QUICK, run

__all__ = ["QUICK", "run"]
