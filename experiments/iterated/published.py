"""Numbers that were published, and how far ours are from them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

import pgm
from experiments.iterated import growth
from experiments.iterated.case import Case
from experiments.iterated.growth import MAIN, Reading
from experiments.iterated.methods import Score, solve

# Filter, smoother, and after 1, 5 and 10 relinearisations.
_SERIES = (("filter", 1), ("smoother", 1), ("smoother", 2), ("smoother", 6), ("smoother", 11))
Key = tuple[str, int]  # kind and linearisations


@dataclass(frozen=True)
class Number:
    """A published number: which quantity of which method."""

    method: Key
    value: float
    quantity: str = "rmse"


def _rmse(*values: float) -> tuple[Number, ...]:
    return tuple(Number(key, value) for key, value in zip(_SERIES, values, strict=True))


GROWTH: dict[str, dict[str, tuple[Number, ...]]] = {
    "cubic": {
        "Unscented": _rmse(2.30, 2.02, 1.17, 0.44, 0.41),
        "Taylor": _rmse(8.66, 7.48, 4.72, 1.02, 0.77),
    },
    "square": {
        "Unscented": (
            Number(("filter", 1), 2.22),
            Number(("smoother", 1), 1.91),
            Number(("smoother", 11), 1.79),
            Number(("smoother", 1), 6.4, "nees"),
            Number(("smoother", 11), 10.1, "nees"),
        )
    },
}
CHAIN: dict[str, tuple[Number, ...]] = {
    "Unscented1e-3": (Number(("filter", 1), 0.444),),
    "GaussHermite5": (Number(("filter", 1), 0.451),),
    "Taylor": (Number(("filter", 1), 0.489),),
    # Given as .485 to .495.
    "Cubature": (Number(("filter", 10), 0.490),),
}


@dataclass(frozen=True)
class Comparison:
    """One published number beside ours.

    Attributes
    ----------
    number : Number
    ours : tuple of float
        Of each seed.
    standard_error : float
        Of one seed, pooled over seeds.
    medians : tuple of float
        For each seed, the median over runs of a run's RMSE, or over runs and steps of NEES.
    """

    number: Number
    ours: tuple[float, ...]
    standard_error: float
    medians: tuple[float, ...]

    @property
    def mean(self) -> float:
        """Over seeds."""
        return float(np.mean(self.ours))

    @property
    def z(self) -> float:
        """The difference in its standard errors; the published number's is one seed's."""
        deviation = self.standard_error * np.sqrt(1.0 + 1.0 / len(self.ours))
        return float((self.mean - self.number.value) / deviation)

    def as_dict(self) -> dict[str, Any]:
        """For a summary."""
        return {
            "quantity": self.number.quantity,
            "kind": self.number.method[0],
            "iterations": self.number.method[1],
            "published": self.number.value,
            "mean": self.mean,
            "seeds": self.ours,
            "standard_error": self.standard_error,
            "medians": self.medians,
            "z": self.z,
        }


def compare(
    cases: Sequence[Case], lineariser: pgm.Lineariser, numbers: Sequence[Number]
) -> list[Comparison]:
    """Published numbers of one lineariser beside ours, one case a seed."""
    methods = dict.fromkeys(number.method for number in numbers)
    scores = {
        (kind, k): [solve(case, lineariser, kind, "plain", k).score for case in cases]
        for kind, k in methods
    }
    return [_comparison(number, scores[number.method]) for number in numbers]


def growth_cases(sensor: str, runs: int, seeds: Sequence[int], how: Reading = MAIN) -> list[Case]:
    """A sample for each seed."""
    return [growth.simulate(sensor, runs, seed, how) for seed in seeds]


def up_to(numbers: Sequence[Number], most: int) -> list[Number]:
    """The numbers of methods with so many linearisations at the most."""
    return [number for number in numbers if number.method[1] <= most]


def other_readings(runs: int, seed: int, most: int) -> dict[str, list[Comparison]]:
    """The cubic case read in other ways, one seed."""
    return {
        how.title: compare(
            growth_cases("cubic", runs, [seed], how),
            growth.LINEARISERS["Unscented"],
            up_to(GROWTH["cubic"]["Unscented"], most),
        )
        for how in growth.OTHERS
    }


def furthest(found: Mapping[str, Sequence[Comparison]]) -> float:
    """The largest |z|."""
    return max((abs(one.z) for each in found.values() for one in each), default=0.0)


def _comparison(number: Number, scores: Sequence[Score]) -> Comparison:
    quantity, median = number.quantity, {"rmse": "median", "nees": "nees_median"}[number.quantity]
    errors = [getattr(score, f"{quantity}_se") for score in scores]
    return Comparison(
        number,
        ours=tuple(getattr(score, quantity) for score in scores),
        standard_error=float(np.sqrt(np.mean(np.square(errors)))),
        medians=tuple(getattr(score, median) for score in scores),
    )
