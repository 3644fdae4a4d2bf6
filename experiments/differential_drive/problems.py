"""The three problems: a linear robot, a turning one, and one that sees a landmark.

They are those of an assignment (ME8135, 2023), whose numbers are `NOISE` and the
constants below; what it leaves open is said beside each.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

import pgm
from models import networks
from models.networks import fix, landmark, point, pose, sighting, wheels
from models.networks.covariances import diagonal

Array = npt.NDArray[np.float64]

RADIUS, WHEELBASE = 0.1, 0.3  # m
MOTIONS = 8  # a second; readings come once a second
DT = 1.0 / MOTIONS
SCALE = (1.0, 2.0)  # z = diag(1, 2) (east, north) + noise
LANDMARK = np.array([10.0, 10.0])

# The second argument of every N(0, ·) that the reference prints.
NOISE = {
    "w_x": 0.1,  # white noise of the velocity east, m/s
    "w_y": 0.15,  # and north
    "w_psi": 0.01,  # of the turn rate, rad/s
    "r_x": 0.05,  # of the two readings of the position, in their own units
    "r_y": 0.075,
    "range": 0.1,  # m
    "bearing": 0.01,  # rad
}

# Problem 1 turns both wheels at 0.1 rad/s: v = r (ω + ω) / 2 = 0.01 m/s on each axis, 1 m in 100 s.
SLOW = (0.1, 0.1)
SECONDS = {"1": 100, "2a": 48, "2b": 48}
# Problem 2 gives neither start nor speeds. Here the robot starts at the origin, as in problem 1,
# heads along the circle about the landmark, and goes round it in 44 s, at 2 m/s.
START = (0.0, 0.0, -np.pi / 4)
SPEED = 2.0  # m/s


@dataclass(frozen=True, eq=False)
class Problem:
    """A network, what drives it, and when it is measured.

    Attributes
    ----------
    name : str
        "1", "2a" or "2b".
    title : str
    network : DynamicBayesianNetwork
    state, reading : Variable
    controls : ndarray
        (T, 2): wheel speeds, left and right [rad/s].
    given : mapping of Variable to ndarray
        Observed parents of the readings, (2,).
    """

    name: str
    title: str
    network: pgm.DynamicBayesianNetwork
    state: pgm.Variable
    reading: pgm.Variable
    controls: Array
    given: Mapping[pgm.Variable, Array]

    @property
    def steps(self) -> int:
        """How often the robot moves."""
        return len(self.controls)

    @property
    def measured(self) -> npt.NDArray[np.int_]:
        """The steps that end with a reading: every eighth."""
        return np.arange(MOTIONS, self.steps + 1, MOTIONS)

    def sample(
        self, runs: int, rng: np.random.Generator
    ) -> tuple[Array, Mapping[pgm.Variable, Any]]:
        """Drives drawn from the network: the truth (runs, T+1, n), and evidence."""
        times = self.measured
        given = {parent: np.tile(value, (len(times), 1)) for parent, value in self.given.items()}
        drawn = self.network.sample(
            {wheels: self.controls, self.reading: pgm.sightings(step=times, given=given)},
            runs=runs,
            rng=rng,
        )
        return drawn[self.state], drawn.evidence


def problems(noise: str, seconds: int) -> dict[str, Problem]:
    """The three, with `NOISE` read as deviations or as variances, for so many seconds at most."""
    std = deviations(noise)
    steps = {name: MOTIONS * min(seconds, SECONDS[name]) for name in SECONDS}
    turning = networks.differential_drive(
        DT,
        radius=RADIUS,
        wheelbase=WHEELBASE,
        start=START,
        velocity_std=(std["w_x"], std["w_y"], std["w_psi"]),
        sensor_std=(std["range"], std["bearing"]),
    )
    position = networks.reads_position((std["r_x"], std["r_y"]), scale=SCALE)
    return {
        "1": Problem(
            "1",
            "Problem 1: linear motion, linear readings",
            linear(std),
            point,
            fix,
            np.tile(SLOW, (steps["1"], 1)),
            {},
        ),
        "2a": Problem(
            "2a",
            "Problem 2a: turning motion, linear readings",
            turning.replace(observation=[position]),
            pose,
            fix,
            loop(steps["2a"]),
            {},
        ),
        "2b": Problem(
            "2b",
            "Problem 2b: turning motion, range and bearing",
            turning,
            pose,
            sighting,
            loop(steps["2b"]),
            {landmark: LANDMARK},
        ),
    }


def deviations(noise: str) -> dict[str, float]:
    """The standard deviations that `NOISE` means, read as "deviation" or as "variance"."""
    power = {"deviation": 1.0, "variance": 0.5}[noise]
    return {name: value**power for name, value in NOISE.items()}


def linear(std: Mapping[str, float], *, growth: float = DT) -> pgm.DynamicBayesianNetwork:
    """Problem 1: both axes get the one speed of both wheels, so the robot drives a diagonal.

    White noise in the velocity has the variance w² T after a step of T; `growth` is that T.
    """
    gain = 0.5 * RADIUS * DT * np.ones((2, 2))
    return pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(point, mean=np.zeros(2), cov=np.zeros((2, 2)))],
        transition=[
            pgm.LinearGaussianCPD(
                point,
                given={point.previous: 1.0, wheels: gain},
                cov=growth * diagonal((std["w_x"], std["w_y"])),
            )
        ],
        observation=[
            pgm.LinearGaussianCPD(
                fix, given={point: np.diag(SCALE)}, cov=diagonal((std["r_x"], std["r_y"]))
            )
        ],
    )


def loop(steps: int) -> Array:
    """Wheel speeds (T, 2) for a circle about the landmark through the origin, anticlockwise."""
    mean = SPEED / RADIUS
    turn_rate = SPEED / float(np.linalg.norm(LANDMARK))
    half = 0.5 * turn_rate * WHEELBASE / RADIUS
    return np.tile([mean - half, mean + half], (steps, 1))
