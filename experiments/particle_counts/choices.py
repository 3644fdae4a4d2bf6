"""Choices of a particle filter: how to draw anew, and how many particles at each step."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

import pgm
from experiments.differential_drive.particles import follow
from experiments.differential_drive.problems import Problem
from experiments.particle_counts.study import Estimate, Study, mean_square
from models.networks import pose

Array = npt.NDArray[np.float64]

RESAMPLERS = ("multinomial", "residual", "stratified", "systematic")
# Widths of bins [m, m, rad], and bounds of the numbers.
WIDTHS = {"east": 0.5, "north": 0.5, "heading": 0.2}
LEAST, MOST = 100, 10_000
# What is known of an unknown start [m, m, rad].
UNKNOWN = (3.0, 3.0, 1.0)
LOST = 8.0  # m, five deviations of the widest belief


@dataclass(frozen=True)
class Drawn:
    """The error and the cost of a way of drawing anew.

    Attributes
    ----------
    distance : Estimate
        From the exact means, root mean square [m].
    spread : Estimate
        Of the log-evidence about the exact one, root mean square.
    """

    distance: Estimate
    spread: Estimate


def resamplers(linear: Study, count: int, repeats: int, seed: int) -> dict[str, Drawn]:
    """Each way on the linear problem, drawing anew at every step, beside the exact answer.

    Parameters
    ----------
    linear : Study
    count : int
        Of particles.
    repeats : int
        How often all drives are filtered, with seeds of their own.
    seed : int
    """
    problem = linear.problem
    at = pgm.sightings(linear.readings, step=problem.measured)
    (inputs,) = problem.network.transition[0].given[1:]
    exact = pgm.filter(problem.network, {inputs: problem.controls, problem.reading: at})
    found = {}
    for name in RESAMPLERS:
        squares, spreads = [], []
        for k in range(repeats):
            particles = pgm.Particles(count, seed=seed + k, resampling=name, threshold=1.0)
            followed = follow(problem, linear.readings, particles)
            squares.append(mean_square(followed.mean, linear.exact))
            spreads.append((followed.log_evidence - exact.log_evidence) ** 2)
        # A drive's repeats go together: its mean is one number.
        found[name] = Drawn(
            Estimate.of(np.mean(squares, axis=0)).root, Estimate.of(np.mean(spreads, axis=0)).root
        )
    return found


@dataclass(frozen=True, eq=False)
class Adapted:
    """Numbers of particles that KLD-sampling chose.

    Attributes
    ----------
    title : str
    number : ndarray of int
        (runs, T+1).
    spread : ndarray
        (T+1,): root mean square standard deviation of the position [m].
    last : ndarray
        (runs,): errors of the position at the last step [m].
    """

    title: str
    number: npt.NDArray[np.int_]
    spread: Array
    last: Array

    @property
    def medians(self) -> tuple[int, int]:
        """The median number after the first step, and at the end."""
        first, last = np.median(self.number[:, [1, -1]], axis=0)
        return int(first), int(last)

    @property
    def lost(self) -> int:
        """The number of drives that end where no belief of 2a or 2b reaches."""
        return int((self.last > LOST).sum())

    def numbers(self) -> dict[str, Any]:
        """For a summary."""
        return {
            "title": self.title,
            "median": np.median(self.number, axis=0),
            "least": self.number.min(axis=0),
            "most": self.number.max(axis=0),
            "spread": self.spread,
            "last": self.last,
            "lost": self.lost,
        }


def adapted(chosen: dict[str, Problem], runs: int, seed: int) -> dict[str, Adapted]:
    """KLD-sampling where the belief stays narrow, where it grows, and where it shrinks.

    Parameters
    ----------
    chosen : dict of str to Problem
        Problems 2a and 2b among them.
    runs : int
    seed : int
    """
    cases = {
        "narrow": ("2a, from a known start", chosen["2a"]),
        "growing": ("2b, from a known start", chosen["2b"]),
        "shrinking": ("2a, from an unknown start", from_unknown(chosen["2a"])),
    }
    particles = pgm.Particles(
        MOST, seed=seed, number=pgm.KLDSampling(WIDTHS, least=LEAST, most=MOST)
    )
    found = {}
    for name, (title, problem) in cases.items():
        truth, evidence = problem.sample(runs, np.random.default_rng(seed))
        followed = follow(problem, np.asarray(evidence[problem.reading].values), particles)
        variance = followed.cov[..., 0, 0] + followed.cov[..., 1, 1]
        found[name] = Adapted(
            title,
            followed.number,
            np.sqrt(variance.mean(axis=0)),
            np.linalg.norm((followed.mean - truth)[:, -1, :2], axis=-1),
        )
    return found


def from_unknown(problem: Problem) -> Problem:
    """The problem with a start that is known to some metres."""
    (prior,) = problem.network.prior
    assert isinstance(prior, pgm.GaussianCPD)
    wide = pgm.GaussianCPD(pose, mean=prior.mean, cov=np.diag(np.square(UNKNOWN)))
    network = problem.network.replace(prior=[wide])
    return Problem(
        problem.name,
        problem.title,
        network,
        problem.state,
        problem.reading,
        problem.controls,
        problem.given,
    )
