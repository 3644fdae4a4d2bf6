"""Tables 8.1 and 8.2 and Figure 8.1 of the 2018 report: accuracy and cost of linearisers.

summary.json has, by setting (R1, R2) and technique (MC100, MC10, Taylor, Unscented):

- ``table_8_1``, ``table_8_1_se``, ``table_8_1_median``: KL(truth ‖ belief) in nats, its average
  over the simulations, the standard error of that, and the median; ``table_8_1_unwrapped``: the
  average, were the difference of headings not wrapped;
- ``indefinite_noise``: the share of simulations in which Σ_n plus the motion's noise is indefinite.

``contrast`` has the same numbers in the mild setting. ``second_truth``: the average divergence of
the truth from one of as many other samples, by setting. ``error_by_samples``: the average
divergence of Monte Carlo at R1 by number of samples; ``error_constant``: the c of its c / N.
``table_8_2.by_technique`` and ``table_8_2.by_samples``:
seconds of one filter step of one robot; ``table_8_2_linearisation``: those of the linearisation
in it; ``table_8_2_batch``: seconds a robot where all simulations are filtered at once; ``trend``:
the lines a + b N.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Annotated, Any

import typer

from experiments.linearisers import accuracy, figures, pages, timing
from experiments.linearisers.accuracy import Outcome, Trial
from experiments.linearisers.settings import CONTROL, DT, REPRODUCED, SETTINGS
from experiments.record import Out, Record, Seed, progress

QUICK: dict[str, Any] = {"simulations": 500, "truth_samples": 20_000, "rounds": 2}


def run(
    out: Out = None,
    seed: Seed = 0,
    simulations: Annotated[int, typer.Option(min=2, help="Simulations to average over.")] = 10_000,
    truth_samples: Annotated[
        int, typer.Option(min=1000, help="Samples behind the true moments.")
    ] = 1_000_000,
    rounds: Annotated[int, typer.Option(min=1, help="Rounds of timing each step.")] = 30,
) -> None:
    """One step of a robot with each lineariser: KL from the best Gaussian, and what it costs."""
    record = Record(
        "linearisers",
        out,
        seed=seed,
        simulations=simulations,
        truth_samples=truth_samples,
        rounds=rounds,
        control=CONTROL,
        dt=DT,
        settings={name: asdict(setting) for name, setting in SETTINGS.items()},
    )
    trials: dict[str, Trial] = {}
    outcomes: dict[str, dict[str, Outcome]] = {}
    for name in progress(list(SETTINGS), "linearisers"):
        trials[name] = Trial.draw(SETTINGS[name], simulations, truth_samples, seed)
        outcomes[name] = {k: trials[name].filter(rule) for k, rule in accuracy.rules(seed).items()}
    again = {
        name: accuracy.second_truth(trial, truth_samples, seed) for name, trial in trials.items()
    }
    errors = accuracy.by_samples(trials["R1"], seed)
    costs = timing.measure(SETTINGS["mild"], timing.techniques(seed), seed, rounds)
    lines = timing.lines(costs)
    batch = {name: each.seconds / simulations for name, each in outcomes["R1"].items()}
    pages.accuracy_page(record, outcomes, again["mild"], truth_samples)
    record.figure(
        figures.beliefs(trials["R1"], outcomes["R1"], 0),
        "figure_8_1",
        pages.beliefs(outcomes["R1"], 0),
    )
    record.figure(figures.error(errors), "error", pages.error(errors))
    pages.cost_page(record, costs, batch)
    record.figure(figures.cost(costs, lines), "cost", pages.COST)
    by_setting = {
        what: {name: _each(outcomes[name], what) for name in REPRODUCED} for what in _MEASURES
    }
    record.summary(
        table_8_1=by_setting["mean"],
        table_8_1_se=by_setting["standard_error"],
        table_8_1_median=by_setting["median"],
        table_8_1_unwrapped=by_setting["unwrapped"],
        indefinite_noise=by_setting["indefinite"],
        second_truth=again,
        contrast={what: _each(outcomes["mild"], what) for what in _MEASURES},
        error_by_samples=errors,
        error_constant=accuracy.constant(errors),
        table_8_2=timing.seconds(costs, "step"),
        table_8_2_linearisation=timing.seconds(costs, "linearisation"),
        table_8_2_batch=batch,
        trend={kind: asdict(line) | {"knee": line.knee} for kind, line in lines.items()},
    )


_MEASURES = ("mean", "standard_error", "median", "unwrapped", "indefinite")


def _each(outcomes: Mapping[str, Outcome], what: str) -> dict[str, float]:
    return {technique: getattr(outcome, what) for technique, outcome in outcomes.items()}
