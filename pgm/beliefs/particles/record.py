"""The record of a forward sweep of particles: clouds by step, and what happened to them."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from pgm.beliefs.particles.figures import ParticleFigures
from pgm.beliefs.points.cloud import Cloud
from pgm.kernels.arrays import Array


class Record:
    """The record of a forward sweep: its clouds, and what happened at each step in each run.

    steps: The number of the last step, T.

    clouds: The weighted particles given the measurements up to each step, one cloud for each call
        of `keep`.
    predicted: Those given the measurements before each step, with weights not yet normalised.
    log_density: ln p(z_t | z_0..t−1), estimated; z_t are the measurements of step t.
    effective, number: The number of effective particles, 1 / Σ w² with the weights w, and of all.
    resampled: Whether the particles were drawn anew on the way to the step.
    injected: The number of particles that were replaced by draws elsewhere.
    ignored, restarted: Whether no particle explained the step's measurements, so that these were
        ignored, or the run was restarted from the prior.

    The arrays, all but the clouds, are (T+1, runs), and zero until they are written.
    """

    def __init__(self, steps: int, runs: int) -> None:
        shape = steps + 1, runs
        self.clouds: list[Cloud] = []
        self.predicted: list[Cloud] = []
        self.log_density, self.effective = np.zeros(shape), np.zeros(shape)
        self.number, self.injected = np.zeros(shape, dtype=int), np.zeros(shape, dtype=int)
        self.resampled = np.zeros(shape, dtype=bool)
        self.ignored, self.restarted = np.zeros(shape, dtype=bool), np.zeros(shape, dtype=bool)

    def keep(self, step: int, predicted: Cloud, known: Cloud, log_density: Array | float) -> None:
        """Keep a step's cloud given its measurements, and their log-density.

        The number of its particles, and their effective number, are written, too.

        predicted: The cloud before the measurements.
        known: The cloud given the measurements.
        log_density: ln p(z_t | z_0..t−1), (runs,), or 0 at a step without measurements.
        """
        self.predicted.append(predicted)
        self.clouds.append(known)
        self.log_density[step] = log_density
        self.effective[step], self.number[step] = known.effective, known.counts

    def figures(self, lead: tuple[int, ...], unmoved: Array | None = None) -> ParticleFigures:
        """The status of the sweep, in arrays (*lead, T+1), `lead` being the user's axes of runs.

        unmoved: Of a smoother, (T, runs), the share of trajectories that backward simulation left
            at the ancestors that the filter had given them; None of a filter.
        """

        def by_run(values: npt.NDArray[Any]) -> npt.NDArray[Any]:
            """Values (steps, runs) as (*lead, steps), `lead` being the user's axes of runs."""
            return np.ascontiguousarray(values.T).reshape(*lead, -1)

        return ParticleFigures(
            by_run(self.effective),
            by_run(self.number),
            by_run(self.resampled),
            by_run(self.injected),
            by_run(self.ignored),
            by_run(self.restarted),
            None if unmoved is None else by_run(unmoved),
        )
