"""A robot that sees two landmarks, across the branch of its heading."""

import numpy as np

import pgm

S = pgm.Variable("s", components=("east", "north", "heading"), angles=("heading",))
U = pgm.Variable("u", components=("v", "omega"))
R = pgm.Variable("r", components=("range", "bearing"), angles=("bearing",))
M = pgm.Variable("m", components=("east", "north"))


def drive(s, u):
    heading = s[..., 2] + 0.5 * u[..., 1]
    step = [u[..., 0] * np.cos(heading), u[..., 0] * np.sin(heading), u[..., 1]]
    return s + np.stack(step, axis=-1)


def see(s, m):
    away = m - s[..., :2]
    bearing = np.arctan2(away[..., 1], away[..., 0]) - s[..., 2]
    return np.stack([np.hypot(away[..., 0], away[..., 1]), bearing], axis=-1)


ROBOT = pgm.DynamicBayesianNetwork(
    [pgm.GaussianCPD(S, [0.0, 0.0, 3.0], [0.04, 0.04, 0.01])],
    [pgm.NonlinearGaussianCPD(S, (S.previous, U), drive, cov=[0.01, 0.01, 0.001])],
    [pgm.NonlinearGaussianCPD(R, (S, M), see, cov=[0.04, 0.0025])],
)


CONTROLS = np.tile([0.5, 0.1], (12, 1))


def driven(runs=(), each=2):
    """Evidence of a drive, across the branch of the heading; `each` of two landmarks a step."""
    rng = np.random.default_rng(4)
    marks = np.array([[4.0, 3.0], [-5.0, 2.0]])
    steps = np.repeat(np.arange(1, 13), each)
    given = {
        U: CONTROLS,
        R: pgm.sightings(step=steps, given={M: marks[np.arange(12 * each) % 2]}),
    }
    return ROBOT.sample(given, runs=runs, rng=rng)
