"""All rules in all cases, against the exact posterior."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

import pgm
from experiments.nonlinear_measurement.audits import Audited, audited, distance
from experiments.nonlinear_measurement.cases import (
    HEADINGS,
    SENSORS,
    Array,
    Case,
    Integers,
    simulate,
)
from experiments.nonlinear_measurement.estimates import Estimated, estimated
from experiments.nonlinear_measurement.rules import ITERATED, Cost, Mask, Rule, cost, settled
from experiments.nonlinear_measurement.scores import Score, score
from experiments.nonlinear_measurement.truth import Truth, posterior
from experiments.record import progress
from models.networks import pose

Scores = dict[str, dict[str, dict[str, Score]]]  # by sensor, s and rule
EXACT = "Exact"


@dataclass(frozen=True, eq=False)
class Solved:
    """A case with its beliefs, of the simulations whose truth is known well enough.

    Attributes
    ----------
    case : Case
    kept : ndarray of int
        Which simulations.
    beliefs : dict
        Of the pose after the step, by rule, the exact moments among them.
    kl : dict
        (kept,), by rule.
    """

    case: Case
    kept: Integers
    beliefs: dict[str, pgm.Gaussian]
    kl: dict[str, Array]


@dataclass(frozen=True, eq=False)
class Study:
    """Numbers by sensor and s, and by rule where they depend on it.

    Attributes
    ----------
    scores : dict
        By rule too, the exact moments among them.
    truth : dict
        Effective sample sizes, and how many simulations were dropped.
    settled : dict
        The part of simulations in which the iterated rule came to rest, and mean KL there.
    audits : dict
        By sensor and rule, at the widest heading.
    estimates : dict
        By sensor, at the widest heading.
    costs : dict
        By sensor and rule.
    """

    scores: Scores = field(default_factory=dict)
    truth: dict[str, dict[str, dict[str, float]]] = field(default_factory=dict)
    settled: dict[str, dict[str, dict[str, float]]] = field(default_factory=dict)
    audits: dict[str, dict[str, Audited]] = field(default_factory=dict)
    estimates: dict[str, Estimated] = field(default_factory=dict)
    costs: dict[str, dict[str, Cost]] = field(default_factory=dict)

    @property
    def rules(self) -> list[str]:
        """The names of the rules, without the exact moments."""
        return list(next(iter(self.costs.values())))

    def by_rule(self, number: str, exact: bool = False) -> dict[str, Any]:
        """One number of all scores: {sensor: {s: {rule: number}}}."""
        return {
            sensor: {
                s: {r: getattr(v, number) for r, v in found.items() if exact or r != EXACT}
                for s, found in cases.items()
            }
            for sensor, cases in self.scores.items()
        }


def study(
    compared: dict[str, Rule], runs: int, log2_points: int, enough: float, seed: int
) -> tuple[Study, dict[tuple[str, str], Solved]]:
    """Run all rules in all cases.

    Parameters
    ----------
    compared : dict of Rule
    runs : int
        Simulations.
    log2_points, enough
        As for `posterior`; simulations with a smaller effective sample size are dropped.
    seed : int
        Of simulations and of the truth.
    """
    found, solved = Study(), {}
    for sensor in progress(list(SENSORS), "nonlinear_measurement"):
        for part in (found.scores, found.truth, found.settled):
            part[sensor] = {}
        for heading_std in HEADINGS:
            case, s = simulate(SENSORS[sensor], heading_std, runs, seed), str(heading_std)
            truth = posterior(case, log2_points, enough, seed)
            kept = np.flatnonzero(truth.effective >= enough)
            found.truth[sensor][s] = _quality(truth, runs - len(kept))
            solution, rest, posteriors = _solve(case, truth, kept, compared)
            found.scores[sensor][s] = {
                rule: score(belief, solution.kl[rule], case.truth[kept])
                for rule, belief in solution.beliefs.items()
            }
            found.settled[sensor][s] = rest
            solved[sensor, s] = solution
        found.audits[sensor] = {
            name: audited(pgm.audit(each, rng=seed), kept, distance(each, truth))
            for name, each in posteriors.items()
        }
        found.estimates[sensor] = estimated(case, truth, kept, seed)
        found.costs[sensor] = {name: cost(rule, case) for name, rule in compared.items()}
    return found, solved


def _solve(
    case: Case, truth: Truth, kept: Integers, compared: dict[str, Rule]
) -> tuple[Solved, dict[str, float], dict[str, pgm.results.Posterior]]:
    """Beliefs of all rules, how iterating ended, and the posteriors."""
    after = pose.at(1)
    exact = pgm.Gaussian(after, truth.mean[kept], truth.cov[kept])
    beliefs, rest, posteriors = {EXACT: exact}, {}, {}
    for name, rule in compared.items():
        solved = posteriors[name] = rule.solve(case)
        belief = solved[after]
        beliefs[name] = pgm.Gaussian(after, belief.mean[kept], belief.cov[kept])
        if name == ITERATED:
            rest = _rest(settled(solved.status)[kept], exact.kl(beliefs[name]))
    kl = {name: exact.kl(belief) for name, belief in beliefs.items()}
    return Solved(case, kept, beliefs, kl), rest, posteriors


def _rest(at_rest: Mask, kl: Array) -> dict[str, float]:
    """The part of simulations at rest, their mean KL, and that of the others, 0 without any."""
    parts = {"kl": kl[at_rest], "kl_others": kl[~at_rest]}
    means = {name: float(part.mean()) if part.size else 0.0 for name, part in parts.items()}
    return {"share": float(at_rest.mean()), **means}


def _quality(truth: Truth, dropped: int) -> dict[str, float]:
    return {
        "effective_min": float(truth.effective.min()),
        "effective_median": float(np.median(truth.effective)),
        "dropped": dropped,
    }
