"""A recorded mower whose ranges are 7 % long: calibration and noise from the data alone.

The search begins with ranges as they were recorded and with noise several times too large. The
truth gives the first pose, and judges. In summary.json ``results.<data>.<way>`` has ``start``,
``end``, ``std`` and ``log_evidence``; beside the ways ``fitted`` has the parameters that were
fitted with the truth and, as ``residual``, how far ranges are from its distances; ``tuned`` has
static states at the noise that was tuned with it.
"""

from __future__ import annotations

from typing import Annotated, Any

import typer

import pgm
from experiments.calibration import figures, static_states
from experiments.calibration.learnt import (
    NAMES,
    RATES,
    SENSOR_STD,
    WAYS,
    fitted,
    learnt,
    recorded,
)
from experiments.plaza import log as plaza_log
from experiments.plaza.log import Data, File
from experiments.record import Out, Record, Seed, progress
from experiments.recordings.drives import Drive

QUICK: dict[str, Any] = {"data": "plaza2", "iterations": 8, "tuned": False}
UNITS = ("", "m", "m", "m/√s", "m/√s", "rad/√s")


def run(
    out: Out = None,
    seed: Seed = 0,
    data: Data = None,
    path: File = None,
    iterations: Annotated[int, typer.Option(min=1, help="Of the search, at the most.")] = 200,
    tuned: Annotated[
        bool, typer.Option(help="Static states at the noise that was tuned with the truth, too.")
    ] = True,
) -> None:
    """Learn a mower's range scale, offset and noise from its recordings alone."""
    files = plaza_log.chosen("calibration", data, path)
    if not files:
        return
    record = Record(
        "calibration",
        out,
        seed=seed,
        data=list(files),
        iterations=iterations,
        sensor_std=SENSOR_STD,
        rates=RATES,
    )
    results: dict[str, Any] = {}
    rows: list[tuple[object, ...]] = []
    for name, file in files.items():
        drive = recorded(name, file)
        results[name] = {}
        for way in progress(list(WAYS), name):
            results[name][way], posterior = learnt(drive, WAYS[way], iterations)
        _told_of(record, drive, results[name], posterior)
        if tuned:
            results[name]["tuned"] = each = static_states.estimated(file, name)
            rows += [(name, label, *static_states.columns(one)) for label, one in each.items()]
    if tuned:
        record.table(
            "With the noise that was tuned, and less and less told",
            (
                "data",
                "known",
                "filter",
                "smoother",
                "iterated",
                "log-evidence",
                *static_states.UNKNOWN,
            ),
            rows,
            about="Position errors [m]; estimates of the iterated smoother at the end, with their "
            "standard deviations. Priors: scale 1 ± 0.2, offset 0 ± 2 m, bias 0 ± "
            f"{static_states.BIAS_STD} rad/s. The log-evidence of calibrated ranges is that of "
            "other numbers: it compares with no other.",
        )
    record.summary(results=results)


def _told_of(
    record: Record, drive: Drive, results: dict[str, Any], posterior: pgm.results.Posterior
) -> None:
    """The tables and figures of one recording."""
    ways = dict(results)
    results["fitted"], with_truth = fitted(drive)
    first = next(iter(ways.values()))
    record.table(
        f"{drive.name}: what was learnt of the sensor and the motion",
        ("", "unit", "start", *(f"as a {way}" for way in ways), "fitted with the truth"),
        [
            (
                name,
                unit,
                first["start"][name],
                *(_shown(each, name) for each in ways.values()),
                f"{results['fitted'][name]:.4f}",
            )
            for name, unit in zip(NAMES, UNITS, strict=True)
        ],
        about="range = scale · distance + offset; range: its noise's standard deviation; east, "
        "north, heading: those of the motion. ±: the standard deviation of the static state, at "
        "the noise that was learnt. The last column was fitted and tuned with the truth, from "
        f"whose distances the ranges differ by {results['fitted']['residual']:.4f} m.",
    )
    record.table(
        f"{drive.name}: before and after",
        ("", "filter", "smoother", "log-evidence", "iterations", "E steps", "the search ended"),
        [
            row
            for way, each in ways.items()
            for row in (
                (f"{way}, start", *_judged(each["start"]), "", "", ""),
                (
                    f"{way}, end",
                    *_judged(each["end"]),
                    each["status"]["iterations"],
                    each["status"]["e_steps"],
                    each["status"]["stopped"],
                ),
            )
        ]
        + [("fitted with the truth", *_judged(results["fitted"]), "", "", "")],
        about="Position RMSE against the truth [m]. The prior of a state is part of its "
        "log-evidence, which so is lower.",
    )
    record.figure(
        figures.trace(ways, results["fitted"]["total"]),
        f"{drive.name}_trace",
        f"The log-evidence of {drive.name} after each iteration, from ranges as recorded and "
        "noise several times too large; dotted, with calibration and noise fitted with the truth. "
        "Right, what is lacking to the end, on a logarithmic axis.",
    )
    way = next(iter(WAYS.values()))
    before = pgm.smooth(way.model(drive), {**drive.evidence, **way.given})
    record.figure(
        figures.errors(
            drive, {"as recorded": before, "learnt": posterior, "fitted with the truth": with_truth}
        ),
        f"{drive.name}_errors",
        f"How far smoothers of {drive.name} are from the truth [m] over time [s], on a logarithmic "
        "axis: with ranges as recorded and guessed noise, with calibration as a state and noise "
        "learnt, and with both fitted with the truth.",
    )


def _shown(found: dict[str, Any], name: str) -> str:
    std = found["std"].get(name)
    value = f"{found['end'][name]:.4f}"
    return value if std is None else f"{value} ± {std:.4f}"


def _judged(found: dict[str, Any]) -> tuple[float, float, str]:
    return found["filter"], found["smoother"], f"{found['total']:.1f}"
