"""The notions that everything else is made of, drawn."""

from experiments.basics.experiment import QUICK, run

__all__ = ["QUICK", "run"]
