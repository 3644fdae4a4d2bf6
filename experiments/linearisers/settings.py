"""The one-step networks that linearisers are compared on, and simulations of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

import pgm
from models.networks import fix, pose, velocity
from models.networks.poses import driven
from pgm.results import Sample

CONTROL = (1.0, 0.5)  # m/s, rad/s
DT = 1.0  # s
# A reading of the pose on the state's own unwrapped chart. As an angle, a heading half a turn from
# the prediction would go to one branch in one belief and to the other in the next, and a few such
# simulations would raise the mean divergence.
unwrapped = pgm.Variable("z", components=("east", "north", "heading"))


@dataclass(frozen=True)
class Setting:
    """Standard deviations of a robot's first step; the prior's mean is zero.

    Attributes
    ----------
    start, motion : tuple of float
        Of the first pose and of the motion's noise [m, m, rad].
    sensor : tuple of float
        Of the reading: of the position [m, m], or of the whole pose [m, m, rad].
    """

    start: tuple[float, float, float]
    motion: tuple[float, float, float]
    sensor: tuple[float, ...]

    @property
    def reading(self) -> pgm.Variable:
        """The variable that is read."""
        return fix if len(self.sensor) == 2 else unwrapped

    @property
    def motion_cov(self) -> npt.NDArray[np.float64]:
        """The motion's noise, (3, 3)."""
        return np.diag(np.square(self.motion))

    def network(self) -> pgm.DynamicBayesianNetwork:
        """The motion along an arc, and a linear reading of the position or of the whole pose."""
        matrix = np.eye(len(self.sensor), 3)
        noise = np.diag(np.square(self.sensor))
        return pgm.DynamicBayesianNetwork(
            prior=[pgm.GaussianCPD(pose, mean=np.zeros(3), cov=np.diag(np.square(self.start)))],
            transition=[driven(DT, self.motion)],
            observation=[pgm.LinearGaussianCPD(self.reading, given={pose: matrix}, cov=noise)],
        )


# R1 and R2 meet the report's averages; in the mild one headings are known well.
SETTINGS = {
    "R1": Setting((0.264, 0.264, 1.1032), (0.0025, 0.0025, 1.4356), (0.0384, 0.0384)),
    "R2": Setting((0.1202, 0.1202, 0.8967), (0.0176, 0.0176, 0.2612), (0.0024, 0.0024, 0.116)),
    "mild": Setting((0.2, 0.2, 0.1), (0.05, 0.05, 0.05), (0.1, 0.1)),
}
REPRODUCED = ("R1", "R2")


def simulate(setting: Setting, runs: int, seed: int) -> tuple[pgm.DynamicBayesianNetwork, Sample]:
    """A setting's network, and first steps drawn from it: poses (runs, 2, 3), readings."""
    network = setting.network()
    return network, network.sample({velocity: np.array([CONTROL])}, runs=runs, rng=seed)
