"""Targets that go straight or turn at several rates, and are read by their places."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

import pgm
from models import tracking
from models.networks import fix, target

Array = npt.NDArray[np.float64]

STAY = 0.9  # the probability of a mode to last another step
FASTEST = 0.3  # of turns [rad/s]


@dataclass(frozen=True, eq=False)
class Manoeuvres:
    """Runs of T steps of a target with several motions.

    Attributes
    ----------
    network : DynamicBayesianNetwork
        Its mode is uniform at step 0.
    mode : Discrete
        The motion of a step.
    motions, noises : ndarray
        (modes, 4, 4): the transition matrix and the covariance of the noise in each mode.
    table : ndarray
        (modes, modes): p(mode | mode before).
    readings : ndarray
        (runs, T, 2): places [m].
    """

    network: pgm.DynamicBayesianNetwork
    mode: pgm.Discrete
    motions: Array
    noises: Array
    table: Array
    readings: Array

    @property
    def steps(self) -> int:
        """T."""
        return int(self.readings.shape[1])

    @property
    def first(self) -> tuple[Array, Array]:
        """The mean and covariance of the state at step 0."""
        cpd = self.network.prior[1]
        assert isinstance(cpd, pgm.GaussianCPD)
        return np.array(cpd.mean), np.array(cpd.cov)

    @property
    def sensor(self) -> tuple[Array, Array]:
        """The matrix and the noise's covariance of the places that are read."""
        return np.eye(2, 4), 25.0 * np.eye(2)


def draw(modes: int, steps: int, runs: int = 1, seed: int = 0) -> Manoeuvres:
    """A target whose modes turn at rates from −`FASTEST` to `FASTEST`, evenly apart."""
    rates = np.linspace(-FASTEST, FASTEST, modes)
    motions = np.stack([tracking.known_turn(1.0, rate) for rate in rates])
    noises = np.stack([tracking.white_acceleration(1.0, 0.01 + abs(rate)) for rate in rates])
    table = np.full((modes, modes), (1.0 - STAY) / (modes - 1))
    np.fill_diagonal(table, STAY)
    mode = pgm.Discrete("mode", modes)
    network = pgm.DynamicBayesianNetwork(
        prior=[
            pgm.TableCPD(mode, table=np.full(modes, 1.0 / modes)),
            pgm.GaussianCPD(target, [0.0, 0.0, 10.0, 0.0], np.diag([100.0, 100.0, 4.0, 4.0])),
        ],
        transition=[
            pgm.TableCPD(mode, given=mode.previous, table=table),
            pgm.SwitchingCPD(
                target,
                given=mode,
                cases={
                    state: pgm.LinearGaussianCPD(
                        target, given={target.previous: motions[state]}, cov=noises[state]
                    )
                    for state in range(modes)
                },
            ),
        ],
        observation=[pgm.LinearGaussianCPD(fix, given={target: np.eye(2, 4)}, cov=25.0)],
    )
    drawn = network.sample(steps=steps, runs=(runs,), rng=seed)
    return Manoeuvres(network, mode, motions, noises, table, np.array(drawn[fix]))
