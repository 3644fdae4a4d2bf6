"""Many drives among landmarks, estimated three ways with each of three linearisers."""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
import typer

import pgm
from experiments.record import Out, Record, Seed, progress
from experiments.smoothing import figures
from experiments.smoothing.judging import CONFIDENCE, KINDS, LOST, Beliefs, gain, judge
from experiments.unsettled import unsettled
from models import networks, simulation
from models.networks import pose, sighting, velocity
from pgm import consistency

LINEARISERS: dict[str, pgm.Lineariser] = {
    "Taylor": pgm.Taylor(),
    "Unscented": pgm.Unscented(),
    "Cubature": pgm.Cubature(),
}
DT = 0.25  # s
REACH = 3.0  # m, how far the sensor sees
START_STD = (0.3, 0.3, 0.5)  # m, m, rad
MOTION_STD = (0.08, 0.08, 0.06)  # m, m, rad a step
SENSOR_STD = (0.1, 0.03)  # m, rad
# Once around in a hundred steps, past four landmarks that are seen one at a time.
SPEED, TURN = 1.0, 2.0 * np.pi / 25.0  # m/s, rad/s
LANDMARKS = np.array([(4.8, 1.2), (2.8, 8.7), (-4.8, 6.7), (-2.8, -0.8)])  # m
# Of the iterated smoother, in standard deviations of the belief.
TOLERANCE = 0.01
LAGS = 20
QUICK: dict[str, Any] = {"runs": 40, "steps": 40}


def run(
    out: Out = None,
    seed: Seed = 0,
    runs: Annotated[int, typer.Option(min=2, help="Drives to average over.")] = 500,
    steps: Annotated[
        int, typer.Option(min=20, help="Steps of a drive, a quarter of a second each.")
    ] = 100,
    iterations: Annotated[
        int, typer.Option(min=2, help="Linearisations of the iterated smoother.")
    ] = 5,
) -> None:
    """Filter, smooth, and smooth again and again: errors and consistency over many runs."""
    record = Record(
        "smoothing",
        out,
        seed=seed,
        runs=runs,
        steps=steps,
        iterations=iterations,
        tolerance=TOLERANCE,
        landmarks=LANDMARKS,
        dt=DT,
        reach=REACH,
        start_std=START_STD,
        motion_std=MOTION_STD,
        sensor_std=SENSOR_STD,
    )
    network, drive = simulate(seed, runs, steps)
    beliefs, plain, status = estimate(network, drive, iterations)
    results = judge(beliefs, drive.truth)
    gains = {name: gain(kinds, drive.truth) for name, kinds in beliefs.items()}
    whiteness = {name: _innovations(posterior) for name, posterior in plain.items()}
    converged = {name: float(found.converged.mean()) for name, found in status.items()}

    low, high = consistency.mean_band(3, runs, CONFIDENCE)
    each = [(name, kind) for name in beliefs for kind in KINDS]
    record.table(
        f"RMSE of {runs} drives of {steps} steps among {len(LANDMARKS)} landmarks",
        ("lineariser", "belief", "xy [m]", "heading [rad]", "change of xy [m]"),
        [
            (
                name,
                kind,
                results["rmse"][name][kind],
                results["rmse_heading"][name][kind],
                _signed(gains[name].get(kind)),
            )
            for name, kind in each
        ],
        about="Root mean square errors over runs and steps. Change: against the belief in the line "
        "above, with its standard error over runs, which are paired. The iterated smoother "
        f"linearises {iterations} times.",
        best={"xy [m]": -np.inf, "heading [rad]": -np.inf},
        within=("lineariser",),
    )
    record.table(
        f"Consistency of {runs} drives of {steps} steps",
        ("lineariser", "belief", "NEES", "in band", "coverage", "lost", "settled"),
        [
            (
                name,
                kind,
                results["nees"][name][kind],
                f"{results['steps_inside'][name][kind]:.0%}",
                f"{results['coverage'][name][kind]:.3f}",
                f"{results['lost'][name][kind]:.1%}",
                f"{converged[name]:.0%}" if kind == "iterated" else "",
            )
            for name, kind in each
        ],
        about="NEES: mean over runs and steps; a right belief has 3. In band: the share of steps "
        f"at which the mean over runs is inside the 95 % χ² band, {low:.3f} to {high:.3f}; about "
        "95 % for a right belief. Coverage: the share of truths inside the 95 % region of the "
        f"pose. Lost: runs whose own mean NEES is more than {LOST * 3}, which rule the means. "
        f"Settled: runs whose last relinearisation moved no mean by more than {TOLERANCE} "
        "standard deviations.",
        best={"NEES": 3.0, "coverage": 0.95},
        within=("lineariser",),
    )
    record.table(
        "Innovations of the filter",
        ("lineariser", "NIS / degrees", "whiteness p"),
        [(name, found["nis"], found["probability"]) for name, found in whiteness.items()],
        about="A right filter has an NIS of 1 for each degree of freedom, and innovations that are "
        "white: p is the probability that white ones look less white. Both see an error only "
        "once a reading contradicts it; the NEES, which needs the truth, sees it at once.",
        best={"NIS / degrees": 1.0},
    )
    times = np.arange(steps + 1) * DT
    record.figure(
        figures.rmse(beliefs, drive.truth, times),
        "rmse",
        "Errors of the position [m] and of the heading [rad] over time [s], by lineariser: RMSE "
        "over runs (line), and the 5th to 95th percentile of a run's error (band). The filter's "
        "error grows where no landmark is in reach and falls at the next sighting, which the "
        "smoothers know beforehand. A line far above the middle of its band is ruled by few bad "
        "runs.",
    )
    record.figure(
        figures.nees(beliefs, drive.truth, times),
        "nees",
        "NEES over time [s], averaged over runs, for each of the pose's three degrees of freedom, "
        "with the 95 % χ² band. Above the band a belief is surer than its errors allow.",
    )
    record.figure(
        figures.coverage(beliefs, drive.truth),
        "coverage",
        "Share of true poses inside confidence regions of the pose; on the diagonal a belief "
        "holds the truth as often as it says. The bands are 95 % binomial intervals that count "
        "runs alone, since steps of a run depend on each other.",
    )
    record.figure(
        figures.innovations(plain, times),
        "innovations",
        "Above, NIS of the filter for each degree of freedom, with gaps where no landmark is in "
        "reach; below, the autocorrelation of its whitened innovations, both with 95 % bands; p as "
        "in the notes.",
    )
    record.figure(
        figures.convergence(status, TOLERANCE),
        "convergence",
        "The largest move of a mean at each relinearisation of the iterated smoother: median "
        "over runs, within the band from the least to the greatest.",
    )
    record.summary(
        **results,
        nees_band=(low, high),
        gain=gains,
        whiteness=whiteness,
        converged=converged,
    )


