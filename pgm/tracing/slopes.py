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

# Values show slopes so far beside a point, in standard deviations.
_BESIDE = 1e-2
# Differences are taken over steps of these shares of a standard deviation.
_SCALES = 1e-2, 1e-4
# Of so many points in doubt the function is asked.
_ASKED = 64
# Slopes that are the same move a prediction by less, in its standard deviations; some are alike
# that differ by this share of an error and of themselves.
_OF_PREDICTION, _ALIKE = 1e-3, 0.1
# The rounding of a value is some units in its last place; coordinates are this many of theirs from
# each other, or no difference tells anything.
_ROUNDING, _APART = 1e-14, 1e5


def beside(x: Array, std: Array) -> Array:
    """Points (..., n) about 10⁻² deviations beside x (..., n), each component by another share.

    So no difference of components is the same there as at x, as it were with equal steps.
    """
    return x + _steps_beside(x, std)


def _steps_beside(x: Array, std: Array) -> Array:
    shares = 0.5 + np.modf(0.6180339887498949 * np.arange(1.0, x.size + 1.0))[0]
    found: Array = _BESIDE * shares.reshape(x.shape) * np.nan_to_num(std, posinf=0.0)
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
        self._least: list[float] = (_OF_PREDICTION * noise).tolist()

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
        """How far slopes are from those a step beside them on both sides, (k,).

        Of the slopes J₊ and J₋ beside J the largest of (|J − (J₊ + J₋)/2| − |J₊ − J₋|) σ, in
        standard deviations of the prediction; what is below zero is as a smooth function has it.
        """
        x = points.arguments[:, self.columns]
        step = _steps_beside(x, points.std)
        pair = np.repeat(points.arguments[None], 2, axis=0)
        pair[0][:, self.columns] += step
        pair[1][:, self.columns] -= step
        both = self.program.batch(self.apart(pair), pair.shape[:-1])[1]
        above, below = np.einsum("ijpk->pkij", both)
        return self._doubts(points.slope, above, below, points.std)

    def doubtful(self, components: Sequence[float], slope: Array, std: Array) -> bool:
        """Whether the slope (d, n) of one evaluation is in doubt, as `doubts` of many.

        `components` are those of all arguments side by side, `std` (n,) of the columns. Nearly all
        slopes are cleared in plain Python, a few numbers being too few for NumPy.
        """
        above, below, spread = list(components), list(components), std.tolist()
        for column, share, each in zip(self._places, self._shares, spread, strict=True):
            above[column] += share * each
            below[column] -= share * each
        over, under = self.program.numbers(above), self.program.numbers(below)
        if over is None or under is None:
            return False
        height, width = slope.shape
        k, every = height, slope.ravel().tolist()
        for least in self._least:
            for each in spread:
                one, other, here = over[k], under[k], every[k - height]
                off = abs(here - 0.5 * (one + other)) - abs(one - other)
                if off * each > least + 1e-9 * abs(here) * each:
                    near = np.reshape([over[height:], under[height:]], (2, height, width))
                    return bool(self._doubts(slope, near[0], near[1], std) > _OF_PREDICTION)
                k += 1
        return False

    def _doubts(self, slope: Array, above: Array, below: Array, std: Array) -> Array:
        with quiet():
            std = np.nan_to_num(std, posinf=0.0)[..., None, :]
            middle = 0.5 * (above + below)
            off = (np.abs(slope - middle) - np.abs(above - below)) * std
            unit = np.sqrt(((middle * std) ** 2).sum(axis=-1, keepdims=True)) + self._noise[:, None]
            found: Array = np.nan_to_num(off / np.where(unit > 0.0, unit, 1.0)).max(axis=(-2, -1))
            return found

    def misled(self, points: Points) -> str | None:
        """The `fault` of points in doubt, of 64 of them at the most; None where none is."""
        doubts = self.doubts(points)
        worst = np.argsort(doubts)[-_ASKED:]
        worst = worst[doubts[worst] > _OF_PREDICTION]
        return self.fault(points.at(worst)) if worst.size else None

    def fault(self, points: Points) -> str | None:
        """The words for a slope unlike the function's differences, if there is one.

        An entry (i, j) is wrong where it moves a prediction by too many of its deviations: of
        |J − D| σⱼ against Σ (D σ)² and the noise. The differences D, over a step, are believed
        where the trace's own slopes a step to either side are D, too: not at kinks, nor where a
        function bends within a step. Rounding of values, over a step, is no fault of the slope.
        """
        flat, x = points.arguments, points.arguments[:, self.columns]
        std = np.nan_to_num(points.std, posinf=0.0)
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
                pair = np.repeat(flat[:, None, None], 2, axis=1).repeat(len(columns), axis=2)
                pair[:, 0, columns, self.columns] += step
                pair[:, 1, columns, self.columns] -= step
                near = self.program.batch(self.apart(pair), pair.shape[:-1])[1]
                near = np.einsum("ijpsj->psij", near)  # by each column, a step along it
                error, own = np.abs(points.slope - due), std[:, None]
                doubt = np.abs(near - due[:, None]).max(axis=1)
                unit = np.sqrt(((due * own) ** 2).sum(axis=-1, keepdims=True))
                least = _OF_PREDICTION * (unit + self._noise[:, None])
                least = least + _ROUNDING * size * own / step[:, None]
                alike = np.maximum(_ALIKE * np.abs(due) * own, _ALIKE * least)
                wrong = (error * own > least) & told[:, None]
                wrong &= (doubt < _ALIKE * error) & (doubt * own < alike)
            if wrong.any():
                row, part, _ = (int(axis[0]) for axis in np.nonzero(wrong))
                return (
                    f"at {shown(flat[row])} the derivative of component {part} of its value is "
                    f"{shown(due[row, part])} by differences over {scale:g} standard deviations, "
                    f"{shown(points.slope[row, part])} by its trace: its formula cancels there, or "
                    "is of a branch much narrower than the belief"
                )
        return None


def shown(numbers: Array) -> str:
    """Numbers (k,) for a message."""
    return "[" + ", ".join(f"{number:.6g}" for number in numbers) + "]"
