"""How many particles are enough, beside Kalman filters and exact answers."""

from experiments.particle_counts.experiment import QUICK, run
from experiments.particle_counts.sweep import sweep

__all__ = ["QUICK", "run", "sweep"]
