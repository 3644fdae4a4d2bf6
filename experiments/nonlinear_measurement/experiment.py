"""Which lineariser, where the measurement is nonlinear.

A robot at a heading known to s = 0.1, 0.3 or 0.6 rad drives one step along an arc and reads one of
five sensors. Each rule's belief after the step is compared with the exact posterior's mean and
covariance, found by importance sampling. Rules linearise once, or the sensor again
(IteratedCubature), or motion and sensor: IteratedSmoother and TaylorSmoother over all steps,
IteratedLag in a window of one.

summary.json, by sensor (far, near, two_ranges, collinear, position), s and rule:

- ``kl``, ``kl_se``, ``kl_median``: KL(exact ‖ approximation) over the pose [nats], its mean over
  simulations, the mean's standard error, the median;
- ``nees``, ``nees_se``, ``rmse`` [m], ``rmse_heading`` [rad]: against the drawn poses, those of
  the exact moments too, as ``Exact``;
- ``cost``: by sensor and rule, evaluations of functions and Jacobians, and microseconds, of a step
  of a robot;
- ``settled``: by sensor and s, the ``share`` of simulations in which iterating came to rest, their
  mean ``kl``, and ``kl_others``, 0 where there are none;
- ``audits``: by sensor and rule, at the widest s, how many simulations are 2 nats or more off
  (``wrong``) and less than 0.2 (``right``), how many of these the audit calls suspect (``caught``,
  ``alarms``), and how many wrong ones it neither does nor says to be beyond its trust (``missed``);
  off by the KL of the pose after the step, of a smoother that of both poses together, or by the
  error of the log-evidence, whichever is larger;
- ``estimates``: by sensor, at the widest s, of `pgm.estimate`: ``kl`` and ``kl_se``, the share
  ``vouched`` for, the median of their bounds ``within``, the share of them ``beyond`` it, and the
  mean number of ``draws``;
- ``verdict``: three points made of these numbers, of short sentences;
- ``truth``: by sensor and s, the least and the median effective sample size, and how many
  simulations were dropped because theirs was too small;
- ``against_reference``: the difference of ``kl`` from an earlier implementation's, and z, in
  standard errors of the difference; ``largest_z`` is the largest.
"""

from __future__ import annotations

from typing import Annotated, Any

import typer

from experiments.nonlinear_measurement import figures, findings, reference, tables
from experiments.nonlinear_measurement.rules import rules
from experiments.nonlinear_measurement.study import study
from experiments.record import Out, Record, Seed

# The effective sample size that a simulation's truth must have, at 2¹⁴ points.
ENOUGH, POINTS = 500, 14
QUICK: dict[str, Any] = {"runs": 30, "log2_points": 12}


def run(
    out: Out = None,
    seed: Seed = 0,
    runs: Annotated[int, typer.Option(min=2, help="Simulations.")] = 1000,
    log2_points: Annotated[
        int, typer.Option(min=8, max=20, help="Base-2 logarithm of the truth's sample.")
    ] = POINTS,
) -> None:
    """Which lineariser for a nonlinear measurement: KL from the exact posterior, and its cost."""
    record = Record("nonlinear_measurement", out, seed=seed, runs=runs, log2_points=log2_points)
    enough = ENOUGH * 2.0 ** (log2_points - POINTS)
    compared = rules(seed)
    found, solved = study(compared, runs, log2_points, enough, seed)
    against = reference.compare(found.scores, runs)
    verdict = findings.verdict(found)
    record.note(" ".join(verdict))
    record.figure(
        figures.kl_against_cost(found),
        "kl_against_cost",
        "Mean KL from the exact posterior against evaluations of functions and Jacobians, of one "
        "step of a robot. The three points of a rule are s = 0.1, 0.3 and 0.6 rad, from small to "
        "large: lower is nearer to exact, further left is cheaper. Rules of equal cost stand side "
        "by side. Where the sensor is linear, only the motion is linearised.",
    )
    record.figure(figures.scenes(solved), "scenes", figures.SCENES_CAPTION)
    tables.write(record, found, against, runs, compared)
    largest, where = reference.largest(against)
    record.summary(
        **{key: found.by_rule(key) for key in ("kl", "kl_se", "kl_median")},
        **{
            key: found.by_rule(key, exact=True)
            for key in ("nees", "nees_se", "rmse", "rmse_heading")
        },
        cost={
            sensor: {rule: vars(cost) for rule, cost in costs.items()}
            for sensor, costs in found.costs.items()
        },
        settled=found.settled,
        audits={
            sensor: {rule: vars(each) for rule, each in audits.items()}
            for sensor, audits in found.audits.items()
        },
        estimates={sensor: vars(each) for sensor, each in found.estimates.items()},
        verdict=verdict,
        truth=found.truth,
        against_reference=against,
        largest_z={"z": largest, "where": where},
    )
