"""A recorded mower that hears its distance to beacons."""

from experiments.plaza.experiment import QUICK, run

__all__ = ["QUICK", "run"]
