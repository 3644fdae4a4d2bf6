"""Each problem solved: many drives, filtered and smoothed, and numbers of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

import pgm
from experiments.differential_drive.errors import about_landmark, errors, later, mean_nees
from experiments.differential_drive.particles import Cloud, cloud
from experiments.differential_drive.problems import DT, MOTIONS, Problem, deviations, linear

Array = npt.NDArray[np.float64]

# Every CPD of problem 1 is linear, so that no lineariser is called.
EXACT: dict[str, pgm.Lineariser] = {"exact": pgm.Taylor()}
LINEARISERS: dict[str, pgm.Lineariser] = {"Taylor": pgm.Taylor(), "Unscented": pgm.Unscented()}


@dataclass(frozen=True, eq=False)
class Drive:
    """One drive: what was true, and what was believed at the steps 0 to T.

    Attributes
    ----------
    problem : Problem
    truth : ndarray
        (T+1, n).
    predicted, filtered, smoothed : Gaussian
        After each motion, after each reading too, and in the end.
    """

    problem: Problem
    truth: Array
    predicted: pgm.Gaussian
    filtered: pgm.Gaussian
    smoothed: pgm.Gaussian


@dataclass(frozen=True, eq=False)
class Solved:
    """Many drives of a problem.

    Attributes
    ----------
    problem : Problem
    truth : ndarray
        (runs, T+1, n).
    evidence : mapping
    posteriors : dict
        Smoothed, by lineariser.
    """

    problem: Problem
    truth: Array
    evidence: Mapping[pgm.Variable, Any]
    posteriors: dict[str, pgm.results.Posterior]

    def beliefs(self) -> dict[tuple[str, str], pgm.Gaussian]:
        """From step 1 on, by lineariser, and "filter" or "smoother"."""
        state = self.problem.state
        return {
            (name, kind): later(marginals[state])
            for name, posterior in self.posteriors.items()
            for kind, marginals in (("filter", posterior.filtered), ("smoother", posterior))
        }

    def numbers(self) -> dict[str, dict[str, Any]]:
        """Errors by lineariser and estimator, and the mean log-evidence by lineariser."""
        found: dict[str, dict[str, Any]] = {
            name: {"log_evidence": float(np.mean(posterior.log_evidence))}
            for name, posterior in self.posteriors.items()
        }
        for (name, kind), belief in self.beliefs().items():
            found[name][kind] = errors(belief, self.truth)
        return found

    def nees(self) -> dict[tuple[str, str], Array]:
        """The mean NEES of each step, (T,), by lineariser and estimator."""
        return {key: mean_nees(belief, self.truth) for key, belief in self.beliefs().items()}

    def drive(self, run: int = 0) -> Drive:
        """One of the drives, by the last lineariser."""
        posterior, state = list(self.posteriors.values())[-1], self.problem.state
        marginals = (posterior.predicted, posterior.filtered, posterior)
        return Drive(self.problem, self.truth[run], *(m[state].run(run) for m in marginals))

    def cloud(self, count: int, run: int = 0) -> Cloud:
        """One of the drives, followed by so many particles."""
        readings = self.evidence[self.problem.reading].values[run]
        return cloud(self.problem, readings, count, seed=run)


def solve(problem: Problem, runs: int, rng: np.random.Generator) -> Solved:
    """Draw drives, filter and smooth them."""
    truth, evidence = problem.sample(runs, rng)
    rules = EXACT if problem.name == "1" else LINEARISERS
    posteriors = {
        name: pgm.smooth(problem.network, evidence, lineariser=rule) for name, rule in rules.items()
    }
    return Solved(problem, truth, evidence, posteriors)


def held_noise(solved: Solved, meaning: str) -> dict[str, Any]:
    """The filter's errors on problem 1 if it takes white noise for one held over each step.

    Its noise of a step is then w T in place of w √T, too small by √8.
    """
    network = linear(deviations(meaning), growth=DT**2)
    posterior = pgm.filter(network, solved.evidence)
    return errors(later(posterior[solved.problem.state]), solved.truth)


def spread(solved: Solved) -> dict[str, list[float]]:
    """How unsure the filter is each second, about the landmark [m], over all runs (RMS)."""
    state, measured = solved.problem.state, solved.problem.measured
    belief = list(solved.posteriors.values())[-1].filtered[state]
    radial, tangential = about_landmark(belief)
    return {
        "second": (measured / MOTIONS).tolist(),
        "radial": np.sqrt(np.mean(radial[:, measured] ** 2, axis=0)).tolist(),
        "tangential": np.sqrt(np.mean(tangential[:, measured] ** 2, axis=0)).tolist(),
    }
