"""The localisation problem as a network and as a cluster graph, and what its messages are.

Figures 6.1 and 6.2 of the 2018 report, drawn from a declared model, and the claim of its section
6.2 in numbers: a forward message is the belief of the Bayes filter, and messages both ways make the
smoother. Cluster 0 holds the prior, so that δ₀,₁ is the initial belief, as in (6.5).

In summary.json: ``clusters``, ``sepsets`` and ``check``, of the graph; ``forward`` and ``both``, a
list over sepsets of ``mean``, ``cov`` and ``log_weight``; ``difference`` of each from the textbook,
and ``largest_difference``.
"""

from __future__ import annotations

from typing import Annotated, Any

import matplotlib.pyplot as plt
import numpy as np
import typer
from matplotlib.figure import Figure

import pgm
import pgm.plot
from experiments.kinds import as_form
from experiments.record import Out, Record, Seed
from experiments.textbook import Belief, Step, bayes_filter, extended_kalman_filter, rts_smoother
from models import sensors
from models.motion import Velocity
from models.networks import fix, pose, velocity, velocity_position

Evidence = dict[pgm.Variable, Any]

DT = 1.0  # s
START, MOTION, SENSOR = (0.1, 0.1, 0.05), (0.1, 0.1, 0.05), (0.2, 0.2)  # m, m, rad
CONTROL = (1.0, 0.3)  # m/s, rad/s
SHOWN = 3  # the last step in the figures
QUICK: dict[str, Any] = {"steps": 4}


def run(
    out: Out = None,
    seed: Seed = 0,
    steps: Annotated[int, typer.Option(min=SHOWN + 1, help="The last step, T.")] = 10,
) -> None:
    """The localisation network and its cluster graph: messages are the Bayes filter's beliefs."""
    record = Record(
        "cluster_graph",
        out,
        seed=seed,
        steps=steps,
        dt=DT,
        control=CONTROL,
        start_std=START,
        motion_std=MOTION,
        sensor_std=SENSOR,
    )
    model = velocity_position(DT, start_std=START, motion_std=MOTION, sensor_std=SENSOR)
    controls = np.tile(CONTROL, (steps, 1))
    evidence = {velocity: controls, fix: model.sample({velocity: controls}, rng=seed)[fix]}
    graph = pgm.compile(model, steps=steps)
    graph.check()
    record.figure(
        network_figure(model),
        "network",
        "Figure 6.1: the Bayesian network of the localisation problem, with the CPD of each node. "
        "Shaded: known. Controls u are inputs here: with their values given, φ_u of (6.1) is a "
        "constant.",
    )
    record.figure(
        graph_figure(graph, evidence),
        "cluster_graph",
        "Figure 6.2: its cluster graph. Ellipses are clusters, rectangles sepsets; arrows are the "
        "messages in both directions. The dashed line leads to the steps not drawn.",
    )
    record.note(
        f"graph.check() proved family preservation and running intersection of {len(graph)} "
        f"clusters and {len(graph.sepsets)} sepsets."
    )
    forward, both = messages(graph, evidence)
    filtered, smoothed = textbook(evidence)
    difference = {"forward": apart(forward, filtered), "both": apart(both, smoothed)}
    for title, found, off in (
        ("Forward messages δ(t, t+1) of x[t]", forward, difference["forward"]),
        ("Both messages δ(t, t+1) δ(t+1, t) of x[t]", both, difference["both"]),
    ):
        record.table(
            f"{title}: mean ± σ [m, m, rad]",
            ("t", *pose.components, "ln weight", "off by"),
            [
                (t, *_spreads(message), message["log_weight"], worst)
                for t, (message, worst) in enumerate(zip(found, off, strict=True))
            ],
            about="A message as a Gaussian, a component a column [m, m, rad]. ln weight: the "
            "logarithm of its integral, which is the evidence; off by: its largest difference from "
            "the textbook's extended Kalman filter or smoother.",
        )
    worst = max(map(max, difference.values()))
    record.note(
        "A forward message is the belief of the Bayes filter, which here is the textbook's "
        "extended Kalman filter, with the evidence so far as its weight. Times the backward "
        "message it is the belief of the smoother, and every sepset has the evidence of all "
        f"readings. The largest difference of a mean, covariance or weight: {worst:.2g}."
    )
    record.summary(
        clusters=len(graph),
        sepsets=len(graph.sepsets),
        check="passed",
        forward=forward,
        both=both,
        difference=difference,
        largest_difference=worst,
    )


