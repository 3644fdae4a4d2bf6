"""The basics, drawn with the library: figures 2.1, 2.2, 3.1, 3.2, 5.1 and 5.2 of the 2018 report.

The numbers are our own. summary.json has under ``inside`` the shares of draws within σ of the mean
and within the 95 % ellipse, under ``ellipse`` half axes and orientation by the library and by
eigenvectors, and under ``motion`` the next pose by the model and by the report's equation (3.12).
"""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
import typer

from experiments.basics import gaussians, graphs, poses
from experiments.record import Out, Record, Seed
from models.motion import Velocity

QUICK: dict[str, Any] = {"draws": 1000}
CAPTIONS = {
    "density": (
        "Figure 2.1: the density of a Gaussian of one variable. The mean μ is where its peak is, "
        "the standard deviation σ how far it spreads: 68 % of it lies within σ of μ (shaded)."
    ),
    "error_ellipse": (
        "Figure 2.2: the error ellipse that holds a Gaussian of two variables with probability "
        "95 %. Dotted: its axes, along the eigenvectors of the covariance, of the lengths 2√(sλ), "
        "λ being the eigenvalues and s = 5.991; α is the angle of the major axis from x₁."
    ),
    "pose": "Figure 3.1: the pose of a robot at time t, its position (x, y) and its heading θ.",
    "two_poses": (
        "Figure 3.2: the poses at times t−1 and t. The robot moves forward with the velocity v and "
        "turns anticlockwise with the velocity ω; dashed: the arc between."
    ),
    "graphs": (
        "Figures 5.1 and 5.2: in an undirected graph, a Markov network, an edge joins variables "
        "that share a factor; no directed graph says the same as this one. In a directed graph, a "
        "Bayesian network, a is a parent of b and an ancestor of c. Made undirected, it joins the "
        "parents of c too (dashed), for the CPD of c is a factor of them all."
    ),
}
FIGURES = {
    "density": gaussians.density,
    "error_ellipse": gaussians.error_ellipse,
    "pose": poses.pose,
    "two_poses": poses.two_poses,
    "graphs": graphs.kinds,
}


def run(
    out: Out = None,
    seed: Seed = 0,
    draws: Annotated[int, typer.Option(min=1, help="Draws of each Gaussian.")] = 100_000,
) -> None:
    """The basics, drawn: Gaussians and error ellipses, a robot's poses, kinds of graphs."""
    record = Record("basics", out, seed=seed, draws=draws)
    for name, draw in FIGURES.items():
        record.figure(draw(), name, CAPTIONS[name])
    inside = gaussians.inside(draws, np.random.default_rng(seed))
    ours = gaussians.TWO.ellipse(gaussians.CONFIDENCE)
    half, angle = gaussians.axes_of(gaussians.TWO.cov)
    reached = Velocity(poses.DT)(poses.BEFORE, poses.VELOCITIES)
    formula = poses.step_by_formula()
    record.table(
        "What the figures show, and the same found otherwise",
        ("figure", "quantity", "drawn", "otherwise"),
        [
            ("2.1", "probability within σ of μ, share of draws", 0.6827, inside["within_std"]),
            ("2.2", "probability of the ellipse, share of draws", 0.95, inside["within_ellipse"]),
            ("2.2", "half the major axis, by eigenvectors", float(ours.half_axes[0]), half[0]),
            ("2.2", "half the minor axis, by eigenvectors", float(ours.half_axes[1]), half[1]),
            ("2.2", "α [rad], by eigenvectors", gaussians.orientation(), angle),
            *(
                ("3.2", f"{name} at time t [{unit}], by equation (3.12)", *pair)
                for name, unit, pair in zip(
                    ("x", "y", "θ"),
                    ("m", "m", "rad"),
                    zip(reached.tolist(), formula.tolist(), strict=True),
                    strict=True,
                )
            ),
        ],
    )
    record.summary(
        inside=inside,
        ellipse={
            "drawn": [*ours.half_axes, gaussians.orientation()],
            "eigenvectors": [*half, angle],
        },
        motion={"model": reached, "equation": formula},
    )
