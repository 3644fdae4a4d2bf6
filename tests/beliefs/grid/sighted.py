"""Models that tests put on grids: a robot that sights landmarks, and linear ones."""

import numpy as np

import pgm

x = pgm.Variable("x", components=("east", "north", "heading"), angles=("heading",))
u = pgm.Variable("u", components=("distance", "turn"))
z = pgm.Variable("z", components=("range", "bearing"), angles=("bearing",))
m = pgm.Variable("m", components=("east", "north"))
LANDMARKS = np.array([[1.0, 1.0], [9.0, 5.5], [5.0, 6.0]])


def drive(x, u):
    heading = x[..., 2]
    moved = [u[..., 0] * np.cos(heading), u[..., 0] * np.sin(heading), u[..., 1]]
    return x + np.stack(moved, axis=-1)


def sight(x, m):
    east, north = m[..., 0] - x[..., 0], m[..., 1] - x[..., 1]
    return np.stack([np.hypot(east, north), np.arctan2(north, east) - x[..., 2]], axis=-1)


def robot(plane=0.1, turn=0.06, prior=(4.0, 3.0, 0.5), cov=np.inf, reach=0.3, bearing=0.15):
    """A robot with the given deviations of its motion, and of its sensor."""
    cov = np.diag(np.broadcast_to(cov, 3)) if np.ndim(cov) < 2 else cov
    noise = np.diag([plane**2, plane**2, turn**2])
    return pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(x, prior, cov)],
        [pgm.NonlinearGaussianCPD(x, (x.previous, u), drive, noise)],
        [pgm.NonlinearGaussianCPD(z, (x, m), sight, np.diag([reach**2, bearing**2]))],
    )


def evidence(model, steps, seed=0, shift=(0.0, 0.0), controls=None):
    """Two sightings a step, of a robot on a circle inside the landmarks."""
    if controls is None:
        controls = np.stack([np.full(steps, 0.25), 0.2 + 0.05 * np.sin(np.arange(steps))], axis=-1)
    step = np.repeat(np.arange(steps + 1), 2)
    seen = LANDMARKS[np.arange(len(step)) % 3] + shift
    start = [4.0 + shift[0], 3.0 + shift[1], 0.5]
    drawn = model.replace(prior=[pgm.GaussianCPD(x, start, np.zeros((3, 3)))])
    return drawn.sample(
        {u: controls, z: pgm.sightings(step=step, given={m: seen})}, rng=seed
    ).evidence


def grid(shift=(0.0, 0.0), fine=1):
    east, north = shift
    return pgm.Grid(
        {
            "east": (east, east + 10.0, 50 * fine),
            "north": (north - 0.5, north + 7.5, 40 * fine),
            "heading": 36 * fine,
        }
    )
