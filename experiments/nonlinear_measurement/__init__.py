"""Which lineariser, where the measurement is nonlinear: KL from the exact posterior, and cost."""

from experiments.nonlinear_measurement.experiment import QUICK, run
from experiments.nonlinear_measurement.sweep import sweep

__all__ = ["QUICK", "run", "sweep"]
