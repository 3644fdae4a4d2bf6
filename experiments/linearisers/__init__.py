"""Taylor, unscented and Monte Carlo linearisation: one step of a robot, accuracy and cost."""

from experiments.linearisers.experiment import QUICK, run

__all__ = ["QUICK", "run"]
