"""Beliefs that are hard to draw, each as a function that draws it."""

from __future__ import annotations

import matplotlib.pyplot as plt
import numpy as np

import pgm
import pgm.plot
from pgm.maps import OccupancyMap

X = pgm.Variable("x", components=("east", "north", "heading"), angles=("heading",))


def loop(steps=101, *, seed=0, radius=20.0, wobble=0.3, std=0.8, at=(0.0, 0.0)):
    """A belief of a robot that drives a loop, and the truth."""
    rng = np.random.default_rng(seed)
    turn = np.linspace(0.0, 2.0 * np.pi, steps)
    truth = np.stack([radius * np.cos(turn), radius * np.sin(2 * turn) / 2, turn], axis=-1)
    truth[:, :2] += at
    slow = (
        np.cumsum(rng.standard_normal((steps, 3)), axis=0)
        / np.sqrt(np.arange(1, steps + 1))[:, None]
    )
    root = std * (np.eye(3) + 0.4 * rng.standard_normal((3, 3)))
    cov = np.tile(root @ root.T, (steps, 1, 1)) * (0.2 + np.sin(turn / 2) ** 2)[:, None, None]
    return pgm.Gaussian(X, truth + wobble * slow, cov, steps=np.arange(steps)), truth


def paths(count, **keywords):
    """Some beliefs that nearly coincide, on one axes."""
    ax = None
    for k in range(count):
        belief, truth = loop(seed=k, **keywords)
        ax = pgm.plot.trajectory(belief, truth=truth, label=f"belief {k}", ax=ax, unit="m")
    return ax


def sighted():
    """Landmarks that are given once a sighting."""
    belief, truth = loop()
    places = np.array([[25.0, 10.0], [-22.0, -8.0], [0.0, 12.0], [5.0, -11.0]])
    return pgm.plot.trajectory(
        belief, truth=truth, landmarks=np.tile(places, (200, 1)), label="filter"
    )


def start():
    belief, truth = loop(2)
    return pgm.plot.trajectory(belief[:1], truth=truth[:1], label="start")


def straight():
    mean = np.linspace([0.0, 0.0, 0.0], [100.0, 0.0, 0.0], 50)
    belief = pgm.Gaussian(X, mean, 1e-6 * np.eye(3), steps=np.arange(50))
    return pgm.plot.trajectory(belief, truth=mean)


def _robot():
    def ahead(x):
        heading = x[..., 2]
        return x + np.stack([np.cos(heading), np.sin(heading), 0 * heading], axis=-1)

    return pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(X, [2.0, 1.0, 0.0], np.diag([0.05, 0.05, 10.0]))],
        [pgm.NonlinearGaussianCPD(X, X.previous, ahead, np.diag([0.04, 0.04, 0.02]))],
    )


def grid():
    on = pgm.Grid({"east": (-1.0, 5.0, 40), "north": (-2.0, 4.0, 30), "heading": 24})
    belief = pgm.filter(_robot(), {}, steps=1, belief=on)[X.at(1)]
    return pgm.plot.grid_map(
        belief, truth=[3.0, 1.0, 0.0], landmarks=[[0.0, 0.0], [4.0, 3.0]], unit="m"
    )


def cloud(count):
    belief = pgm.filter(_robot(), {}, steps=1, belief=pgm.Particles(count, seed=1))[X.at(1)]
    return pgm.plot.particles(belief, truth=[3.0, 1.0, 0.0], landmarks=[[0.0, 0.0]])


def _table(*variables, lead=(), seed=0, sharp=4.0):
    rng = np.random.default_rng(seed)
    values = np.exp(sharp * rng.standard_normal((*lead, *(v.size for v in variables))))
    return pgm.Table(variables, values / values.sum(), lead=lead)


def cells(rows, columns, names=False):
    r = pgm.Discrete("row", [f"corridor {k}" for k in range(rows)] if names else rows)
    c = pgm.Discrete("column", columns)
    return pgm.plot.belief_map(_table(r, c), truth=(1, 1))


def maze(count):
    rng = np.random.default_rng(3)
    place = pgm.Discrete("place", count)
    at = rng.permutation(np.argwhere(np.ones((12, 16))))[:count]
    return pgm.plot.belief_map(_table(place, sharp=1.5), places=at, truth=2)


def rows(size, steps, beliefs=2, names=None):
    place = pgm.Discrete("place", size if names is None else names)
    rng = np.random.default_rng(0)
    truth = rng.integers(0, place.size, steps)
    ax = None
    for k in range(beliefs):
        found = _table(place, lead=(steps,), seed=k, sharp=1.0)
        ax = pgm.plot.beliefs_over_time(found, truth=truth, label=f"belief {k}", ax=ax)
    return ax


def building():
    rng = np.random.default_rng(0)
    occupied = (rng.random((40, 60)) > 0.9).astype(float)
    occupied[10:20, 40:] = np.nan
    ax = pgm.plot.occupancy_map(OccupancyMap(occupied, 0.5, (-15.0, -10.0, 0.3)))
    belief, truth = loop(radius=8.0, std=0.3, at=(-3.0, 6.0))
    return pgm.plot.trajectory(belief, truth=truth, label="filter", ax=ax)


def apart():
    belief, _ = loop(40)
    return pgm.plot.ellipses(belief, ax=plt.subplots(figsize=(3.0, 2.0), layout="constrained")[1])


_ROOMS = ("kitchen", "living room", "bathroom", "study", "very long corridor name")
BELIEFS = {
    "trajectory": lambda: paths(1),
    "two paths": lambda: paths(2, wobble=0.05),
    "nine paths": lambda: paths(9),
    "one step": start,
    "straight": straight,
    "far away": lambda: paths(2, at=(5.0e6, 4.0e5)),
    "long": lambda: paths(2, steps=10_001),
    "sighted landmarks": sighted,
    "ellipses": apart,
    "ellipses one": lambda: pgm.plot.ellipses(loop(3)[0][1]),
    "grid": grid,
    "particles 10": lambda: cloud(10),
    "particles 50000": lambda: cloud(50_000),
    "cells 3 4": lambda: cells(3, 4, names=True),
    "cells 40 60": lambda: cells(40, 60),
    "cells 1 30": lambda: cells(2, 15),
    "maze": lambda: maze(60),
    "maze 20": lambda: maze(20),
    "rows 3": lambda: rows(3, 8),
    "rows 60": lambda: rows(60, 100),
    "rows names": lambda: rows(5, 12, names=_ROOMS),
    "rows 8 beliefs": lambda: rows(4, 4, beliefs=8),
    "rows one": lambda: rows(2, 1, beliefs=1),
    "occupancy": building,
}
