"""The time of one step of one robot: Table 8.2, and the trend over the number of samples."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from time import perf_counter
from typing import Any

import numpy as np
import numpy.typing as npt

import pgm
from experiments.linearisers.accuracy import monte_carlo
from experiments.linearisers.settings import CONTROL, Setting, simulate
from models.networks import velocity

# The report's seconds, on its machine.
REPORT = {
    "MC10000": 1.27180,
    "MC100": 0.01404,
    "MC10": 0.00161,
    "Unscented": 0.00161,
    "Taylor": 0.00160,
}
SAMPLES = (10, 30, 100, 300, 1000, 3000, 10_000, 30_000, 100_000)


@dataclass(frozen=True)
class Cost:
    """Seconds of one step of one robot, and how many of them went into the linearisation."""

    step: float
    linearisation: float


@dataclass(frozen=True)
class Line:
    """A cost of fixed + per_sample · N seconds."""

    fixed: float
    per_sample: float

    @property
    def knee(self) -> float:
        """The number of samples that cost as much as all the rest."""
        return self.fixed / self.per_sample

    def __call__(self, samples: npt.ArrayLike) -> npt.NDArray[np.float64]:
        """Seconds for numbers of samples."""
        return self.fixed + self.per_sample * np.asarray(samples, dtype=float)


def fit(samples: Sequence[int], seconds: Sequence[float]) -> Line:
    """The line with the least relative errors, Σ ((a + b N) / t − 1)²."""
    times = np.asarray(seconds)
    design = np.stack([1.0 / times, np.asarray(samples) / times], axis=-1)
    fixed, per_sample = np.linalg.lstsq(design, np.ones(times.size), rcond=None)[0]
    return Line(float(fixed), float(per_sample))


def techniques(seed: int) -> dict[str, pgm.Lineariser]:
    """The techniques of the report's table, and Monte Carlo with more and more samples."""
    sampled = {f"MC{n}": monte_carlo(n, seed) for n in SAMPLES}
    return {"Taylor": pgm.Taylor(), "Unscented": pgm.Unscented(), **sampled}


def measure(
    setting: Setting, rules: Mapping[str, pgm.Lineariser], seed: int, rounds: int
) -> dict[str, Cost]:
    """Time one step of one robot: the prediction from the prior and the update with a reading.

    The least of many is kept, since whatever else a machine does only adds. A round goes through
    all linearisers, so that a busy moment does not fall on one of them alone, and takes each step
    a few times, since the first finds the caches full of another's numbers.
    """
    network, sample = simulate(setting, 1, seed)
    inputs = {velocity: np.array(CONTROL)}
    readings = {setting.reading: sample[setting.reading][0, 0]}
    watches = {name: _Watch(rule) for name, rule in rules.items()}
    robots = {name: pgm.OnlineFilter(network, watch) for name, watch in watches.items()}
    initial = {name: robot.initial() for name, robot in robots.items()}
    least = dict.fromkeys(rules, np.inf)
    for _ in range(rounds):
        for name, robot in robots.items():
            for _ in range(3):
                start = perf_counter()
                robot.update(robot.predict(initial[name], inputs), readings)
                least[name] = min(least[name], perf_counter() - start)
    return {name: Cost(float(least[name]), watches[name].least) for name in rules}


def seconds(costs: Mapping[str, Cost], kind: str) -> dict[str, dict[str, float]]:
    """A kind of cost ("step", "linearisation") by the report's techniques, and by samples."""
    return {
        "by_technique": {name: getattr(costs[name], kind) for name in REPORT},
        "by_samples": {str(n): getattr(costs[f"MC{n}"], kind) for n in SAMPLES},
    }


def lines(costs: Mapping[str, Cost]) -> dict[str, Line]:
    """The line of each kind of cost."""
    found = {kind: seconds(costs, kind)["by_samples"] for kind in ("step", "linearisation")}
    return {kind: fit(SAMPLES, list(each.values())) for kind, each in found.items()}


class _Watch:
    """A lineariser that keeps the least time it took."""

    def __init__(self, rule: pgm.Lineariser) -> None:
        self.rule = rule
        self.least = float("inf")

    def __call__(self, function: Any, at: pgm.Gaussian) -> pgm.AffineGaussian:
        start = perf_counter()
        affine = self.rule(function, at)
        self.least = min(self.least, perf_counter() - start)
        return affine
