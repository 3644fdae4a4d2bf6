"""A robot on two wheels, moved eight times a second and measured once."""

from experiments.differential_drive.experiment import QUICK, run

__all__ = ["QUICK", "run"]
