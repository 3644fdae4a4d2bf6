"""One recorded drive of any reader: every schedule, gate and robust noise against its truth.

In summary.json ``results.<data>.<method>.<lineariser>`` has the RMSE of the position, the mean NEES
a component of the position, and the log-evidence and its kind; ``ranking.<data>`` the sensors by
their normalised innovations.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

import pgm
from experiments.record import Out, Record, Seed, note, progress
from experiments.recordings import drives, figures
from experiments.recordings.drives import SETTINGS, Drive
from experiments.recordings.methods import LINEARISERS, METHODS
from models.networks import pose
from pgm import consistency

QUICK: dict[str, Any] = {"data": "labyrinth", "linearisers": "Taylor"}
PLANE = ("east", "north")
_NONE = "unnormalised"


def run(
    data: Annotated[
        str | None,
        typer.Argument(help=f"One of {', '.join(SETTINGS)}; all that are found without."),
    ] = None,
    out: Out = None,
    seed: Seed = 0,
    path: Annotated[
        Path | None, typer.Option(help="The file or folder of the recording.", exists=True)
    ] = None,
    linearisers: Annotated[
        str | None, typer.Option(help=f"One of {', '.join(LINEARISERS)}; all without.")
    ] = None,
    every_stamp: Annotated[
        bool, typer.Option(help="States at the stamps of all rows, so that no reading is moved.")
    ] = False,
) -> None:
    """Estimate recorded drives by filters, smoothers, gates and robust noise."""
    for what, value, known in (
        ("a recording", data, SETTINGS),
        ("a lineariser", linearisers, LINEARISERS),
    ):
        if value is not None and value not in known:
            raise pgm.EvidenceError(f"{value!r} is not {what}: {', '.join(known)}")
    if path is not None and data is None:
        raise pgm.EvidenceError("--path is of one recording; say of which kind: recordings plaza1")
    chosen = [data] if data else list(SETTINGS)
    files = {name: path or SETTINGS[name].find() for name in chosen}
    for name, file in files.items():
        if file is None and (data or SETTINGS[name].needs != "give --path"):
            note(f"recordings: {name} is not here; {SETTINGS[name].needs}")
    found = {name: file for name, file in files.items() if file is not None}
    if not found:
        return
    used = [linearisers] if linearisers else list(LINEARISERS)
    record = Record(
        "recordings", out, seed=seed, data=list(found), linearisers=used, every_stamp=every_stamp
    )
    results: dict[str, Any] = {}
    rankings: dict[str, Any] = {}
    for name, file in found.items():
        drive = drives.load(name, file, every_stamp=every_stamp)
        record.note(f"{name}: {drive.setting.about}")
        record.note(repr(drive.timeline))
        results[name], shown = estimated(drive, used)
        _tables(record, name, results[name])
        if shown:
            _pictures(record, drive, shown, rankings)
    record.summary(results=results, ranking=rankings)


def estimated(drive: Drive, linearisers: list[str]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Errors of every method with every lineariser; and the posteriors of the first of these."""
    reckoned = pgm.filter(drive.network(), drive.motion)[pose]
    results: dict[str, Any] = {"dead reckoning": {"": _judged(drive, reckoned)}}
    shown = {}
    for label in progress(list(METHODS), drive.name):
        results[label] = {}
        for name in linearisers:
            posterior = METHODS[label](drive, LINEARISERS[name])
            results[label][name] = {
                **_judged(drive, posterior[pose]),
                "log_evidence": float(posterior.log_evidence),
                "log_evidence_kind": posterior.log_evidence_kind,
                "converged": bool(posterior.status.converged.all()),
                "lost": int(posterior.lost.at.sum()),
            }
            if name == linearisers[0]:
                shown[label] = posterior
    return results, shown


def _judged(drive: Drive, belief: pgm.Gaussian) -> dict[str, float]:
    """Against the truth; nothing where there is none."""
    if drive.truth is None:
        return {}
    nees = consistency.anees(belief, drive.truth, PLANE).per_dof().overall()
    return {
        "rmse": float(consistency.rmse(belief, drive.truth, PLANE)),
        "nees": float(nees.value),
    }


def _tables(record: Record, name: str, results: dict[str, Any]) -> None:
    rows = [
        (
            label,
            lineariser,
            found.get("rmse", ""),
            found.get("nees", ""),
            # Of an improper density the figure compares with no other noise's.
            "" if found.get("log_evidence_kind", _NONE) == _NONE else found["log_evidence"],
            found.get("lost", ""),
        )
        for label, each in results.items()
        for lineariser, found in each.items()
    ]
    about = "; ".join(f"{label}: {method.about}" for label, method in METHODS.items())
    record.table(
        f"{name}: position against the truth",
        ("method", "lineariser", "RMSE [m]", "NEES", "log-evidence", "steps lost"),
        rows,
        about="NEES is a component's, 1 of a right belief. The robust noise has no density, so "
        f"that its log-evidence compares with no other. {about}.",
        best={"RMSE [m]": -np.inf, "NEES": 1.0},
    )


def _pictures(
    record: Record, drive: Drive, shown: dict[str, pgm.ChainPosterior], rankings: dict[str, Any]
) -> None:
    """The path, errors over time, and who of the sensors fits the model least."""
    record.figure(
        figures.paths(drive, shown),
        f"{drive.name}_path",
        f"The recording {drive.name} [m]: landmarks, dead reckoning from the same start, filter "
        "and smoother, and the truth where there is one.",
    )
    if drive.truth is not None:
        record.figure(
            figures.errors(drive, shown),
            f"{drive.name}_errors",
            f"Distance of estimates of {drive.name} from the truth [m] over time [s]; dashed, the "
            "longest axis of the filter's 95 % ellipse.",
        )
    ranked = consistency.ranking(shown["filter"].innovations, by={drive.sensor: drive.labels})
    record.figure(
        figures.ranked(drive, ranked),
        f"{drive.name}_ranking",
        f"Landmarks of {drive.name} by the normalised innovations of the filter, over time [s]: "
        "orange where sightings are further off than the model says, purple where nearer; frames "
        "are the stretches that speak most against it, dashed where that may be chance.",
    )
    record.table(
        f"{drive.name}: which landmark, which stretch",
        ("landmark", "components", "NIS", "low", "high", "bias", "first", "last", "p at most"),
        [
            (
                str(row.group),
                int(row.average.count),
                float(row.average.value),
                float(row.average.low),
                float(row.average.high),
                float(row.bias[np.argmax(np.abs(row.bias))]),
                row.first,
                row.last,
                row.probability,
            )
            for row in ranked.rows
        ],
        about="NIS a component and the band of a right model; the mean innovation in deviations, "
        "of the component where it is largest; the steps that speak most for twice the variance, "
        "and a bound on the probability that a right model has such a stretch.",
    )
    rankings[drive.name] = [
        {"landmark": str(row.group), "nis": float(row.average.value), "p": row.probability}
        for row in ranked.rows
    ]
