"""The rules that are compared, and what each costs."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from time import perf_counter
from typing import Any

import numpy as np
import numpy.typing as npt

import pgm
from experiments.nonlinear_measurement.cases import Array, Case
from experiments.unsettled import unsettled

Mask = npt.NDArray[np.bool_]

# The rule that linearises the sensors again, and the motion once.
ITERATED = "IteratedCubature"
# Where the last linearisation moved no mean by more than this, in deviations, it came to rest.
SETTLED = 0.01
# Of the schedules, so that all linearisations are made.
TOLERANCE = 1e-9


@dataclass(frozen=True)
class Rule:
    """A lineariser, a schedule, and how often it linearises.

    Attributes
    ----------
    lineariser : Lineariser
    iterations : int
        Linearisations at the most.
    lag : float
        0 of a filter, which linearises a step's sensors again; 1 of a fixed-lag smoother and
        `math.inf` of a smoother, which linearise the motion again too.
    """

    lineariser: pgm.Lineariser
    iterations: int = 1
    lag: float = 0

    @unsettled()
    def solve(self, case: Case, lineariser: pgm.Lineariser | None = None) -> pgm.results.Posterior:
        """The beliefs of all simulations of a case at once."""
        rule = lineariser or self.lineariser
        if self.lag == 0:
            return pgm.filter(
                case.model,
                case.evidence,
                lineariser=rule,
                steps=1,
                iterations=self.iterations,
                tolerance=TOLERANCE,
            )
        lag = None if self.lag == math.inf else int(self.lag)
        return pgm.smooth(
            case.model,
            case.evidence,
            lineariser=rule,
            lag=lag,
            steps=1,
            iterations=self.iterations,
            tolerance=TOLERANCE,
        )


def rules(seed: int) -> dict[str, Rule]:
    """By name; the sampled rules draw other points for each simulation."""
    return {
        "Taylor": Rule(pgm.Taylor()),
        "Unscented": Rule(pgm.Unscented()),
        "Cubature": Rule(pgm.Cubature()),
        "GaussHermite5": Rule(pgm.GaussHermite(5)),
        "MonteCarlo10": Rule(pgm.MonteCarlo(10, seed=seed, fresh_per_run=True)),
        "MonteCarlo100": Rule(pgm.MonteCarlo(100, seed=seed, fresh_per_run=True)),
        "Antithetic10": Rule(pgm.MonteCarlo(10, seed=seed, fresh_per_run=True, antithetic=True)),
        ITERATED: Rule(pgm.Cubature(), iterations=10),
        "IteratedSmoother": Rule(pgm.Cubature(), iterations=10, lag=math.inf),
        "IteratedLag": Rule(pgm.Cubature(), iterations=10, lag=1),
        "TaylorSmoother": Rule(pgm.Taylor(), iterations=10, lag=math.inf),
    }


def settled(status: pgm.results.Status) -> Mask:
    """In which simulations iterating came to rest; where nothing is to iterate, in all."""
    if not len(status.residuals):
        return np.ones(status.converged.shape, dtype=bool)
    return np.asarray(status.residuals[-1] <= SETTLED)


@dataclass(frozen=True)
class Cost:
    """Of one step of one robot.

    Attributes
    ----------
    evaluations : float
        Of the motion's and the sensor's function, Jacobians counted as one each.
    microseconds : float
        Measured, all simulations in one batch.
    """

    evaluations: float
    microseconds: float


def cost(rule: Rule, case: Case, repeats: int = 3) -> Cost:
    """Count a rule's evaluations, and take the least time of some repeats."""
    tally = Tally(rule.lineariser)
    rule.solve(case, tally)
    times = []
    for _ in range(repeats):
        start = perf_counter()
        rule.solve(case)
        times.append(perf_counter() - start)
    runs = len(case.truth)
    return Cost(tally.count[0] / runs, 1e6 * min(times) / runs)


@dataclass(frozen=True, eq=False)
class Tally:
    """A lineariser that counts how often another one asks for a value or a Jacobian."""

    inner: Callable[[Any, pgm.Gaussian], pgm.AffineGaussian]
    count: list[int] = field(default_factory=lambda: [0])

    def __call__(self, function: Any, at: pgm.Gaussian, /) -> pgm.AffineGaussian:
        """Linearise with the inner one."""
        return self.inner(_Counted(function, self.count), at)


class _Counted:
    """A function that adds the rows it is asked for to a count."""

    def __init__(self, function: Any, count: list[int]) -> None:
        self._function, self._count = function, count

    def __call__(self, x: Array) -> Array:
        self._count[0] += int(np.prod(x.shape[:-1]))
        return np.asarray(self._function(x))

    def jacobian(self, x: Array, std: Array | None = None) -> Array:
        self._count[0] += int(np.prod(x.shape[:-1]))
        return np.asarray(self._function.jacobian(x, std))

    def __getattr__(self, name: str) -> Any:
        return getattr(self._function, name)
