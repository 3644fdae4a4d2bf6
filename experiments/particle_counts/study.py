"""Particles of several numbers on the same drives, beside Kalman filters and the exact answer."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

import pgm
from experiments.differential_drive.particles import Followed, follow
from experiments.differential_drive.problems import Problem
from experiments.differential_drive.results import EXACT, LINEARISERS

Array = npt.NDArray[np.float64]

KALMAN = {"exact": "Kalman filter", "Taylor": "extended Kalman", "Unscented": "unscented Kalman"}


@dataclass(frozen=True)
class Estimate:
    """A mean over drives, and its standard error."""

    value: float
    error: float

    @staticmethod
    def of(values: Array) -> Estimate:
        """The mean of one number a drive."""
        return Estimate(float(values.mean()), float(values.std(ddof=1) / np.sqrt(len(values))))

    @property
    def root(self) -> Estimate:
        """The root of a mean square."""
        root = float(np.sqrt(self.value))
        return Estimate(root, self.error / (2.0 * root) if root else 0.0)

    @property
    def numbers(self) -> dict[str, float]:
        """For a summary."""
        return {"value": self.value, "error": self.error}


@dataclass(frozen=True, eq=False)
class Study:
    """Drives of a problem, and every estimator's beliefs of them.

    Attributes
    ----------
    problem : Problem
    truth : ndarray
        (runs, T+1, n).
    readings : ndarray
        (runs, M, 2).
    kalman : dict of str to Gaussian
        Filtered, by lineariser; ``exact`` alone where the problem is linear.
    particles : dict of int to Followed
        By their number.
    reference : int or None
        The number of particles that stands for the exact answer; None where the Kalman filter is.
    exact : ndarray
        (runs, T+1, n): the means of the exact posterior, or of the reference.
    """

    problem: Problem
    truth: Array
    readings: Array
    kalman: dict[str, pgm.Gaussian]
    particles: dict[int, Followed]
    reference: int | None
    exact: Array

    @property
    def means(self) -> dict[str, Array]:
        """Every estimator's means (runs, T+1, n), by its name."""
        found = {KALMAN[name]: belief.mean for name, belief in self.kalman.items()}
        found |= {label(count): each.mean for count, each in self.particles.items()}
        if self.reference is not None:
            found[label(self.reference)] = self.exact
        return found

    def distances(self) -> dict[int, Estimate]:
        """Root mean square distances [m] from the exact means, by the number of particles."""
        return {
            count: Estimate.of(mean_square(each.mean, self.exact)).root
            for count, each in self.particles.items()
        }

    def numbers(self) -> dict[str, dict[str, Any]]:
        """By estimator: RMSE [m], excess over the exact answer's mean square error, and distance.

        ``excess`` [m²] is of the same drives, ``worse`` the fraction of drives where it is above 0.
        """
        best = mean_square(self.exact, self.truth)
        found = {}
        for name, mean in self.means.items():
            error = mean_square(mean, self.truth)
            excess = error - best
            found[name] = {
                "rmse": Estimate.of(error).root.numbers,
                "excess": Estimate.of(excess).numbers,
                "worse": float((excess > 0.0).mean()),
                "distance": Estimate.of(mean_square(mean, self.exact)).root.numbers,
            }
        return found

    def ratio(self, numbers: dict[str, Any]) -> tuple[float, float]:
        """An estimator's RMSE in units of the exact answer's, and its standard error, paired."""
        best = float(mean_square(self.exact, self.truth).mean())
        ratio = float(np.sqrt(1.0 + numbers["excess"]["value"] / best))
        return ratio, numbers["excess"]["error"] / (2.0 * ratio * best)

    def constant(self) -> float:
        """The c of distances c √(1/N + 1/M), M being the reference's number, of the largest N."""
        count = max(self.particles)
        return self.distances()[count].value / float(self.falling(np.array([count]))[0])

    def own_error(self) -> float:
        """How far the reference is from the exact means, as `constant` foretells [m]."""
        return 0.0 if self.reference is None else self.constant() / float(np.sqrt(self.reference))

    def slope(self) -> float:
        """The slope of ln distance over ln N, over the three largest numbers.

        It is −1/2 where the distance falls as 1/√N; the reference's part is taken away first.
        """
        largest = np.array(sorted(self.particles)[-3:])
        found = self.distances()
        distance = np.array([found[int(count)].value for count in largest])
        own = distance / (self.falling(largest) * np.sqrt(largest))
        return float(np.polyfit(np.log(largest), np.log(own), 1)[0])

    def falling(self, counts: npt.NDArray[Any]) -> Array:
        """√(1/N + 1/M): how distances fall with their number."""
        left = 0.0 if self.reference is None else 1.0 / self.reference
        found: Array = np.sqrt(1.0 / counts + left)
        return found


def study(problem: Problem, runs: int, counts: tuple[int, ...], reference: int, seed: int) -> Study:
    """Draw drives, and filter them in every way."""
    truth, evidence = problem.sample(runs, np.random.default_rng(seed))
    readings = np.asarray(evidence[problem.reading].values)
    linear = problem.name == "1"
    kalman = {
        name: pgm.filter(problem.network, evidence, lineariser=rule)[problem.state]
        for name, rule in (EXACT if linear else LINEARISERS).items()
    }
    particles = {
        # Seeds of their own, so that none repeats the draws of another.
        count: follow(problem, readings, pgm.Particles(count, seed=seed + k + 1))
        for k, count in enumerate(counts)
    }
    if linear:
        return Study(problem, truth, readings, kalman, particles, None, kalman["exact"].mean)
    exact = follow(problem, readings, pgm.Particles(reference, seed=seed)).mean
    return Study(problem, truth, readings, kalman, particles, reference, exact)


def mean_square(means: Array, others: Array) -> Array:
    """Mean square distance in the plane of each run [m²], (runs,), the known start apart."""
    apart = (means - others)[:, 1:, :2]
    found: Array = np.sum(apart**2, axis=-1).mean(axis=1)
    return found


def label(count: int) -> str:
    """The name of so many particles in tables."""
    return f"{count:,} particles"
