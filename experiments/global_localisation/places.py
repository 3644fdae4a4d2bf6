"""Where a belief says that the robot is, and whether that is right."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

import pgm
from pgm.kernels.angles import wrap

Array = npt.NDArray[np.float64]

# The robot is found where the estimate is off by less than this [m, rad].
NEAR, TURNED = 0.5, np.deg2rad(20.0)
# Bins among which the heaviest is looked for, and how far the mode reaches from there.
_BINS = np.array([0.5, 0.5, np.deg2rad(30.0)])
_REACH = 2.0  # bins
_LOOKED = 5
# Cells of a grid below this share of the likeliest say nothing.
_LEAST = 1e-3


def heaviest(points: Array, weights: Array) -> Array:
    """The mean (3,) of the heaviest mode of weighted poses (n, 3).

    A mode is what lies within two bins of a bin's mean; the heaviest bins are looked at, since the
    edges of bins may divide one.
    """
    keys = np.floor(points / _BINS).astype(np.int64) @ [1, 10**4, 10**8]
    _, place = np.unique(keys, return_inverse=True)
    total = np.bincount(place, weights)
    best: Array = points[0]
    most = 0.0
    for one in np.argsort(total)[: -_LOOKED - 1 : -1]:
        if not total[one]:
            break  # the others, too, are of particles that weigh nothing
        inside = place == one
        centre = _mean(points[inside], weights[inside], points[inside][0])
        near = (np.abs(_away(points, centre)) < _REACH * _BINS).all(axis=1)
        if (weight := float(weights[near].sum())) > most:
            best, most = _mean(points[near], weights[near], centre), weight
    return best


def _mean(points: Array, weights: Array, about: Array) -> Array:
    found: Array = about + weights @ _away(points, about) / weights.sum()
    return found


def _away(points: Array, about: Array) -> Array:
    away = points - about
    away[:, 2] = wrap(away[:, 2])
    return away


def of_particles(belief: pgm.results.ParticleBelief) -> Array:
    """The estimates (runs, 3) of particles at a step."""
    each = (belief[k] for k in range(belief.lead[0]))
    return np.stack([heaviest(_poses(one.states), one.weights) for one in each])


def of_grid(belief: pgm.results.GridBelief) -> Array:
    """The estimate (3,) of a grid at a step."""
    values = belief.values
    cells = np.nonzero(values > _LEAST * values.max())
    points = np.stack([c[k] for c, k in zip(belief.centres, cells, strict=True)], axis=1)
    return heaviest(points, values[cells].astype(float))


def _poses(states: Array) -> Array:
    """Poses with headings in [−π, π)."""
    return np.column_stack([states[:, :2], wrap(states[:, 2])])


def off(estimates: Array, truth: Array) -> tuple[Array, Array]:
    """How far estimates (..., 3) are off, in place [m] and in heading [rad]."""
    away = estimates - truth
    return np.linalg.norm(away[..., :2], axis=-1), np.abs(wrap(away[..., 2]))


def right(estimates: Array, truth: Array) -> npt.NDArray[np.bool_]:
    """Whether estimates (..., 3) are right."""
    place, heading = off(estimates, truth)
    found: npt.NDArray[np.bool_] = (place < NEAR) & (heading < TURNED)
    return found


@dataclass(frozen=True)
class Share:
    """A share of runs, with Wilson's interval of 95 %.

    Attributes
    ----------
    value, low, high : float
    count, runs : int
    """

    value: float
    low: float
    high: float
    count: int
    runs: int

    @staticmethod
    def of(hits: npt.NDArray[np.bool_]) -> Share:
        """The share of runs that hit.

        E. B. Wilson, Probable inference, the law of succession, and statistical inference, 1927.
        """
        n, count, z = hits.size, int(hits.sum()), 1.959964
        p = count / n
        centre = (p + z * z / (2 * n)) / (1 + z * z / n)
        half = z / (1 + z * z / n) * np.sqrt(p * (1 - p) / n + z * z / (4 * n * n))
        low, high = float(centre - half), float(centre + half)
        # Rounding leaves no interval that the share is not in.
        return Share(p, max(min(low, p), 0.0), min(max(high, p), 1.0), count, n)

    @property
    def interval(self) -> str:
        """For a table."""
        return f"{self.low:.3f} to {self.high:.3f}"
