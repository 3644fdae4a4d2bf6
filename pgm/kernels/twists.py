"""Motions (forward, left, turn) in the plane: composed, inverted, and divided along their arcs.

A motion leads from a first pose (x, y, heading) to a second: forward and left are the place of the
second in the frame of the first, turn, in radians, is the difference of headings. In a *steady*
motion the body moves forward and to its left, and turns, at constant velocities; these times the
duration of the whole motion are its *twist* τ = (v, w, φ). After the share s of this time it has
made the motion

    [forward; left] = s sinc(s φ / 2) R(s φ / 2) [v; w],    turn = s φ,

where sinc a = sin a / a and R(a) is the rotation by the angle a.
"""

from __future__ import annotations

import numpy as np

from pgm.kernels.angles import TURN, wrap
from pgm.kernels.arrays import Array, Integers
from pgm.kernels.rigid import turned

# A steady motion of a whole turn ends where it began, so that none has another end; of a turn
# nearer to that the twist would be huge.
WHOLE = TURN * (1.0 - 1e-6)


def motions(twists: Array, share: Array | float = 1.0) -> Array:
    """The motions (..., 3) made after a share (...) of steady motions with twists (..., 3)."""
    half = 0.5 * share * twists[..., 2]
    chord = turned(twists[..., :2], half) * (share * _sinc(half))[..., None]
    return np.concatenate([chord, np.asarray(share * twists[..., 2])[..., None]], axis=-1)


def twists(steady: Array) -> Array:
    """The twists (..., 3) of steady motions (..., 3), which must turn by less than a whole turn.

    The caller is to refuse turns of 2π (1 − 10⁻⁶) or more either way: a steady motion of a whole
    turn ends where it began, so that near it the twist would be huge.
    """
    half = 0.5 * steady[..., 2]
    chord = turned(steady[..., :2], -half) / _sinc(half)[..., None]
    return np.concatenate([chord, steady[..., 2:]], axis=-1)


def composed(parts: Array, first: Integers) -> Array:
    """The motions (m, 3) that successive motions `parts` (n, 3) make together, in m groups.

    Group k is the rows from first[k] up to, but without, first[k + 1], or the end; first[0] is 0,
    and no group is empty.
    """
    after = np.cumsum(parts[:, 2])
    before = after - parts[:, 2]
    counts = np.diff(first, append=len(parts))
    facing = before - np.repeat(before[first], counts)
    steps = np.concatenate([turned(parts[:, :2], facing), parts[:, 2:]], axis=1)
    return np.add.reduceat(steps, first)


def path(start: Array, parts: Array) -> Array:
    """The poses (n + 1, 3) of a path from `start` (3,), along motions `parts` (n, 3) in turn.

    Headings are not wrapped.
    """
    headings = start[2] + np.concatenate([[0.0], np.cumsum(parts[:, 2])])
    steps = np.cumsum(turned(parts[:, :2], headings[:-1]), axis=0)
    return np.column_stack([np.concatenate([start[None, :2], start[:2] + steps]), headings])


def between(poses: Array) -> Array:
    """The motions (n − 1, 3) from each pose (n, 3) to the next, with turns in [−π, π)."""
    away = np.diff(poses, axis=0)
    return np.column_stack([turned(away[:, :2], -poses[:-1, 2]), wrap(away[:, 2])])


def inverse(motions: Array) -> tuple[Array, Array]:
    """The inverse motions (n, 3), and their Jacobians with respect to the motions, (n, 3, 3).

    Entry (k, i, j) is the derivative of component i of inverse k by component j of motion k.
    """
    ahead, left = turned(-motions[:, :2], -motions[:, 2]).T
    slope = np.zeros((len(motions), 3, 3))
    slope[:, 0, 0] = slope[:, 1, 1] = -np.cos(motions[:, 2])
    slope[:, 1, 0] = np.sin(motions[:, 2])
    slope[:, 0, 1] = -slope[:, 1, 0]
    slope[:, 0, 2], slope[:, 1, 2], slope[:, 2, 2] = left, -ahead, -1.0
    return np.column_stack([ahead, left, -motions[:, 2]]), slope


def _sinc(angle: Array) -> Array:
    """The values sin a / a of angles a, of any shape, in radians; one at zero."""
    found: Array = np.sinc(angle / np.pi)
    return found
