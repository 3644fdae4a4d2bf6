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
from experiments.recordings.drives import Drive
from experiments.recordings.methods import LINEARISERS, methods
from experiments.recordings.setting_file import READERS, described
from experiments.recordings.settings import SETTINGS
from models.networks import pose
from pgm import consistency
from pgm.consistency import Ranked
from pgm.recordings import Recording

QUICK: dict[str, Any] = {"data": "labyrinth", "linearisers": "Taylor"}
PLANE = ("east", "north")
_NONE = "unnormalised"
KNOWN = list(dict.fromkeys((*SETTINGS, *READERS)))


def run(
    data: Annotated[
        str | None,
        typer.Argument(
            help=f"One of {', '.join(KNOWN)}; of those with settings of their own all that are "
            "found, without."
        ),
    ] = None,
    out: Out = None,
    seed: Seed = 0,
    path: Annotated[
        Path | None, typer.Option(help="The file or folder of the recording.", exists=True)
    ] = None,
    settings: Annotated[
        Path | None,
        typer.Option(
            help="What the recording does not say, in TOML: noise, sensors, map, start. The "
            "guide's page about recordings has the keys, and an example of each reader."
        ),
    ] = None,
    linearisers: Annotated[
        str | None, typer.Option(help=f"One of {', '.join(LINEARISERS)}; all without.")
    ] = None,
    every_stamp: Annotated[
        bool, typer.Option(help="States at the stamps of all rows, so that no reading is moved.")
    ] = False,
    estimate: Annotated[
        bool, typer.Option(help="By pgm.estimate, too, which chooses by itself, and its verdict.")
    ] = False,
) -> None:
    """Estimate recorded drives by filters, smoothers, gates and robust noise."""
    if data == "pose_graph":
        raise pgm.EvidenceError(
            "a pose graph is no drive of sensors, and an experiment of its own: pose_graphs --path "
            "FILE"
        )
    for what, value, known in (
        ("a recording", data, KNOWN),
        ("a lineariser", linearisers, LINEARISERS),
    ):
        if value is not None and value not in known:
            raise pgm.EvidenceError(f"{value!r} is not {what}: {', '.join(known)}")
    for option, file in (("--path", path), ("--settings", settings)):
        if file is not None and data is None:
            raise pgm.EvidenceError(
                f"{option} is of one recording; say of which kind: recordings plaza1"
            )
    if settings is not None and data not in READERS:
        raise pgm.EvidenceError(
            f"{data} has settings of its own; with --settings name the reader: {', '.join(READERS)}"
        )
    if data is not None and settings is None and data not in SETTINGS:
        raise pgm.EvidenceError(
            f"recordings {data} needs --settings FILE, in which the noise and the sensors of the "
            "recording stand; the guide's page about recordings has an example"
        )
    used = [linearisers] if linearisers else list(LINEARISERS)
    if data is not None and settings is not None:
        told = described(settings, data, path)
        whole = drives.read(told.setting, told.path)
        found = {told.name: drives.laid(told.name, told.setting, whole, every_stamp=every_stamp)}
        record = Record(
            "recordings",
            out,
            seed=seed,
            data=[told.name],
            reader=data,
            linearisers=used,
            every_stamp=every_stamp,
            setting=settings.read_text(encoding="utf-8"),
        )
        _said(record, whole, found[told.name])
    else:
        files = _files(data, path)
        if not files:
            return
        record = Record(
            "recordings",
            out,
            seed=seed,
            data=list(files),
            linearisers=used,
            every_stamp=every_stamp,
        )
        found = {
            name: drives.load(name, file, every_stamp=every_stamp) for name, file in files.items()
        }
    results: dict[str, Any] = {}
    rankings: dict[str, Any] = {}
    for name, drive in found.items():
        record.note(f"{name}: {drive.setting.about}")
        record.note(repr(drive.timeline))
        results[name], shown = estimated(drive, used)
        if estimate and drive.sensors:
            results[name]["estimate"] = {"": _vouched(record, drive)}
        _tables(record, drive, results[name])
        _pictures(record, drive, shown, rankings)
    record.summary(results=results, ranking=rankings)


def _files(data: str | None, path: Path | None) -> dict[str, Path]:
    """The recordings with settings of their own that are here."""
    found = {}
    for name in [data] if data else SETTINGS:
        file = path or SETTINGS[name].find()
        if file is not None:
            found[name] = file
        elif data or SETTINGS[name].needs != "give --path":
            note(f"recordings: {name} is not here; {SETTINGS[name].needs}")
    return found


def _said(record: Record, whole: Recording, drive: Drive) -> None:
    """Note the contents of the recording, and the streams that are not taken."""
    record.note(repr(whole))
    taken = {sensor.stream for sensor in drive.setting.sensors}
    streams = [*whole.sightings, *(n for n in ("fixes", "imu") if getattr(whole, n) is not None)]
    if others := [name for name in streams if name not in taken]:
        record.note(f"No sensor of the settings, and not taken: {', '.join(others)}.")
    if whole.scans:
        record.note(
            f"Scans are not taken: {', '.join(whole.scans)}. A place is found by scans with a map "
            "of them; see the guide's page about maps."
        )
    for sensor in drive.setting.sensors:
        stream = {**whole.sightings, "fixes": whole.fixes, "imu": whole.imu}[sensor.stream]
        if stream is None or stream.variances is None:
            continue
        columns = [stream.place(name) for name in sensor.kind.variable.components]
        if (usual := np.sqrt(np.nanmedian(stream.variances[:, columns], axis=0))).any():
            record.note(
                f"{sensor.stream}: the settings' deviations are {list(sensor.std)}; by the "
                f"recording's variances they are {usual.round(4).tolist()}, the medians."
            )
    if (late := drive.timeline.times[0] - whole.times[0]) > 0.0:
        record.note(f"The first {late:.4g} s are left out: the start is the truth's first pose.")


