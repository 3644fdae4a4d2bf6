"""The report's page of the drives: tables, notes, figures and animations."""

from __future__ import annotations

import math
from typing import Any

from experiments.differential_drive.animation import EVERY, animate
from experiments.differential_drive.figures import RINGS, drive_figure, nees_figure
from experiments.differential_drive.problems import DT, NOISE
from experiments.differential_drive.results import Solved
from experiments.record import Record
from pgm import consistency

PARTICLES = 100  # of the animations, as many as the reference's
By = dict[str, dict[str, Any]]  # numbers, by meaning of the noise and by problem


def note_readings(record: Record, drawn: str) -> None:
    """How the reference was read."""
    listed = ", ".join(f"{name} {value:g}" for name, value in NOISE.items())
    record.note(
        f"The reference's N(0, ·): {listed}. It does not say whether these are deviations or "
        "variances: the tables have both, the other figures and the animations take them for "
        f"{drawn}s. White noise of a velocity is w √T after a step of T = 1/8 s; the reference's "
        "w T is right only for a disturbance that is held over the step. Its landmark sensor needs "
        "atan2, its equation 11 means w_x and w_y."
    )
    record.note(
        "Problem 1: wheel speeds are taken in rad/s, 0.1 each, so that 1 m takes 100 s (read as "
        "0.1 m/s at the rim they would be 1 rad/s and take 10 s); both axes get the speed of both "
        "wheels, so that the robot drives a diagonal. The noise of 100 s is as large as the drive, "
        "or larger. Problem 2 gives neither start nor speed: here the robot starts at the origin "
        "and goes round the landmark at 2 m/s. Every drive starts from an exactly known state."
    )


def tabulate(record: Record, found: By, runs: int, drawn: str) -> None:
    """Errors of every estimator; those of the reading that is not drawn are folded."""
    bands = [consistency.mean_band(dimension, runs) for dimension in (2, 3)]
    for meaning, problems in found.items():
        record.table(
            f"Errors and consistency over {runs} drives, N(0, ·) read as {meaning}s",
            ("problem", "lineariser", "belief", "xy [m]", "θ [rad]", "NEES", "last", "in band"),
            [
                (
                    problem,
                    name,
                    kind,
                    f"{each['rmse']:.3f}",
                    f"{each['rmse_heading']:.3f}" if "rmse_heading" in each else "",
                    f"{each['nees']:.2f}",
                    f"{each['nees_last']:.2f}",
                    f"{each['inside']:.0%}",
                )
                for problem, numbers in problems.items()
                for name, both in numbers.items()
                for kind, each in both.items()
                if kind != "log_evidence"
            ],
            about="RMSE of position and heading. NEES: the mean over all steps, of the last step, "
            "and the share of steps at which the mean over drives is in its band; 2 is right in "
            "problem 1, 3 in problem 2.",
            best={"xy [m]": -math.inf, "θ [rad]": -math.inf},
            within=("problem", "belief"),
            folded=meaning != drawn,
        )
    (low, high), (low_3, high_3) = bands
    record.note(
        f"The band of a step's mean NEES over {runs} drives is {low:.2f} to {high:.2f} in problem "
        f"1 (two components) and {low_3:.2f} to {high_3:.2f} in problem 2 (three); a right belief "
        "is inside 99 times in 100."
    )


def tabulate_particles(record: Record, found: dict[str, Any]) -> None:
    """The particle filter beside the Kalman filter."""
    record.table(
        "Problem 1: bootstrap particle filters beside the Kalman filter, on the same "
        f"{found['drives']} drives",
        ("particles", "RMSE [m]", "excess [m²]", "± s.e.", "worse in"),
        [
            ("Kalman", f"{found['kalman']:.4f}", "", "", ""),
            *(
                (
                    count,
                    f"{each['rmse']:.4f}",
                    f"{each['excess']:.2e}",
                    f"{each['excess_se']:.1e}",
                    f"{each['worse']:.0%}",
                )
                for count, each in found["particles"].items()
            ),
        ],
        about="Excess: the mean square error less the Kalman filter's, and its standard error over "
        "drives; worse in: the share of drives in which it is above 0.",
    )
    record.note(
        "The reference finds its particle filter of 100 much more accurate than the Kalman filter. "
        "On a linear Gaussian model no estimator has a smaller expected square error than the "
        "Kalman filter, which a particle filter tends to as its particles grow in number. Excess "
        "is its mean square error less the Kalman filter's, over the same drives, with its "
        f"standard error; {_excesses(found['particles'])}."
    )


