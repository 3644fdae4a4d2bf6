"""The Killian Court recording: a robot with a laser scanner in the corridors of MIT."""

from experiments.killian.experiment import QUICK, run

__all__ = ["QUICK", "run"]
