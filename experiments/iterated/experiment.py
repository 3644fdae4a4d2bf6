"""Does step control make iterating win? The published growth model, and a robot's chain."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Any

import numpy as np
import typer

from experiments.iterated import agreement, chain, figures, growth, pages, published
from experiments.iterated.case import Case
from experiments.iterated.methods import CONTROLS, TITLES, TOLERANCE, Grid, Outcome, grid, numbers
from experiments.record import Out, Record, Seed, progress

# Published are 1, 2, 6 and 11 linearisations of the growth model, and at most 10 of the chain.
GROWTH_COUNTS = {"plain": (2, 3, 6, 11, 31), "damped": (2, 3, 6, 11, 31), "lm": (2, 3, 6, 11)}
CHAIN_COUNTS = {"plain": (2, 3, 10), "damped": (2, 3, 10), "lm": (2, 3, 10)}
# Levenberg–Marquardt costs many tries where a rule has many points; two linearisers show it.
CONTROLLED = ("Taylor", "Cubature")
# Relinearisations of all steps, of the readings so far.
GROWING = 4
QUICK: dict[str, Any] = {"runs": 20, "seeds": 1, "compared": 4, "drives": 4, "most": 2}


def run(
    out: Out = None,
    seed: Seed = 0,
    runs: Annotated[int, typer.Option(min=2, help="Runs a seed for published numbers.")] = 2000,
    seeds: Annotated[int, typer.Option(min=1, help="Samples for published numbers.")] = 3,
    compared: Annotated[int, typer.Option(min=2, help="Runs of the growth model.")] = 500,
    drives: Annotated[int, typer.Option(min=2, help="Drives past the landmark.")] = 500,
    most: Annotated[int, typer.Option(min=2, help="Linearisations at the most.")] = 31,
) -> None:
    """Iterate filters and smoothers: plainly, damped, and with Levenberg–Marquardt."""
    record = Record(
        "iterated",
        out,
        seed=seed,
        runs=runs,
        seeds=seeds,
        compared=compared,
        drives=drives,
        most=most,
        tolerance=TOLERANCE,
        damping=CONTROLS["damped"],
    )
    words = np.random.SeedSequence(seed).generate_state(seeds + 2)
    *fresh, own, way = (int(word) for word in words)
    agreed = _published(fresh, runs, drives, most)
    other = published.other_readings(runs, fresh[0], most)
    grown = {sensor: _growth(sensor, compared, own, most) for sensor in growth.POWERS}
    case = chain.simulate(drives, way)
    chains = _chains(case, most)
    count = max(chains["Taylor"]["filter"]["plain"])
    controlled = {name: chains[name] for name in CONTROLLED}
    batch = {
        name: chain.growing(case, chain.LINEARISERS[name], min(GROWING, most))
        for name in progress(CONTROLLED, "readings so far")
    }
    last = pages.last_steps(case, controlled, batch, count)

    pages.chain_page(record, chains, controlled, last, count)
    record.figure(
        figures.over_time(controlled, batch, count),
        "over_time",
        "The chain: RMSE of the position at each step. Dots: an iterated smoother of the "
        "readings up to a step, at that step: it knows what the filters know there, and may move "
        "all earlier points of linearisation. The robot passes the landmark at 0.5 m about steps "
        "4 and 20.",
    )
    _failure(record, case, controlled["Taylor"], count)
    pages.growth_page(record, grown)
    record.figure(
        figures.linearisations(grown),
        "linearisations",
        agreement.linearisations_caption(agreed["square"], grown["square"]),
    )
    pages.ends_page(
        record,
        {f"{s}, {n}": g for s, each in grown.items() for n, g in each.items()}
        | {f"chain, {name}": each for name, each in chains.items()},
    )
    record.figure(
        figures.residuals(_residual_panels(grown, chains)),
        "residuals",
        "How far each linearisation still moved a mean, in standard deviations: the median run, "
        "and the middle 80 % of runs. With a sigma-point rule Levenberg–Marquardt may stop short: "
        "the rule's regression is not the exact gradient of its expected function, so that near "
        "the end full steps can raise the cost, and are refused.",
    )
    agreement.published_page(
        record, agreed, other, grown["cubic"]["Unscented"]["filter"]["plain"][1].score
    )
    record.summary(
        published=agreement.comparisons(agreed),
        other_readings={title: [one.as_dict() for one in each] for title, each in other.items()},
        growth={s: {n: numbers(g) for n, g in each.items()} for s, each in grown.items()},
        chains={name: numbers(each) for name, each in chains.items()},
        chain_last=last,
    )


def _published(
    seeds: Sequence[int], runs: int, drives: int, most: int
) -> dict[str, dict[str, list[published.Comparison]]]:
    found: dict[str, dict[str, list[published.Comparison]]] = {}
    for sensor, each in published.GROWTH.items():
        cases = published.growth_cases(sensor, runs, seeds)
        found[sensor] = {
            name: published.compare(cases, growth.LINEARISERS[name], published.up_to(wanted, most))
            for name, wanted in each.items()
        }
    cases = [chain.simulate(drives, seed) for seed in seeds]
    found["chain"] = {
        name: published.compare(cases, chain.LINEARISERS[name], published.up_to(wanted, most))
        for name, wanted in published.CHAIN.items()
    }
    return found


def _growth(sensor: str, runs: int, seed: int, most: int) -> dict[str, Grid]:
    case, counts = growth.simulate(sensor, runs, seed), _up_to(GROWTH_COUNTS, most)
    names = progress(list(growth.LINEARISERS), "growth model")
    return {name: grid(case, growth.LINEARISERS[name], counts) for name in names}


def _up_to(counts: Mapping[str, Sequence[int]], most: int) -> dict[str, list[int]]:
    return {control: [k for k in each if k <= most] for control, each in counts.items()}


def _chains(case: Case, most: int) -> dict[str, Grid]:
    found = {}
    for name in progress(list(chain.LINEARISERS), "chains"):
        counts = _up_to(CHAIN_COUNTS, most)
        if name not in CONTROLLED:
            del counts["lm"]
        found[name] = grid(case, chain.LINEARISERS[name], counts)
    return found


def _residual_panels(
    grown: Mapping[str, Mapping[str, Grid]], chains: Mapping[str, Grid]
) -> dict[str, dict[str, Outcome]]:
    panels = {"growth, cubic,\nunscented smoother": grown["cubic"]["Unscented"]["smoother"]}
    for kind, controls in chains["Cubature"].items():
        panels[f"chain,\ncubature {kind}"] = controls
    return {
        title: {
            control: each[min(max(e) for e in controls.values())]
            for control, each in controls.items()
        }
        for title, controls in panels.items()
    }


def _failure(record: Record, case: Case, found: Grid, most: int) -> None:
    """The drive that plain iteration of the filter loses most against step control."""
    filters = {control: each[most] for control, each in found["filter"].items()}
    run = int(np.argmax(filters["plain"].by_run - filters["lm"].by_run))
    figure = figures.failure(
        case,
        {
            "filter, linearised once": found["filter"]["plain"][1],
            f"filter, {most}, plain": filters["plain"],
            f"filter, {most}, Levenberg–Marquardt": filters["lm"],
            f"smoother, {most}, plain": found["smoother"]["plain"][most],
        },
        run,
    )
    beyond = {control: outcome.by_run > case.lost for control, outcome in filters.items()}
    shares = ", ".join(f"{TITLES[control]} {each.mean():.1%}" for control, each in beyond.items())
    record.figure(
        figure,
        "failure",
        "The drive in which plain iteration of the Taylor filter is furthest behind "
        "Levenberg–Marquardt, in metres, with 95 % ellipses: truth thin, estimates bold. "
        f"Drives with an RMSE above {case.lost:g} m, of {len(case.truth)}: "
        f"{shares}; plain but not Levenberg–Marquardt "
        f"{np.mean(beyond['plain'] & ~beyond['lm']):.1%}.",
    )
