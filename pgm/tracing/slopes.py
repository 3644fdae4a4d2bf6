"""Derivatives of a trace, held against the function itself.

A trace's derivative is that of the code, and yet wrong for a belief in two cases, both common near
a removable singularity, such as a turn rate ω of zero in (sin(h + ω) − sin h)/ω. The formula's
derivative cancels there; and a branch that stands in for it, often a constant beside it, |ω| < 10⁻⁴
say, has lost what the value depends on. Either shows in the trace alone: its derivatives a step to
both sides agree with one another and not with that in the middle. There the derivative is compared
with differences of the function, over steps of some hundredths and ten thousandths of a standard
deviation, so that the derivative of a function that bends within its belief stays what it is.
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
# Differences are taken over steps of these shares of a standard deviation, and the trace's slopes
# looked at so many steps away: at two distances, lest a function that swings be taken for straight.
_SCALES, _SIDES = (1e-2, 1e-4), (1.0, -1.0, 1.6, -1.6)
# The function is asked for about so many entries of slopes in doubt.
_ASKED = 256
# Slopes that are the same differ by less: shares of themselves; of the noise and of the prediction,
# when they move it. Some are alike that differ by a share of an error, and of themselves.
_OF_ITSELF, _OF_NOISE, _OF_PREDICTION, _ALIKE = 1e-3, 1e-3, 1e-9, 0.1
# Slopes are in doubt from so much on.
_DOUBT = 1e-3
# The rounding of a value is some units in its last place; coordinates are this many of theirs from
# each other, or no difference tells anything.
_ROUNDING, _APART = 1e-14, 1e5


def beside(x: Array, std: Array) -> Array:
    """Points (..., n) about 10⁻² deviations beside x (..., n), each component by another share.

    So no difference of components is the same there as at x, as it were with equal steps.
    """
    return x + _steps_beside(x, _told(std))


def _steps_beside(x: Array, std: Array) -> Array:
    """Steps (..., n) of about 10⁻² standard deviations, each another share, by turns of φ."""
    shares = 0.5 + np.modf(0.6180339887498949 * np.arange(1.0, x.size + 1.0))[0]
    found: Array = _BESIDE * shares.reshape(x.shape) * std
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
        ones = np.ones(len(self.columns))
        self._places: list[int] = self.columns.tolist()
        self._shares: list[float] = _steps_beside(ones, ones).tolist()
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
        """How far slopes are from those a step beside them on both sides, (k, d, n).

        Of the slopes J₊ and J₋ beside J it is (|J − (J₊ + J₋)/2| − |J₊ − J₋|) σ, as a share of the
        noise and of |J₊ + J₋| σ / 2; what is below zero is as a smooth function has it.
        """
        std, x = _told(points.std), points.arguments[:, self.columns]
        step = _steps_beside(x, std)
        pair = np.repeat(points.arguments[None], 2, axis=0)
        pair[0][:, self.columns] += step
        pair[1][:, self.columns] -= step
        both = self.program.batch(self.apart(pair), pair.shape[:-1])[1]
        above, below = np.einsum("ijpk->pkij", both)
        with quiet():
            own = std[:, None, :]
            middle = 0.5 * (above + below)
            off = (np.abs(points.slope - middle) - np.abs(above - below)) * own
            unit = np.abs(middle) * own + self._noise[:, None]
            found: Array = np.nan_to_num(off / np.where(unit > 0.0, unit, 1.0))
            return found

    def doubtful(self, components: Sequence[float], slope: Array, std: Array) -> bool:
        """Whether the slope (d, n) of one evaluation may be in doubt, as `doubts` of many.

        `components` are those of all arguments side by side, `std` (n,) of the columns. Nearly all
        slopes are cleared in plain Python, a few numbers being too few for NumPy.
        """
        above, below = list(components), list(components)
        spread = [each if 0.0 < each < math.inf else _UNTOLD for each in std.tolist()]
        for column, share, each in zip(self._places, self._shares, spread, strict=True):
            above[column] += share * each
            below[column] -= share * each
        over, under = self.program.numbers(above), self.program.numbers(below)
        if over is None or under is None:
            return True
        height = len(slope)
        sides = zip(slope.ravel().tolist(), over[height:], under[height:], strict=True)
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

        An entry (i, j) is wrong if |J − D| is more than a thousandth of it, and of the noise when
        multiplied by σⱼ. The differences D, over a step, are believed where the trace's own slopes
        one and 1.6 steps to either side are alike, and D their mean: not at kinks, nor where a
        function bends within a step. Rounding of values, over a step, is no fault of the slope.
        """
        flat, x = points.arguments, points.arguments[:, self.columns]
        std = _told(points.std)
        told = std >= _APART * np.spacing(np.abs(x))  # elsewhere steps are no numbers
        count, columns = len(self._angles), np.arange(len(self.columns))

        def along(moved: Array) -> Array:
            wide = np.repeat(flat[:, None], moved.shape[1], axis=1)
            wide[..., self.columns] = moved
            due = self.function(wide)
            if due is None:
                return np.full((*moved.shape[:-1], count), np.nan)
            return due[..., :count]

        size = np.abs(points.value[:, :count, None])
        for scale in _SCALES:
            step = np.where(told, scale * std, np.finfo(float).tiny)
            with quiet():
                due = np.where(told[:, None], differences.over(along, x, step, self._angles), 0.0)
                sides = np.repeat(flat[:, None, None], len(_SIDES), axis=1)
                sides = sides.repeat(len(columns), axis=2)
                for k, side in enumerate(_SIDES):
                    sides[:, k, columns, self.columns] += side * step
                near = self.program.batch(self.apart(sides), sides.shape[:-1])[1]
                near = np.einsum("ijpsj->psij", near)  # by each column, a step along it
                error, own = np.abs(points.slope - due), std[:, None]
                doubt = np.abs(near - due[:, None]).max(axis=1)
                apart = np.abs(near.mean(axis=1) - due) * own
                unit = np.sqrt(((due * own) ** 2).sum(axis=-1, keepdims=True))
                least = np.maximum(_OF_NOISE * self._noise[:, None], _OF_PREDICTION * unit)
                least = least + _ROUNDING * size * own / step[:, None]
                itself = np.maximum(np.abs(due), np.abs(points.slope))
                wrong = (error * own > least) & (error > _OF_ITSELF * itself) & told[:, None]
                wrong &= doubt < _ALIKE * error
                wrong &= apart < _ALIKE * np.maximum(np.abs(due) * own, least)
            if wrong.any():
                row, part, _ = (int(axis[0]) for axis in np.nonzero(wrong))
                return (
                    f"at {shown(flat[row])} the derivative of component {part} of its value is "
                    f"{shown(due[row, part])} by differences over {scale:g} standard deviations, "
                    f"{shown(points.slope[row, part])} by its trace: its formula cancels there, or "
                    "is of a branch much narrower than the belief"
                )
        return None


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
