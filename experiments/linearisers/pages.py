"""The report page: tables with the 2018 report's numbers beside ours, and captions."""

from __future__ import annotations

import math
from collections.abc import Mapping

from experiments.linearisers import accuracy, timing
from experiments.linearisers.accuracy import Outcome
from experiments.linearisers.figures import TITLES
from experiments.linearisers.settings import REPRODUCED, SETTINGS
from experiments.linearisers.timing import Cost
from experiments.record import Record

COST = (
    "The trend that the report announces and leaves out: time of one filter step of one robot "
    "over the number of samples, the linearisation in it, and lines a + b N fitted with relative "
    "errors. A stroke marks the knee, N = a / b. The report's times already grow with N between "
    "10 and 100 samples, as those of a loop over samples do; here all samples go through at once."
)
STATEMENT = (
    "The author's parameters are unknown. R1 and R2 were fitted, with five and six free numbers, "
    "to his four averages: that they meet them proves nothing, neither that these are his "
    "parameters nor that one technique is better than another."
)
ALIKE = (
    "All techniques get the same simulations. Monte Carlo draws fresh points in each and "
    "regresses with the prior's own mean and covariance (equations 7.15 to 7.25 as they stand); "
    "the unscented rule has λ = 2. The pose of R2 is read on the unwrapped chart of the state: "
    "read as an angle, a few headings half a turn from the prediction would take one branch in "
    "one belief and the other in the next, and raise the average of Monte Carlo 100."
)
TIMED = (
    "Step: a prediction of one robot from the prior and the update with one reading, as a robot's "
    "loop makes them (pgm.OnlineFilter), the drawing of samples included; the least of many. "
    "Linearisation: the part of it that depends on the technique. Batch: filtering all simulations "
    "of R1 at once, divided by their number. The report timed whole executions, one after the "
    "other, on another machine. Timed in the mild setting: where a sample's heading lies more than "
    "half a turn away, the engine also wraps it about the tangent, which takes a little longer."
)


def beliefs(outcomes: Mapping[str, Outcome], run: int) -> str:
    """The caption of Figure 8.1."""
    order = _ascending({name: float(each.divergence[run]) for name, each in outcomes.items()})
    return (
        "Figure 8.1, one simulation at R1 (95 % ellipses; the parameters of the report's own "
        "figure are unknown). Left: the prior in black, samples of it that the motion has moved, "
        "and the Gaussian that each technique predicts; the truth, in red, has the samples' mean "
        "and covariance. Middle: the posteriors in the plane; the position is read so sharply that "
        "they nearly coincide. Right: the same posteriors in east and heading, where they differ: "
        "how position and heading vary together, as a technique has it, decides what the position "
        "that was read tells of the heading. In the report's simulation the unscented transform "
        f"did best and Monte Carlo 10 worst; in this one, KL from best to worst: {order}. One "
        "simulation ranks no technique."
    )


def error(by_samples: Mapping[str, Mapping[str, float]]) -> str:
    """The caption of the error over the number of samples."""
    c, few = accuracy.constant(by_samples), accuracy.SIZES[0]
    above = by_samples[str(few)]["times_samples"] / c
    return (
        "Average divergence KL(truth ‖ belief) [nats] of Monte Carlo at R1 over the number of "
        f"samples N, with bars of two standard errors. The line, {c:.2f} "
        f"/ N, goes through the averages from {accuracy.FALLING} samples on; the average of {few} "
        f"is {above:.2f} times as high as the line there."
    )


def accuracy_page(
    record: Record,
    outcomes: Mapping[str, Mapping[str, Outcome]],
    again: float,
    truth_samples: int,
) -> None:
    """Table 8.1, the settings, and what they do not prove; a second truth's KL if mild."""
    record.table(
        "Settings: standard deviations [m, rad]",
        ("setting", "p", "s", "r", "r_θ", "q", "q_θ"),
        [
            (name, *s.start[1:], *s.motion[1:], s.sensor[0], *(s.sensor[2:] or ("–",)))
            for name, s in SETTINGS.items()
        ],
        about="p and s: of the prior's position [m] and heading [rad]; r and r_θ: of the motion's "
        "noise; q and q_θ: of the sensor's, a dash where it does not read the heading.",
    )
    record.table(
        "Table 8.1: average KL(truth ‖ belief) [nats]",
        ("setting", "technique", "report", "ours", "± s.e.", "median"),
        [
            (
                name,
                TITLES[technique],
                accuracy.REPORT[technique] if name in REPRODUCED else "–",
                outcome.mean,
                outcome.standard_error,
                outcome.median,
            )
            for name, each in outcomes.items()
            for technique, outcome in each.items()
        ],
        about="Ours: the mean over simulations of the divergence of a belief after one step from "
        "the best Gaussian, with its standard error; report: the number printed in 2018, a dash "
        "where it has none.",
        best={"ours": -math.inf, "median": -math.inf},
        within=("setting",),
    )
    far = max(
        abs(outcomes[name][technique].mean / reported - 1.0)
        for name in REPRODUCED
        for technique, reported in accuracy.REPORT.items()
    )
    record.note(f"Largest distance of R1 and R2 from the report: {100.0 * far:.1f} %.")
    record.note(STATEMENT)
    record.note(_mild(outcomes, again, truth_samples))
    record.note(_heavy(outcomes))
    record.note(f"{ALIKE} {_unwrapped(outcomes)}")
    record.note(_indefinite(outcomes))


