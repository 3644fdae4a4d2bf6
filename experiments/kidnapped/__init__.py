"""A robot that is carried elsewhere in the middle of a drive."""

from experiments.kidnapped.experiment import QUICK, run

__all__ = ["QUICK", "run"]
