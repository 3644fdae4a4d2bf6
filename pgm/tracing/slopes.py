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
from itertools import accumulate
from typing import Any, NamedTuple

import numpy as np

from pgm.kernels import differences
from pgm.kernels.arrays import (
    Array,
    Integers,
    Mask,
    components_first,
    components_last,
    quiet,
)
from pgm.tracing.clearing import Clearing
from pgm.tracing.measures import (
    ALIKE,
    APART,
    ASKED,
    BESIDE,
    DOUBT,
    NEAR,
    OF_ITSELF,
    OF_NOISE,
    OF_PREDICTION,
    ROUNDING,
    SCALES,
    SIDES,
    UNTOLD,
    shares,
)
from pgm.tracing.program import Program

# The share of a deviation over which differences are taken, by an axis of points and one of moves.
_SCALES = np.array(SCALES)[:, None, None]


def beside(x: Array, std: Array) -> Array:
    """Points (..., n) about 10⁻² deviations beside x (..., n), each component by another share.

    So no difference of components is the same there as at x, as it were with equal steps.
    """
    return x + BESIDE * shares(x.shape) * _told(std)


def _told(std: Array) -> Array:
    """Standard deviations (..., n) to judge slopes by, all of them finite and above zero.

    They are zero of all components where a call linearises at points alone, as at a start, and of
    those under a flat prior; NaN where nobody has told them. All of these are taken to be 10⁻².
    """
    found: Array = np.where(np.isfinite(std) & (std > 0.0), std, UNTOLD)
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
        if len(parts) == 1:
            return parts[0]
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
        self.program, self.angles, self.noise = program, angles, noise
        self._call = function
        starts = [0, *accumulate(program.widths)]
        self._cuts = list(map(slice, starts, starts[1:]))
        self.columns = np.array([starts[a] + i for a, i in program.columns], dtype=np.intp)
        self._places: list[int] = self.columns.tolist()
        self.shares: list[float] = shares(self.columns.shape).tolist()
        self._clearing: dict[bool, Clearing] = {}
        self._least: list[float] = (OF_NOISE * noise).tolist()

    def clearing(self, trace: Program, *, differentiated: bool) -> Clearing | None:
        """The machine code that clears points; None where the trace is too long for that."""
        found = self._clearing.get(differentiated)
        if found is None:
            found = Clearing(trace, self, differentiated=differentiated)
            self._clearing[differentiated] = found
        return found if found.able else None

    def function(self, flat: Array) -> Array | None:
        """The function's value (..., d) at arguments side by side; None where it fails."""
        with quiet():
            try:
                return np.asarray(self._call(*self.apart(flat)), dtype=float)
            except Exception:  # whose error the call itself raises, without its trace
                return None

    def apart(self, flat: Array) -> list[Array]:
        """The arguments (..., width) each, of those side by side (..., widths)."""
        return [flat[..., cut] for cut in self._cuts]

    def functions(self, parts: Sequence[Array]) -> list[Array | None]:
        """The function's values (..., d) at parts of points (..., widths), by a single call.

        Where that fails each part is asked for by itself; None is of a part that fails.
        """
        flat = [part.reshape(-1, part.shape[-1]) for part in parts]
        ends = list(accumulate(map(len, flat)))
        found = self.function(np.concatenate(flat)) if len(parts) > 1 else None
        values: list[Array | None] = [None] * len(parts)
        if found is not None and found.ndim == 2 and len(found) == ends[-1]:
            values[:] = np.split(found, ends[:-1])
        else:
            values = [self.function(each) for each in flat]
        return [
            None
            if value is None or value.ndim != 2 or len(value) != part[..., 0].size
            else value.reshape(*part.shape[:-1], value.shape[-1])
            for value, part in zip(values, parts, strict=True)
        ]

    def doubts(self, points: Points) -> Array:
        """How far slopes are from those beside them on both sides, at either distance, (k, d, n).

        Of the slopes J₊ and J₋ a step beside J it is (|J − (J₊ + J₋)/2| − |J₊ − J₋|) σ, as a share
        of the noise and of |J₊ + J₋| σ / 2; what is below zero is as a smooth function has it.
        """
        std, x = _told(points.std), points.arguments[:, self.columns]
        own_shares = shares(x.shape) * std
        signs = np.array([near * sign ** np.arange(x.shape[-1]) for near, sign in NEAR])
        step = signs[:, None] * own_shares  # of either distance, (2, k, n)
        sides = np.broadcast_to(points.arguments, (2, len(NEAR), *points.arguments.shape)).copy()
        sides[..., self.columns] += np.array([1.0, -1.0])[:, None, None, None] * step
        slopes = self.program.batch(self.apart(sides), sides.shape[:-1])[1]
        above, below = slopes[:, :, 0], slopes[:, :, 1]  # (d, n, 2, k)
        here, own = components_first(points.slope, 2)[:, :, None], std.T[None, :, None]
        with quiet():
            middle = 0.5 * (above + below)
            off = (np.abs(here - middle) - np.abs(above - below)) * own
            unit = np.abs(middle) * own + self.noise[:, None, None, None]
            doubt = np.nan_to_num(off / np.where(unit > 0.0, unit, 1.0))
        return components_last(doubt.max(axis=2, initial=0.0), 2)

    def doubtful(self, components: Sequence[float], slope: Array, std: Array) -> bool:
        """Whether the slope (d, n) of one evaluation may be in doubt, as `doubts` of many.

        `components` are those of all arguments side by side, `std` (n,) of the columns. Nearly all
        slopes are cleared in plain Python, a few numbers being too few for NumPy.
        """
        spread = [each if 0.0 < each < math.inf else UNTOLD for each in std.tolist()]
        here = slope.ravel().tolist()
        return any(self._is_apart(*near, components, here, spread) for near in NEAR)

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
        for column, share, each in zip(self._places, self.shares, spread, strict=True):
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
        """The words for a slope unlike the function's differences, if there is one."""
        differed = self.differed(points)
        return differed.fault(self.function(differed.points))

    def differed(self, points: Points) -> Differed:
        """Points about some, at which the function is to be asked for its differences."""
        return Differed(self, points)