def simulate(
    seed: int, runs: int, steps: int
) -> tuple[pgm.DynamicBayesianNetwork, simulation.Drive]:
    """A network with a poor start, and drives drawn from it.

    Every run reads the landmarks within reach of the path as commanded. Were they those within
    reach of the true path, that they are read would tell something that no CPD says.
    """
    rng = np.random.default_rng(seed)
    controls = np.tile((SPEED, TURN), (steps, 1))
    still = networks.range_bearing(DT, start_std=(0, 0, 0), motion_std=(0, 0, 0))
    planned = simulation.drive(still, controls, LANDMARKS, reach=REACH, rng=rng).evidence[sighting]
    network = networks.range_bearing(
        DT, start_std=START_STD, motion_std=MOTION_STD, sensor_std=SENSOR_STD
    )
    places = pgm.sightings(step=planned.step, given=planned.given)
    sample = network.sample({velocity: controls, sighting: places}, runs=runs, rng=rng)
    return network, simulation.Drive(sample[pose], LANDMARKS, dict(sample.evidence))


@unsettled()
def estimate(
    network: pgm.DynamicBayesianNetwork, drive: simulation.Drive, iterations: int
) -> tuple[dict[str, Beliefs], dict[str, pgm.results.Posterior], dict[str, pgm.results.Status]]:
    """The three beliefs of each lineariser, its plain posterior, and how its iterating went."""
    beliefs: dict[str, Beliefs] = {}
    plain, status = {}, {}
    for name in progress(list(LINEARISERS), "smoothing"):
        once = pgm.smooth(network, drive.evidence, lineariser=LINEARISERS[name])
        often = pgm.smooth(
            network,
            drive.evidence,
            lineariser=LINEARISERS[name],
            iterations=iterations,
            tolerance=TOLERANCE,
        )
        beliefs[name] = {
            "filter": once.filtered[pose],
            "smoother": once[pose],
            "iterated": often[pose],
        }
        plain[name], status[name] = once, often.status
    return beliefs, plain, status


def _signed(change: tuple[float, float] | None) -> str:
    return "" if change is None else f"{change[0]:+.3f} ± {change[1]:.3f}"


def _innovations(posterior: pgm.results.Posterior) -> dict[str, Any]:
    innovations = posterior.innovations[sighting]
    read = len(np.unique(innovations.step))
    found = consistency.whiteness(innovations, min(LAGS, read - 1))
    every = consistency.anis(innovations).overall().per_dof()
    return {
        "nis": float(every.value),
        "probability": found.probability,
        "autocorrelation": found.autocorrelation,
        "band": found.band,
    }
