"""Networks that particles are tried on."""

import numpy as np

import pgm

x = pgm.Variable("x", components=("p", "v"))
z = pgm.Variable("z")
pose = pgm.Variable("pose", components=("east", "north", "heading"), angles=("heading",))
move = pgm.Variable("move", components=("ahead", "turn"))
seen = pgm.Variable("seen", components=("range", "bearing"), angles=("bearing",))
mark = pgm.Variable("mark", components=("east", "north"))


def cart(noise=1.0):
    """A cart whose position is read: linear, with correlated noise."""
    step = np.array([[1.0, 0.5], [0.0, 0.9]])
    return pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(x, mean=[0.0, 1.0], cov=[[1.0, 0.3], [0.3, 0.5]])],
        transition=[
            pgm.LinearGaussianCPD(x, given={x.previous: step}, cov=[[0.2, 0.05], [0.05, 0.1]])
        ],
        observation=[pgm.LinearGaussianCPD(z, given={x: [[1.0, 0.0]]}, cov=noise)],
    )


def drive(x, u):
    course = x[..., 2] + 0.5 * u[..., 1]
    moved = [u[..., 0] * np.cos(course), u[..., 0] * np.sin(course), u[..., 1]]
    return x + np.stack(moved, axis=-1)


def range_bearing(x, m):
    away = m - x[..., :2]
    bearing = np.arctan2(away[..., 1], away[..., 0]) - x[..., 2]
    return np.stack([np.hypot(away[..., 0], away[..., 1]), bearing], axis=-1)


def robot():
    """A robot that sees landmarks: nonlinear, with an angle."""
    return pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(pose, mean=[5.0, 3.0, 0.5], cov=np.diag([0.6, 0.6, 0.4]) ** 2)],
        transition=[
            pgm.NonlinearGaussianCPD(
                pose, (pose.previous, move), drive, np.diag([0.1, 0.1, 0.06]) ** 2
            )
        ],
        observation=[
            pgm.NonlinearGaussianCPD(seen, (pose, mark), range_bearing, np.diag([0.3, 0.2]) ** 2)
        ],
    )


def robot_evidence(steps=8, runs=(), rng=2):
    """Controls and drawn sightings of two landmarks."""
    marks = np.tile([[9.0, 6.0], [2.0, 7.0]], (steps, 1))
    when = np.repeat(np.arange(1, steps + 1), 2)
    inputs = {
        move: np.tile([0.3, 0.15], (steps, 1)),
        seen: pgm.sightings(step=when, given={mark: marks}),
    }
    return robot().sample(inputs, runs=runs, rng=rng).evidence
