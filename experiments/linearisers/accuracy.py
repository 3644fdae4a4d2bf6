"""How far a belief after one step is from the best Gaussian: Table 8.1."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from time import perf_counter
from typing import Any

import numpy as np
import numpy.typing as npt

import pgm
from experiments.linearisers.settings import Setting, simulate, unwrapped
from models.networks import pose
from pgm.results import Sample

Array = npt.NDArray[np.float64]

# The report's averages.
REPORT = {"MC100": 0.0057, "MC10": 0.0744, "Taylor": 0.0758, "Unscented": 0.0769}
# Sample sizes of the trend over N, and how many points its simulations draw in all.
SIZES = (10, 30, 100, 300, 1000, 3000)
POINTS = 1_000_000
FALLING = 30  # samples from which the trend falls as 1 / N


def monte_carlo(samples: int, seed: int) -> pgm.MonteCarlo:
    """The report's rule: the prior's own moments, and points drawn anew in each simulation."""
    return pgm.MonteCarlo(samples, seed, prior_moments=True, fresh_per_run=True)


def very_many(samples: int, seed: int) -> pgm.Lineariser:
    """The rule of the truth: samples of a belief that all simulations hold."""
    return _Shared(pgm.MonteCarlo(samples, seed, prior_moments=True))


def rules(seed: int) -> dict[str, pgm.Lineariser]:
    """The techniques of Table 8.1, in its order."""
    *_, hundred, ten = seeds(seed, 4)
    return {
        "MC100": monte_carlo(100, hundred),
        "MC10": monte_carlo(10, ten),
        "Taylor": pgm.Taylor(),
        "Unscented": pgm.Unscented(),
    }


def seeds(seed: int, count: int) -> list[int]:
    """Independent seeds from one: of simulations, of the truth, then of each sampled rule."""
    return [int(word) for word in np.random.SeedSequence(seed).generate_state(count)]


@dataclass(frozen=True, eq=False)
class Outcome:
    """One technique in each simulation.

    Attributes
    ----------
    posterior : Posterior
        What the filter found.
    divergence : ndarray
        KL(truth ‖ belief) at step 1, (runs,), in nats.
    unwrapped : float
        The average divergence, were the difference of headings not wrapped.
    indefinite : float
        The share of simulations in which the noise of the linearised motion is indefinite.
    seconds : float
        Time of the filter, all simulations at once.
    """

    posterior: pgm.results.Posterior
    divergence: Array
    unwrapped: float
    indefinite: float
    seconds: float

    @property
    def mean(self) -> float:
        """The average divergence."""
        return float(self.divergence.mean())

    @property
    def standard_error(self) -> float:
        """Of the average, from the spread over simulations."""
        return float(self.divergence.std(ddof=1) / np.sqrt(self.divergence.size))

    @property
    def median(self) -> float:
        """The median divergence."""
        return float(np.median(self.divergence))


@dataclass(frozen=True, eq=False)
class Trial:
    """Simulated first steps, and the best Gaussian posterior of each.

    Attributes
    ----------
    setting : Setting
    network : DynamicBayesianNetwork
    sample : Sample
        Poses (runs, 2, 3) and readings (runs, 1, d).
    best : Posterior
        Its prediction has the moments of very many samples, the same for all simulations.
    """

    setting: Setting
    network: pgm.DynamicBayesianNetwork
    sample: Sample
    best: pgm.results.Posterior

    @classmethod
    def draw(cls, setting: Setting, runs: int, truth_samples: int, seed: int) -> Trial:
        """Simulate, and find the best posteriors."""
        simulations, truth, *_ = seeds(seed, 4)
        network, sample = simulate(setting, runs, simulations)
        rule = very_many(truth_samples, truth)
        best = pgm.filter(network, sample.evidence, lineariser=rule, steps=1)
        return cls(setting, network, sample, best)

    def filter(self, lineariser: pgm.Lineariser, runs: int | None = None) -> Outcome:
        """Filter the simulations, or the first of them, with a lineariser."""
        kept = _Kept(lineariser)
        reading = self.setting.reading
        evidence = {**self.sample.evidence, reading: self.sample[reading][:runs]}
        start = perf_counter()
        posterior = pgm.filter(self.network, evidence, lineariser=kept, steps=1)
        seconds = perf_counter() - start
        best = self.best[pose.at(1)]
        found = posterior[pose.at(1)]
        truth = pgm.Gaussian(best.scope, best.mean[:runs], best.cov[:runs])
        line = pgm.Gaussian(unwrapped, truth.mean, truth.cov)
        plain = float(line.kl(pgm.Gaussian(unwrapped, found.mean, found.cov)).mean())
        least = np.linalg.eigvalsh(kept.affine.cov + self.setting.motion_cov)[..., 0]
        indefinite = float((least < 0.0).mean())
        return Outcome(posterior, truth.kl(found), plain, indefinite, seconds)


def by_samples(trial: Trial, seed: int) -> dict[str, dict[str, float]]:
    """Monte Carlo's average divergence by number of samples, and N times it.

    The more samples, the fewer simulations: the relative error of an average does not depend on N.
    """
    table: dict[str, dict[str, float]] = {}
    runs = trial.sample[pose].shape[0]
    for n, each in zip(SIZES, seeds(seed, 4 + len(SIZES))[4:], strict=True):
        count = min(runs, POINTS // n)
        outcome = trial.filter(monte_carlo(n, each), count)
        table[str(n)] = {
            "simulations": count,
            "mean": outcome.mean,
            "standard_error": outcome.standard_error,
            "times_samples": n * outcome.mean,
        }
    return table


def constant(by_samples: Mapping[str, Mapping[str, float]]) -> float:
    """The c of c / N through the averages where they fall so, in the mean of the logarithms."""
    falling = [each["times_samples"] for n, each in by_samples.items() if int(n) >= FALLING]
    return float(np.exp(np.mean(np.log(falling))))


def second_truth(trial: Trial, truth_samples: int, seed: int) -> float:
    """The average divergence of the truth from another one, of as many other samples."""
    return trial.filter(very_many(truth_samples, seeds(seed, 5 + len(SIZES))[-1])).mean


class _Shared:
    """A lineariser for runs that hold one belief: it is linearised once, for all of them."""

    def __init__(self, rule: pgm.Lineariser) -> None:
        self.rule = rule

    def __call__(self, function: Any, at: pgm.Gaussian) -> pgm.AffineGaussian:
        affine = self.rule(function, pgm.Gaussian(at.scope, at.mean[:1], at.cov[:1]))
        return pgm.AffineGaussian(affine.F[0], affine.b[0], affine.cov[0])


class _Kept:
    """A lineariser that keeps what it made last."""

    affine: pgm.AffineGaussian

    def __init__(self, rule: pgm.Lineariser) -> None:
        self.rule = rule

    def __call__(self, function: Any, at: pgm.Gaussian) -> pgm.AffineGaussian:
        self.affine = self.rule(function, at)
        return self.affine
