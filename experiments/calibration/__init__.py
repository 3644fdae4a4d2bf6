"""A sensor's calibration and noise, from what a recording tells by itself."""

from experiments.calibration.experiment import QUICK, run

__all__ = ["QUICK", "run"]
