"""Ways of iterating, and what each leaves of the errors."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from time import perf_counter
from typing import Any

import numpy as np
import numpy.typing as npt

import pgm
from experiments.iterated.case import Case
from experiments.unsettled import unsettled
from pgm.consistency import error

Array = npt.NDArray[np.float64]

KINDS = ("filter", "smoother")
CONTROLS: dict[str, pgm.LevenbergMarquardt | float] = {
    "plain": 0.0,
    "damped": 0.5,
    "lm": pgm.LevenbergMarquardt(),
}
TITLES = {"plain": "plain", "damped": "damped by a half", "lm": "Levenberg–Marquardt"}
# Standard deviations by which no mean moves any more.
TOLERANCE = 1e-6
# Standard deviations by which no mean of a run at rest moved at the last linearisation.
AT_REST = 0.01
# The share of runs, those with the largest errors, that a trimmed RMSE leaves out.
WORST = 0.05


@dataclass(frozen=True)
class Score:
    """Errors of a method over all runs and steps.

    Attributes
    ----------
    rmse, rmse_se : float
        √ of the mean squared error, and its standard error, from the spread over runs.
    median : float
        The median over runs of the RMSE of a run.
    trimmed : float
        The RMSE without the worst `WORST` of runs.
    tail, nees_tail : float
        What the worst `WORST` of runs make of the sum of squared errors, and of NEES.
    lost : float
        The share of runs whose RMSE is above a bound.
    nees, nees_se, nees_median : float
        The mean over runs and steps, its standard error, and the median. A right belief over n
        components has a mean of n.
    converged : float
        The share of runs that converged; 0 after a single linearisation, which was not iterated.
    settled : float or None
        The share of runs at rest, the last linearisation having moved no mean by more than
        `AT_REST` deviations; None after a single one.
    seconds : float
    """

    rmse: float
    rmse_se: float
    median: float
    trimmed: float
    tail: float
    lost: float
    nees: float
    nees_se: float
    nees_median: float
    nees_tail: float
    converged: float
    settled: float | None
    seconds: float


@dataclass(frozen=True, eq=False)
class Outcome:
    """A method's belief in all runs, and its errors.

    Attributes
    ----------
    belief : Gaussian
    squares : ndarray
        (runs, steps): squared errors, of the steps that count.
    residuals : ndarray
        (iterations − 1, runs).
    score : Score
    """

    belief: pgm.Gaussian
    squares: Array
    residuals: Array
    score: Score

    @property
    def by_run(self) -> Array:
        """The RMSE of each run, (runs,)."""
        return np.asarray(np.sqrt(self.squares.mean(axis=1)))

    @property
    def by_step(self) -> Array:
        """The RMSE at each step, (steps,)."""
        return np.asarray(np.sqrt(self.squares.mean(axis=0)))


# By kind, control and number of linearisations.
Grid = Mapping[str, Mapping[str, Mapping[int, Outcome]]]


@unsettled()
def solve(
    case: Case,
    lineariser: pgm.Lineariser,
    kind: str,
    control: str,
    iterations: int,
) -> Outcome:
    """Filter or smooth all runs, and judge the belief."""
    kinds: dict[str, Callable[..., pgm.results.Posterior]] = {
        "filter": pgm.filter,
        "smoother": pgm.smooth,
    }
    infer = kinds[kind]
    start = perf_counter()
    posterior = infer(
        case.model,
        case.evidence,
        lineariser=lineariser,
        iterations=iterations,
        damping=CONTROLS[control],
        tolerance=TOLERANCE,
    )
    seconds = perf_counter() - start
    belief = posterior[case.variable]
    wrong = error(belief, case.truth)[:, case.first :]
    squares = (wrong[..., : case.components] ** 2).sum(axis=-1)
    residuals = posterior.status.residuals
    return Outcome(
        belief,
        squares,
        residuals,
        score(
            squares,
            normalised(wrong, belief.cov[:, case.first :]),
            case.lost,
            float(posterior.status.converged.mean()),
            float(np.mean(residuals[-1] <= AT_REST)) if len(residuals) else None,
            seconds,
        ),
    )


def score(
    squares: Array,
    nees: Array,
    lost: float,
    converged: float,
    settled: float | None,
    seconds: float,
) -> Score:
    """Summarise squared errors and NEES, (runs, steps)."""
    by_run = squares.mean(axis=1)
    runs = len(by_run)
    rmse = float(np.sqrt(by_run.mean()))
    return Score(
        rmse=rmse,
        rmse_se=float(by_run.std() / (2.0 * rmse * np.sqrt(runs))),
        median=float(np.median(np.sqrt(by_run))),
        trimmed=float(np.sqrt(_best(by_run).mean())),
        tail=float(1.0 - _best(by_run).sum() / by_run.sum()),
        lost=float(np.mean(np.sqrt(by_run) > lost)),
        nees=float(nees.mean()),
        nees_se=float(nees.mean(axis=1).std() / np.sqrt(runs)),
        nees_median=float(np.median(nees)),
        nees_tail=float(1.0 - _best(nees.mean(axis=1)).sum() / nees.mean(axis=1).sum()),
        converged=converged,
        settled=settled,
        seconds=seconds,
    )


def _best(by_run: Array) -> Array:
    """All but the largest `WORST`."""
    return np.sort(by_run)[: max(1, round((1.0 - WORST) * len(by_run)))]


def normalised(wrong: Array, cov: Array) -> Array:
    """Errors squared by their covariances, eᵀP⁻¹e.

    As `pgm.consistency.nees`, but for covariances that are singular to rounding: a Taylor
    linearisation at the landmark itself claims to know the direction exactly. It then is huge,
    not an error.
    """
    values, vectors = np.linalg.eigh(cov)
    values = np.maximum(values, np.finfo(float).eps * values[..., -1:])
    along = np.einsum("...ij,...i->...j", vectors, wrong)
    return np.asarray((along**2 / values).sum(axis=-1))


def grid(
    case: Case,
    lineariser: pgm.Lineariser,
    iterations: Mapping[str, Sequence[int]],
) -> Grid:
    """Both kinds, with all controls named, each with its numbers of linearisations.

    One linearisation is the same under all controls, and made once.
    """
    found: dict[str, dict[str, dict[int, Outcome]]] = {}
    for kind in KINDS:
        once = solve(case, lineariser, kind, "plain", 1)
        found[kind] = {
            control: {1: once}
            | {k: solve(case, lineariser, kind, control, k) for k in counts if k > 1}
            for control, counts in iterations.items()
        }
    return found


def numbers(found: Grid) -> dict[str, Any]:
    """The scores of a grid, for a summary."""
    return {
        kind: {
            control: {str(k): asdict(outcome.score) for k, outcome in each.items()}
            for control, each in controls.items()
        }
        for kind, controls in found.items()
    }