def _excesses(found: dict[str, Any]) -> str:
    """With how many particles the excess is told from 0, and to which side."""
    above = [n for n, each in found.items() if each["excess"] > 2.0 * each["excess_se"]]
    below = [n for n, each in found.items() if each["excess"] < -2.0 * each["excess_se"]]
    says = [
        f"{side} 0 by more than two of them with {', '.join(counts)} particles"
        for side, counts in (("above", above), ("below", below))
        if counts
    ]
    return f"here it is {', '.join(says) or 'within two of them of 0'}"


def note_findings(
    record: Record, found: By, drawn: str, held: dict[str, Any], around: dict[str, Any]
) -> None:
    """Note findings that go beyond the reference."""
    exact = found[drawn]["1"]["exact"]["filter"]
    taylor, unscented = (found["variance"]["2b"][rule] for rule in ("Taylor", "Unscented"))
    record.note(
        f"Told w T in place of w √T, the Kalman filter of problem 1 has a NEES of "
        f"{held['nees']:.1f} where {exact['nees']:.2f} is right (2 is due), and an RMSE "
        f"of {held['rmse']:.3f} m in place of {exact['rmse']:.3f} m."
    )
    ends = "; ".join(
        f"{each['tangential'][-1]:.2f} m along the circle and {each['radial'][-1]:.2f} m towards "
        f"the landmark, with {meaning}s"
        for meaning, each in around.items()
    )
    record.note(
        "Problem 2b: a turn of the whole robot about the only landmark changes neither range nor "
        "bearing. Nothing but the known start fixes its place on the circle, and the ellipse grows "
        f"along it without end: at the last reading its standard deviation is {ends}. The "
        "place is then known to lie on an arc, which no ellipse follows. Where noise is larger, "
        "with variances, the NEES of the last step is "
        f"{taylor['filter']['nees_last']:.1f} with Taylor and "
        f"{unscented['filter']['nees_last']:.1f} with the unscented rule where 3 is due, and that "
        f"of all steps {taylor['filter']['nees']:.1f} and {unscented['filter']['nees']:.1f} for "
        f"filters, {taylor['smoother']['nees']:.1f} and {unscented['smoother']['nees']:.1f} for "
        "smoothers."
    )


def show(record: Record, solved: dict[str, dict[str, Solved]], drawn: str) -> dict[str, int]:
    """Figures and animations; returns the number of pictures of each animation."""
    for name, each in solved[drawn].items():
        drive = each.drive()
        record.figure(
            drive_figure(drive),
            f"problem_{name}",
            f"{drive.problem.title}: one drive of {drive.problem.steps} motions and "
            f"{len(drive.problem.measured)} readings. Left, all of it in the plane, with the "
            f"filter's 95 % ellipse after some readings ({RINGS} at most). Right, two seconds: the "
            "ellipse grows at each of the eight motions of a second and shrinks at the reading. "
            "Below, errors of filter and smoother over time in the filter's 95 % band, whose teeth "
            "are the readings.",
        )
    runs = len(next(iter(solved[drawn].values())).truth)
    record.figure(
        nees_figure({m: {n: s.nees() for n, s in by.items()} for m, by in solved.items()}, runs),
        "nees",
        f"Do the beliefs know their errors? The NEES of each step over time [s], averaged over "
        f"{runs} drives, with its 99 % band: 2 is right in problem 1, 3 in problem 2, and above "
        "the band a belief is too sure of itself. Problem 1 needs no lineariser. Where a curve is "
        "not seen it lies below another.",
    )
    counts = {}
    for name, each in solved[drawn].items():
        drive = each.drive()
        file = f"problem_{name}.gif"
        with record.file(file) as path:
            counts[file], every = animate(drive, each.cloud(PARTICLES), path), EVERY[name]
        record.picture(
            file,
            f"{drive.problem.title}: truth, the Kalman filter's estimate, and its ellipse (95 %), "
            "by turns blue after a motion halfway between readings and orange after a reading; "
            f"beside them {PARTICLES} particles of the same drive, in green, and their mean. A "
            f"picture every {every} motions ({every * DT:g} s), which skips the {every - 1} "
            "between and what was read after them. Right, what is near the robot; axes in metres.",
        )
    return counts
