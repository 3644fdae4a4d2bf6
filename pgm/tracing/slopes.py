"""Derivatives of a trace, held against the function itself.

A trace's derivative is that of the code, and yet wrong for a belief in two cases, both common near
a removable singularity, such as a turn rate ω of zero in (sin(h + ω) − sin h)/ω. The formula's
derivative cancels there; and a branch that stands in for it, often a constant beside it, |ω| < 10⁻⁴
say, has lost what the value depends on. Either shows in the trace alone: its derivatives a step to
both sides agree with one another and not with that in the middle. There the derivative is compared
with differences of the function. Steps are hundredths of a standard deviation, so that the
derivative of a function that bends within its belief stays what it is, and much smaller ones,
in case that it bends within a hundredth, too: as a function of the difference of two components
does whose own deviations are a thousand times that of the difference.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from pgm.kernels import differences
from pgm.kernels.arrays import Array, Integers, Mask, components_last, quiet
from pgm.tracing.program import Program

# Values show slopes so far beside a point, in standard deviations; where nobody has told these they
# are taken to be so large.
_BESIDE, _UNTOLD = 1e-2, 1e-2
# Slopes are compared with those beside them over steps of about these shares of a deviation: of
# all components at once, with the same sign, and with signs by turns, lest the steps cancel.
_NEAR = ((1e-2, 1.0), (1e-5, -1.0))
# Differences are taken over steps of these shares of a standard deviation, and the trace's slopes
# looked at so many steps away: at two distances, lest a function that swings be taken for straight.
_SCALES, _SIDES = (1e-2, 1e-4, 1e-6), (1.0, -1.0, 1.6, -1.6)
# The function is asked for about so many entries of slopes in doubt.
_ASKED = 256
# Slopes that are the same differ by less: shares of themselves; of the noise and of the prediction,
# when they move it. Some are alike that differ by a share of an error, and of themselves.
_OF_ITSELF, _OF_NOISE, _OF_PREDICTION, _ALIKE = 1e-3, 1e-3, 1e-9, 0.1
# Slopes are in doubt from so much on.
_DOUBT = 1e-3
# The rounding of a value is some units in its last place; a step is at least so many of those of
# its component, or no difference tells anything.
_ROUNDING, _APART = 1e-14, 1e3


def beside(x: Array, std: Array) -> Array:
    """Points (..., n) about 10⁻² deviations beside x (..., n), each component by another share.

    So no difference of components is the same there as at x, as it were with equal steps.
    """
    return x + _BESIDE * _shares(x.shape) * _told(std)


def _shares(shape: tuple[int, ...]) -> Array:
    """Numbers between 0.5 and 1.5, each another, by turns of φ."""
    numbers = np.arange(1.0, math.prod(shape) + 1.0)
    found: Array = 0.5 + np.modf(0.6180339887498949 * numbers)[0].reshape(shape)
    return found


def _told(std: Array) -> Array:
    """Standard deviations (..., n) to judge slopes by, all of them finite and above zero.

    They are zero of all components where a call linearises at points alone, as at a start, and of
    those under a flat prior; NaN where nobody has told them. All of these are taken to be 10⁻².
    """
    found: Array = np.where(np.isfinite(std) & (std > 0.0), std, _UNTOLD)
    return found


class Points(NamedTuple):
    """Points at which a trace was evaluated: arguments (k, widths), value (k, d), slope (k, d, n).

    `std` (k, n) are the standard deviations of the beliefs there, NaN where nobody has told them.
    """

    arguments: Array
    value: Array
    slope: Array
    std: Array

    def at(self, rows: Integers | slice) -> Points:
        """Some of the points."""
        return Points(*(part[rows] for part in self))

    @classmethod
    def joined(cls, parts: Sequence[Points]) -> Points:
        """The points of several parts, one after another."""
        return cls(*(np.concatenate(each) for each in zip(*parts, strict=True)))

    @classmethod
    def of_batch(
        cls,
        shape: tuple[int, ...],
        arguments: Sequence[Array],
        value: Array,
        slope: Array,
        std: Array | None,
        chosen: slice = slice(None),
    ) -> Points:
        """Copies of some points of a batch, one after another.

        Arguments (*shape, width), value (d, *shape) and slope (d, n, *shape) are those of
        `Program.batch`, `std` (*lead, n) is of leading axes of the shape.
        """
        count, (height, width) = math.prod(shape), slope.shape[:2]
        told = components_last(value.reshape(height, count)[:, chosen], 1).copy()
        steep = components_last(slope.reshape(height, width, count)[..., chosen], 2).copy()
        flat = [np.broadcast_to(a, (*shape, a.shape[-1])) for a in arguments]
        spread = np.full((len(told), width), np.nan)
        if std is not None:
            own = std.reshape(*std.shape[:-1], *(1,) * (len(shape) + 1 - std.ndim), width)
            spread = np.broadcast_to(own, (*shape, width)).reshape(count, width)[chosen]
        columns = [each.reshape(count, each.shape[-1])[chosen] for each in flat]
        return cls(np.concatenate(columns, axis=-1), told, steep, spread)


class Slopes:
    """The derivatives of one trace.

    Parameters
    ----------
    function : callable
        The traced function, of the arguments.
    program : Program
        Its value, or the first components of that, with the derivative by some columns.
    angles : ndarray
        Which components of the program's value are angles, (d,).
    noise : ndarray
        The least standard deviations of their noise, (d,).
    """

    def __init__(
        self, function: Callable[..., Any], program: Program, angles: Mask, noise: Array
    ) -> None:
        self.program, self._angles, self._noise = program, angles, noise
        self._call = function
        starts = np.cumsum([0, *program.widths])
        self._cuts = starts[1:-1]
        self.columns = np.array([starts[a] + i for a, i in program.columns], dtype=np.intp)
        self._places: list[int] = self.columns.tolist()
        self._shares: list[float] = _shares(self.columns.shape).tolist()
        self._least: list[float] = (_OF_NOISE * noise).tolist()

    def function(self, flat: Array) -> Array | None:
        """The function's value (..., d) at arguments side by side; None where it fails."""
        with quiet():
            try:
                return np.asarray(self._call(*self.apart(flat)), dtype=float)
            except Exception:  # whose error the call itself raises, without its trace
                return None

    def apart(self, flat: Array) -> list[Array]:
        """The arguments (..., width) each, of those side by side (..., widths)."""
        return np.split(flat, self._cuts, axis=-1)

    def doubts(self, points: Points) -> Array:
        """How far slopes are from those beside them on both sides, at either distance, (k, d, n).

        Of the slopes J₊ and J₋ a step beside J it is (|J − (J₊ + J₋)/2| − |J₊ − J₋|) σ, as a share
        of the noise and of |J₊ + J₋| σ / 2; what is below zero is as a smooth function has it.
        """
        std, x = _told(points.std), points.arguments[:, self.columns]
        own, shares = std[:, None, :], _shares(x.shape)
        sides = np.repeat(points.arguments[None], 2 * len(_NEAR), axis=0)
        for k, (near, sign) in enumerate(_NEAR):
            step = near * sign ** np.arange(x.shape[-1]) * shares * std
            sides[2 * k][:, self.columns] += step
            sides[2 * k + 1][:, self.columns] -= step
        slopes = self.program.batch(self.apart(sides), sides.shape[:-1])[1]
        slopes = np.einsum("ijpk->pkij", slopes)
        found = np.zeros(points.slope.shape)
        with quiet():
            for above, below in zip(slopes[::2], slopes[1::2], strict=True):
                middle = 0.5 * (above + below)
                off = (np.abs(points.slope - middle) - np.abs(above - below)) * own
                unit = np.abs(middle) * own + self._noise[:, None]
                doubt = off / np.where(unit > 0.0, unit, 1.0)
                found = np.maximum(found, np.nan_to_num(doubt))
        return found

    def doubtful(self, components: Sequence[float], slope: Array, std: Array) -> bool:
        """Whether the slope (d, n) of one evaluation may be in doubt, as `doubts` of many.

        `components` are those of all arguments side by side, `std` (n,) of the columns. Nearly all
        slopes are cleared in plain Python, a few numbers being too few for NumPy.
        """
        spread = [each if 0.0 < each < math.inf else _UNTOLD for each in std.tolist()]
        here = slope.ravel().tolist()
        return any(self._is_apart(*near, components, here, spread) for near in _NEAR)

    def _is_apart(
        self,
        near: float,
        sign: float,
        components: Sequence[float],
        slope: list[float],
        spread: list[float],
    ) -> bool:
        """Whether a slope (d n,), row by row, is unlike those about `near` deviations beside it.

        `components` and `spread` are as in `doubtful`; the step changes by the `sign` from one
        component to the next.
        """
        above, below = list(components), list(components)
        for column, share, each in zip(self._places, self._shares, spread, strict=True):
            step = near * share * each
            above[column] += step
            below[column] -= step
            near *= sign
        over, under = self.program.numbers(above), self.program.numbers(below)
        if over is None or under is None:
            return True
        height = len(self._least)
        sides = zip(slope, over[height:], under[height:], strict=True)
        for least in self._least:
            for each in spread:
                here, one, other = next(sides)
                off = abs(here - 0.5 * (one + other)) - abs(one - other)
                if not off * each <= least + 1e-9 * abs(here) * each:
                    return True
        return False

    def misled(self, points: Points) -> str | None:
        """The `fault` of the points in doubt; None where none is."""
        chosen = choice(self.doubts(points))
        return self.fault(points.at(chosen)) if chosen.size else None

    def fault(self, points: Points) -> str | None:
        """The words for a slope unlike the function's differences, if there is one.

        They are compared along each component, and along all at once: a branch may hold as long as
        either of two components is small. Along a move of v (n,) standard deviations the slope is
        J diag(σ) v = s. It is wrong if |s − D| is more than a thousandth of it, and of the noise.
        The differences D, over a step, are believed where the trace's own slopes one and 1.6 steps
        to either side are alike, and D their mean: not at kinks, nor where a function bends within
        a step. Rounding of values, over a step, is no fault of the slope.
        """
        std, x = _told(points.std), points.arguments[:, self.columns]
        directions = np.eye(len(self.columns))
        if len(directions) > 1:
            directions = np.concatenate([directions, [self._shares]])
        for scale in _SCALES:
            steps = np.where(scale * std >= _APART * np.spacing(np.abs(x)), scale * std, 0.0)
            moves = differences.taken(x[:, None], directions * steps[:, None])
            found = self._fault_along(points, moves, scale, std)
            if found is not None:
                row, part, k, due, slope = found
                return (
                    f"at {shown(points.arguments[row])} the derivative of component {part} of its "
                    f"value, along {shown(moves[row, k] / np.abs(moves[row, k]).max())}, is "
                    f"{due:.6g} by differences over {scale:g} standard deviations, {slope:.6g} by "
                    "its trace: its formula cancels there, or is of a branch much narrower than "
                    "the belief"
                )
        return None

    def _fault_along(
        self, points: Points, moves: Array, scale: float, std: Array
    ) -> tuple[int, int, int, float, float] | None:
        """The first wrong slope along moves (k, m, n), of steps of a scale; see `fault`.

        Returns
        -------
        tuple or None
            The point, the component of the value, the move, and the derivatives along it, per unit
            of its longest component: that due, by differences, and that of the trace.
        """
        flat, x = points.arguments, points.arguments[:, self.columns]
        count = len(self._angles)

        def along(moved: Array) -> Array:
            wide = np.repeat(flat[:, None], moved.shape[1], axis=1)
            wide[..., self.columns] = moved
            due = self.function(wide)
            if due is None:
                return np.full((*moved.shape[:-1], count), np.nan)
            return due[..., :count]

        with quiet():
            due = differences.along(along, x, moves, self._angles) / (12.0 * scale)
            told = np.einsum("kij,kmj->kim", points.slope, moves) / scale
            sides = np.repeat(flat[:, None, None], len(_SIDES), axis=1).repeat(moves.shape[1], 2)
            for k, side in enumerate(_SIDES):
                sides[:, k][..., self.columns] += side * moves
            near = self.program.batch(self.apart(sides), sides.shape[:-1])[1]
            near = np.einsum("ijpsm,pmj->psim", near, moves) / scale
            error, doubt = np.abs(told - due), np.abs(near - due[:, None]).max(axis=1)
            unit = np.sqrt((due**2).sum(axis=-1, keepdims=True))
            least = np.maximum(_OF_NOISE * self._noise[:, None], _OF_PREDICTION * unit)
            least = least + _ROUNDING * np.abs(points.value[:, :count, None]) / scale
            wrong = (error > least) & (error > _OF_ITSELF * np.maximum(np.abs(due), np.abs(told)))
            wrong &= doubt < _ALIKE * error
            wrong &= np.abs(near.mean(axis=1) - due) < _ALIKE * np.maximum(np.abs(due), least)
            wrong &= (moves != 0.0).any(axis=-1)[:, None]
        if not wrong.any():
            return None
        row, part, k = (int(axis[0]) for axis in np.nonzero(wrong))
        unit = np.abs(moves[row, k]).max() / scale
        return row, part, k, due[row, part, k] / unit, told[row, part, k] / unit


def choice(doubts: Array) -> Integers:
    """The places of the points most in doubt, of each entry some, from doubts (k, d, n)."""
    count, height, width = doubts.shape
    most = min(max(_ASKED // (height * width), 1), count)
    flat = doubts.reshape(count, -1)
    worst = np.argpartition(flat, count - most, axis=0)[count - most :]
    doubtful = np.take_along_axis(flat, worst, axis=0) > _DOUBT
    found: Integers = np.unique(worst[doubtful])
    return found


def shown(numbers: Array) -> str:
    """Numbers (k,) for a message."""
    return "[" + ", ".join(f"{number:.6g}" for number in numbers) + "]"