def network_figure(model: pgm.DynamicBayesianNetwork) -> Figure:
    """The first steps of the network; nothing is measured at step 0."""
    network = pgm.BayesianNetwork(cpd for cpd in model.unroll(SHOWN).cpds if cpd.child != fix.at(0))
    readings = [fix.at(step) for step in range(1, SHOWN + 1)]
    ax = pgm.plot.network(network, evidence=readings, cpds=True)
    return _closed(ax.figure)


def graph_figure(graph: pgm.ClusterGraph, evidence: Evidence) -> Figure:
    """The first clusters, with the messages between them."""
    ax = pgm.plot.cluster_graph(graph, steps=SHOWN, evidence=evidence, messages=True)
    return _closed(ax.figure)


def messages(graph: pgm.ClusterGraph, evidence: Evidence) -> tuple[list[Any], list[Any]]:
    """Of each sepset the forward message, and its product with the backward one, as moments."""
    posterior = pgm.infer(graph, evidence, schedule=pgm.Smoothing())
    forward = [as_form(posterior.message(t, t + 1)) for t, _ in graph.sepsets]
    back = [as_form(posterior.message(t + 1, t)) for t, _ in graph.sepsets]
    both = [there * other for there, other in zip(forward, back, strict=True)]
    return [_moments(m) for m in forward], [_moments(m) for m in both]


def textbook(evidence: Evidence) -> tuple[list[Any], list[Any]]:
    """Of each step but the last, what the extended Kalman filter and its smoother say.

    Like `messages`: a belief with the log-density of the readings so far, or of all.
    """
    drive = Velocity(dt=DT)

    def one_step(belief: Belief, u: Any, z: Any) -> Step:
        return extended_kalman_filter(
            belief,
            u,
            z,
            g=drive,
            G=drive.by_state,
            h=sensors.position,
            H=sensors.position_by_state,
            process_noise=np.diag(np.square(MOTION)),
            sensor_noise=np.diag(np.square(SENSOR)),
        )

    initial = Belief(np.zeros(3), np.diag(np.square(START)))
    steps = bayes_filter(one_step, initial, evidence[velocity], evidence[fix])
    weights = np.cumsum([0.0, *(step.log_density for step in steps)]).tolist()
    filtered = [initial, *(step.filtered for step in steps)]
    smoothed = rts_smoother(initial, steps)
    return (
        [_numbers(*belief, w) for belief, w in zip(filtered[:-1], weights, strict=False)],
        [_numbers(*belief, weights[-1]) for belief in smoothed[:-1]],
    )


def apart(found: list[Any], due: list[Any]) -> list[float]:
    """The largest difference of a mean, covariance or weight, by step."""
    return [
        max(float(np.abs(np.subtract(a[key], b[key])).max()) for key in b)
        for a, b in zip(found, due, strict=True)
    ]


def _moments(message: pgm.CanonicalForm) -> dict[str, Any]:
    gaussian = message.gaussian()
    return _numbers(gaussian.mean, gaussian.cov, float(message.log_integral))


def _numbers(mean: Any, cov: Any, log_weight: float) -> dict[str, Any]:
    return {"mean": mean.tolist(), "cov": cov.tolist(), "log_weight": log_weight}


def _spreads(message: dict[str, Any]) -> list[str]:
    std = np.sqrt(np.diag(message["cov"]))
    return [f"{m:.3f} ± {s:.3f}" for m, s in zip(message["mean"], std, strict=True)]


def _closed(figure: Any) -> Figure:
    plt.close(figure)
    assert isinstance(figure, Figure)
    return figure