def cost_page(record: Record, costs: Mapping[str, Cost], batch: Mapping[str, float]) -> None:
    """Table 8.2 and its trend."""
    record.table(
        "Table 8.2: time [ms]",
        ("technique", "report", "step", "linearisation", "batch"),
        [
            (
                TITLES[name],
                1e3 * reported,
                1e3 * costs[name].step,
                1e3 * costs[name].linearisation,
                1e3 * batch[name] if name in batch else "–",
            )
            for name, reported in timing.REPORT.items()
        ],
        about=TIMED,
        best={"step": -math.inf, "linearisation": -math.inf, "batch": -math.inf},
    )
    record.table(
        "Time [ms] by number of samples",
        ("samples", "step", "linearisation"),
        [
            (str(n), 1e3 * costs[f"MC{n}"].step, 1e3 * costs[f"MC{n}"].linearisation)
            for n in timing.SAMPLES
        ],
        about="Of one filter step of one robot, and of the linearisation in it.",
        folded=True,
    )
    for kind, line in timing.lines(costs).items():
        record.note(
            f"{kind}: {1e3 * line.fixed:.3f} ms + {1e6 * line.per_sample:.3f} µs · N, knee at "
            f"N = {line.knee:.0f}"
        )


def _ascending(divergence: Mapping[str, float]) -> str:
    order = sorted(divergence, key=divergence.__getitem__)
    return ", ".join(f"{TITLES[technique]} ({divergence[technique]:.2g})" for technique in order)


def _mild(outcomes: Mapping[str, Mapping[str, Outcome]], again: float, truth_samples: int) -> str:
    order = _ascending({name: each.mean for name, each in outcomes["mild"].items()})
    return (
        "R1 and R2 have a heading uncertain by about 1 rad, so that the motion is strongly curved "
        "over the prior. In the mild setting, ours alone, averages from best to worst are: "
        f"{order}. The truth has the moments of {truth_samples:,} samples; in the mild setting its "
        f"KL from a truth of as many other samples is {again:.2g} on average: averages no larger "
        "than that may be the truth's own error."
    )


def _heavy(outcomes: Mapping[str, Mapping[str, Outcome]]) -> str:
    ten = {name: outcomes[name]["MC10"] for name in REPRODUCED}
    tails = ", ".join(
        f"{name} {each.median:.2g} against {each.mean:.2g} ± "
        f"{100.0 * each.standard_error / each.mean:.1f} %"
        for name, each in ten.items()
    )
    simulations = next(iter(ten.values())).divergence.size
    return (
        "Monte Carlo 10 is heavy-tailed; median against average and its standard error, of "
        f"{simulations:,} simulations: {tails}."
    )


def _unwrapped(outcomes: Mapping[str, Mapping[str, Outcome]]) -> str:
    change = max(
        abs(each.unwrapped / each.mean - 1.0)
        for name in REPRODUCED
        for each in outcomes[name].values()
    )
    return (
        "Divergences are those of equation 8.4 with the difference of headings wrapped, which "
        f"alters the averages of R1 and R2 by {100.0 * change:.1f} % at the most."
    )


def _indefinite(outcomes: Mapping[str, Mapping[str, Outcome]]) -> str:
    shares = ", ".join(
        f"{name} {TITLES[technique]}: {100.0 * each[technique].indefinite:.0f} %"
        for name, each in outcomes.items()
        for technique in ("MC100", "MC10")
    )
    return (
        "With the prior's own moments the noise of the linearised motion, Σ_n + R, is indefinite "
        f"in a share of simulations ({shares}). The prediction never is: F P Fᵀ + Σ_n + R is the "
        "samples' covariance plus R, whatever F. So every divergence exists, and none is left out."
    )
