"""Seven variables in four clusters."""

from experiments.seven_nodes.experiment import QUICK, run

__all__ = ["QUICK", "run"]