class Differed:
    """The slopes of some points, held against differences of the function.

    They are compared along each component, and along all at once: a branch may hold as long as
    either of two components is small. Along a move of v (n,) standard deviations the slope is
    J diag(σ) v = s. It is wrong if |s − D| is more than a thousandth of it, and of the noise. The
    differences D, over a step, are believed where the trace's own slopes one and 1.6 steps to
    either side are alike, and D their mean: not at kinks, nor where a function bends within a step.
    Rounding of values, over a step, is no fault of the slope.

    Attributes
    ----------
    points : ndarray
        (scales, k, moves, 4, widths): at steps of each scale, of k points, along each move.
    """

    points: Array

    def __init__(self, slopes: Slopes, at: Points) -> None:
        self._slopes, self._at = slopes, at
        std, x = _told(at.std), at.arguments[:, slopes.columns]
        directions = np.eye(len(slopes.columns))
        if len(directions) > 1:
            directions = np.concatenate([directions, [slopes.shares]])
        steps = _SCALES * std
        steps = np.where(steps >= APART * np.spacing(np.abs(x)), steps, 0.0)
        # Along each direction, (scales, k, moves, n).
        self._moves = differences.taken(x[:, None], directions * steps[:, :, None])
        around = differences.around(x[:, None], self._moves)
        self.points = self._wide(around)

    def _wide(self, moved: Array) -> Array:
        """Points (scales, k, ..., widths) whose columns are `moved`, (scales, k, ..., n)."""
        flat = self._at.arguments
        flat = flat.reshape(len(flat), *(1,) * (moved.ndim - 3), -1)
        wide = np.broadcast_to(flat, (*moved.shape[:-1], flat.shape[-1])).copy()
        wide[..., self._slopes.columns] = moved
        return wide

    def fault(self, values: Array | None) -> str | None:
        """The words for a wrong slope, by the function's values at `points`, (..., 4, d).

        Values are None where the function fails there, which is no fault of a slope.
        """
        if values is None:
            return None
        slopes, at, moves = self._slopes, self._at, self._moves
        scales = _SCALES[..., None]
        with quiet():
            due = differences.change(values[..., : len(slopes.angles)], slopes.angles)
            due /= 12.0 * scales
            told = at.slope @ moves.swapaxes(-1, -2) / scales
            error = np.abs(told - due)
            size = np.sqrt((due**2).sum(axis=-1, keepdims=True))
            least = np.maximum(OF_NOISE * slopes.noise[:, None], OF_PREDICTION * size)
            least = least + ROUNDING * np.abs(at.value[:, : len(slopes.angles), None]) / scales
            wrong = (error > least) & (error > OF_ITSELF * np.maximum(np.abs(due), np.abs(told)))
            wrong &= (moves != 0.0).any(axis=-1)[:, :, None]
            if wrong.any():
                least = np.broadcast_to(least, wrong.shape)[wrong]
                wrong[wrong] = self._sure(wrong, due[wrong], error[wrong], least)
        if not wrong.any():
            return None
        scale, row, part, k = where = tuple(int(axis[0]) for axis in np.nonzero(wrong))
        move, share = moves[scale, row, k], float(_SCALES[scale, 0, 0])
        unit = np.abs(move).max() / share
        return (
            f"at {shown(at.arguments[row])} the derivative of component {part} of its value, along "
            f"{shown(move / np.abs(move).max())}, is {due[where] / unit:.6g} by differences over "
            f"{share:g} standard deviations, {told[where] / unit:.6g} by its trace: its formula "
            "cancels there, or is of a branch much narrower than the belief"
        )

    def _sure(self, places: Mask, due: Array, error: Array, least: Array) -> Mask:
        """Whether the trace's slopes to both sides show that differences are right.

        `places` (scales, k, d, moves) marks c slopes; the other arguments, and the result, are
        (c,).
        """
        scale, row, part, k = np.nonzero(places)
        slopes, move = self._slopes, self._moves[scale, row, k]
        sides = np.repeat(self._at.arguments[row, None], len(SIDES), axis=1)
        sides[..., slopes.columns] += np.array(SIDES)[:, None] * move[:, None]
        steep = slopes.program.batch(slopes.apart(sides), sides.shape[:-1])[1]
        steep = np.moveaxis(steep, 2, 0)[np.arange(len(part)), part]  # (c, n, sides)
        near = (move[:, None] @ steep)[:, 0] / _SCALES[scale, 0]
        found: Mask = np.abs(near - due[:, None]).max(axis=1) < ALIKE * error
        mean = near.mean(axis=1)
        found &= np.abs(mean - due) < ALIKE * np.maximum(np.abs(due), least)
        return found


def choice(doubts: Array) -> Integers:
    """The places of the points most in doubt, of each entry some, from doubts (k, d, n)."""
    count, height, width = doubts.shape
    if not (doubts > DOUBT).any():
        return np.empty(0, dtype=np.intp)
    most = min(max(ASKED // (height * width), 1), count)
    flat = doubts.reshape(count, -1)
    worst = np.argpartition(flat, count - most, axis=0)[count - most :]
    doubtful = np.take_along_axis(flat, worst, axis=0) > DOUBT
    found: Integers = np.unique(worst[doubtful])
    return found


def shown(numbers: Array) -> str:
    """Numbers (k,) for a message."""
    return "[" + ", ".join(f"{number:.6g}" for number in numbers) + "]"
