"""Pose graphs, published ones and a drawn one: optimum, marginals, and closures that are false."""

from experiments.pose_graphs.experiment import QUICK, run

__all__ = ["QUICK", "run"]
