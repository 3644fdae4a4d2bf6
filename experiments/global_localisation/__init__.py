"""Finding a robot in a house of which it has the map, but not where in it it is."""

from experiments.global_localisation.experiment import QUICK, run

__all__ = ["QUICK", "run"]
