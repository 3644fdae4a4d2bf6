"""Trajectories laid upon each other, and how far they are apart."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from pgm.boundary import is_number, is_whole
from pgm.display import NoArray, Shown, Summary, count, number
from pgm.errors import EvidenceError, ModelError
from pgm.immutable import Immutable
from pgm.io.stamped import clock
from pgm.kernels.arrays import Array, Integers, frozen

# Beneath this share of the largest, a singular value of places on a line is rounding.
_RANK = 1e-9


@dataclass(frozen=True, slots=True)
class Similarity:
    """The motion and scale y = s R x + t of places x (..., 3)."""

    scale: float
    rotation: Array
    shift: Array

    def moved(self, places: Array) -> Array:
        """Places (..., 3), moved."""
        found: Array = self.scale * places @ self.rotation.T + self.shift
        return found


def umeyama(source: Array, target: Array, *, scale: bool, planar: bool) -> Similarity:
    """The similarity that leads places x (n, 3) nearest to places y (n, 3), in squares.

    With means μ and the covariance Σ = Σₖ (yₖ − μ_y)(xₖ − μ_x)ᵀ / n = U D Vᵀ, and S = I, but for
    its last entry det U det V,

        R = U S Vᵀ,    s = tr(Rᵀ Σ) / σ_x²,    t = μ_y − s R μ_x;

    in the plane R is that of Σ's first two rows and columns.

    References
    ----------
    Umeyama, Least-squares estimation of transformation parameters between two point patterns, 1991.
    """
    size = 2 if planar else 3
    middle, goal = source.mean(axis=0), target.mean(axis=0)
    x, y = source - middle, target - goal
    u, d, vt = np.linalg.svd((y.T @ x / len(x))[:size, :size])
    if not d[size - 2] > _RANK * d[0] or not d[0] > 0.0:
        line = "on one place" if planar or not d[0] > 0.0 else "on one line"
        remedy = "" if planar else "; planar=True turns about the upward axis alone"
        raise ModelError(
            f"the places of one of the two trajectories lie {line}, and leave the turn between "
            f"them open{remedy}"
        )
    sign = np.ones(size)
    sign[-1] = np.sign(np.linalg.det(u) * np.linalg.det(vt))
    turn = np.eye(3)
    turn[:size, :size] = (u * sign) @ vt
    factor = float(np.sum(y * (x @ turn.T)) / np.sum(x**2)) if scale else 1.0
    return Similarity(factor, turn, goal - factor * turn @ middle)


def matched(times: Array, others: Array, tolerance: float) -> tuple[Integers, Integers]:
    """The rows of either of two trajectories whose times are nearest, within a tolerance [s].

    Each row is of one pair at most, the nearest of those that want it.
    """
    if not (is_number(tolerance) and tolerance >= 0.0):
        raise EvidenceError(f"tolerance= is a number of seconds, 0 or more, not {tolerance!r}")
    after = np.searchsorted(others, times).clip(1, max(len(others) - 1, 1))
    before = after - 1
    after = after.clip(0, len(others) - 1)
    near = np.where(np.abs(others[after] - times) < np.abs(times - others[before]), after, before)
    gap = np.abs(others[near] - times)
    order = np.lexsort([gap, near])
    first = np.append(True, np.diff(near[order]) > 0)
    rows = np.sort(order[first & (gap[order] <= tolerance)])
    if not rows.size:
        raise EvidenceError(
            f"no pose of {clock(times[0])} to {clock(times[-1])} is within {tolerance:g} s of one "
            f"of {clock(others[0])} to {clock(others[-1])}; are their clocks the same? tolerance= "
            "says how far apart stamps may be"
        )
    return rows, near[rows]


class PoseErrors(Shown, NoArray, Immutable):
    """How far the poses of a trajectory are from those of a reference.

    Attributes
    ----------
    kind : str
        Which errors they are, in words.
    times : ndarray
        (n,), seconds: of the poses that have one of the reference; of pairs of them, the later.
    translation : ndarray
        (n,), metres.
    rotation : ndarray
        (n,), radians, 0 to π: the angle of the turn between orientations.
    unmatched : int
        Poses that have none of the reference at their time, and count in nothing.

    Examples
    --------
    >>> times, still = np.arange(3.0), np.tile([0.0, 0.0, 0.0, 1.0], (3, 1))
    >>> path = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0]])
    >>> one, other = pgm.Poses(times, path, still), pgm.Poses(times, path + [0, 3, 4], still)
    >>> one.ate(other).rmse
    5.0
    """

    kind: str
    times: Array
    translation: Array
    rotation: Array
    unmatched: int

    _arrays: ClassVar[str] = ".translation and .rotation"

    def __init__(
        self, kind: str, times: Array, translation: Array, rotation: Array, unmatched: int
    ) -> None:
        self._set(
            kind=kind,
            times=frozen(times),
            translation=frozen(translation),
            rotation=frozen(rotation),
            unmatched=unmatched,
        )

    @property
    def rmse(self) -> float:
        """The root of the mean of squared translations [m]."""
        return float(np.sqrt(np.mean(self.translation**2)))

    @property
    def mean(self) -> float:
        """The mean translation [m]."""
        return float(np.mean(self.translation))

    @property
    def median(self) -> float:
        """The median translation [m]."""
        return float(np.median(self.translation))

    @property
    def max(self) -> float:
        """The largest translation [m]."""
        return float(np.max(self.translation))

    @property
    def _title(self) -> str:
        left = f", {self.unmatched} without one" if self.unmatched else ""
        return f"PoseErrors({self.kind}, {count(len(self.times), 'pose')}{left})"

    def _summary(self) -> Summary:
        turned = np.sqrt(np.mean(self.rotation**2))
        lines = [
            f"translation [m]: rmse {number(self.rmse, 4)}, mean {number(self.mean, 4)}, "
            f"median {number(self.median, 4)}, max {number(self.max, 4)}",
            f"rotation [rad]: rmse {number(float(turned), 4)}, "
            f"max {number(float(self.rotation.max()), 4)}",
        ]
        return Summary(self._title, lines)


def absolute(places: Sequence[Array], turns: Sequence[Array]) -> tuple[Array, Array]:
    """The distance and the angle between the poses of two trajectories, (n,) each."""
    from scipy.spatial.transform import Rotation

    one, other = (Rotation.from_quat(np.array(each)) for each in turns)
    length = np.linalg.norm(places[0] - places[1], axis=1)
    return length, np.asarray((other.inv() * one).magnitude())


def relative(places: Sequence[Array], turns: Sequence[Array], step: int) -> tuple[Array, Array]:
    """The distance and the angle of the motion between poses some rows apart, (n − step,) each.

    Of poses P and those of the reference Q, as rigid motions, the errors are those of

        (Q_k⁻¹ Q_{k+step})⁻¹ (P_k⁻¹ P_{k+step}).
    """
    from scipy.spatial.transform import Rotation

    moves = []
    for place, quaternions in zip(places, turns, strict=True):
        turn = Rotation.from_quat(np.array(quaternions))
        back = turn[:-step].inv()
        moves.append((back.apply(place[step:] - place[:-step]), back * turn[step:]))
    (shift, turn), (due, reference) = moves
    # A rotation leaves the length of the difference as it is.
    length = np.linalg.norm(shift - due, axis=1)
    return length, np.asarray((reference.inv() * turn).magnitude())


def require_step(step: object, rows: int) -> None:
    """Refuse a step of rows that is none, or longer than a trajectory."""
    if not is_whole(step) or not 0 < int(step) < rows:
        raise EvidenceError(
            f"step= is a number of rows, 1 to {rows - 1} of {count(rows, 'pose')}, not {step!r}"
        )