def estimated(drive: Drive, linearisers: list[str]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Errors of every method with every lineariser; and the posteriors of the first of these."""
    reckoned = pgm.filter(drive.network(), drive.motion)[pose]
    results: dict[str, Any] = {"dead reckoning": {"": _judged(drive, reckoned)}}
    shown = {}
    ways = methods(drive.setting.ways) if drive.sensors else {}
    for label in progress(list(ways), drive.name):
        results[label] = {}
        for name in linearisers:
            posterior = ways[label](drive, LINEARISERS[name])
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


def _vouched(record: Record, drive: Drive) -> dict[str, Any]:
    """The errors of `pgm.estimate`; its verdict is noted."""
    posterior = pgm.estimate(drive.network(), drive.evidence)
    verdict = posterior.verdict
    assert verdict is not None
    record.note(f"{drive.name}: {verdict!r}")
    belief = posterior[pose]
    return {
        **_judged(drive, belief if isinstance(belief, pgm.Gaussian) else belief.gaussian()),
        "log_evidence": float(posterior.log_evidence),
        "log_evidence_kind": posterior.log_evidence_kind,
        "vouched": bool(verdict.vouched),
        "within": float(verdict.within),
    }


def _judged(drive: Drive, belief: pgm.Gaussian) -> dict[str, float]:
    """Against the truth; nothing where there is none."""
    if drive.truth is None or not (known := np.isfinite(drive.truth[:, 0])).any():
        return {}
    away = np.linalg.norm(belief.mean[known, :2] - drive.truth[known, :2], axis=-1)
    nees = consistency.anees(belief, drive.truth, PLANE).per_dof().overall()
    return {
        "rmse": float(consistency.rmse(belief, drive.truth, PLANE)),
        "nees": float(nees.value),
        "end": float(away[-1]),
    }


def _tables(record: Record, drive: Drive, results: dict[str, Any]) -> None:
    rows = [
        (
            label,
            lineariser,
            found.get("rmse", ""),
            found.get("nees", ""),
            found.get("end", ""),
            # Of an improper density the figure compares with no other noise's.
            "" if found.get("log_evidence_kind", _NONE) == _NONE else found["log_evidence"],
            found.get("lost", ""),
        )
        for label, each in results.items()
        for lineariser, found in each.items()
    ]
    ways = methods(drive.setting.ways) if drive.sensors else {}
    about = "; ".join(f"{label}: {method.about}" for label, method in ways.items())
    record.table(
        f"{drive.name}: {'position against the truth' if drive.truth is not None else 'no truth'}",
        ("method", "lineariser", "RMSE [m]", "NEES", "end [m]", "log-evidence", "steps lost"),
        rows,
        about="NEES is a component's, 1 of a right belief; end, the last error. A robust noise "
        "without a density has no log-evidence that compares with others. "
        + (f"{about}." if about else "There is no sensor: the motion alone."),
        best={"RMSE [m]": -np.inf, "NEES": 1.0},
    )


def _pictures(
    record: Record,
    drive: Drive,
    shown: dict[str, pgm.results.Posterior],
    rankings: dict[str, Any],
) -> None:
    """The path, errors over time, and who of the sensors fits the model least."""
    record.figure(
        figures.paths(drive, shown),
        f"{drive.name}_path",
        f"The recording {drive.name} [m]: landmarks, readings of positions, dead reckoning from "
        "the same start, filter and smoother, and the truth, where there are any.",
    )
    if drive.truth is not None and np.isfinite(drive.truth[:, 0]).any():
        record.figure(
            figures.errors(drive, shown),
            f"{drive.name}_errors",
            f"Distance of estimates of {drive.name} from the truth [m] over time [s]; dashed, the "
            f"longest axis of the 95 % ellipse of {'the filter' if shown else 'dead reckoning'}.",
        )
    if not shown:
        return
    ranked = consistency.ranking(shown["filter"].innovations, by=drive.labels)
    record.figure(
        figures.ranked(drive, ranked),
        f"{drive.name}_ranking",
        f"Landmarks or sensors of {drive.name} by the normalised innovations of the filter, over "
        "time [s]: orange where sightings are further off than the model says, purple where "
        "nearer; frames are the stretches that speak most against it, dashed where that may be "
        "chance.",
    )
    record.table(
        f"{drive.name}: which landmark or sensor, which stretch",
        ("of", "components", "NIS", "low", "high", "bias", "first", "last", "p at most"),
        [
            (
                _of(row, drive),
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
        {"landmark": _of(row, drive), "nis": float(row.average.value), "p": row.probability}
        for row in ranked.rows
    ]


def _of(row: Ranked, drive: Drive) -> str:
    """The landmark of a row of the ranking, with its sensor where there are several."""
    return row.name if len(drive.sensors) > 1 or row.group is None else str(row.group)
