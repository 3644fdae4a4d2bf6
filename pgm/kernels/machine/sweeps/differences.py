"""Derivatives by differences of fourth order, between numbers in memory; see `kernels.differences`.

They are in functions that all CPDs of a module share: in the middle of a sweep they would be most
of its code.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from pgm.kernels import step
from pgm.kernels.machine.emitter.code import Code
from pgm.kernels.machine.emitter.kinds import ADDRESS, WHOLE
from pgm.kernels.machine.emitter.memory import Memory
from pgm.kernels.machine.emitter.passed import inside, lie, place
from pgm.kernels.numbers import least, most, sqrt, where

# As of `differences`: the least step, as a part of a deviation, in itself, and beside a number; and
# the multiples of a step at which a function is called.
_PART, _STEP, _BESIDE = 1e-2, 1e-4, 1e-9
_AROUND = 1.0, -1.0, 2.0, -2.0
# As of `gaussian.lengths`: a deviation given another component counts tenfold, and to a thousandth.
_TENFOLD, _LEAST = 10.0, 1e-3


def count(size: int) -> int:
    """How many points there are for so many components: the mean, and those about it."""
    return 1 + len(_AROUND) * size


def surround(points: Memory, size: int) -> None:
    """Write points about a mean behind it, in place of the covariance that stands there.

    The mean has so many components; each has its points, of steps that the covariance sets.
    """

    def write(code: Code, points: Memory) -> None:
        steps = _steps(code, points, points.moved(size), size)
        with code.loop((count(size) - 1) * size) as k:
            points.store(k + size, points.load(k % size))
        with code.loop(size) as j:
            number, due = points.load(j), steps.load(j)
            for point, multiple in enumerate(_AROUND, 1):
                points.store((j * len(_AROUND) + point) * size + j, number + multiple * due)

    _shared(f"surround {size}", write, points)


def slopes(
    points: Memory,
    values: Memory,
    value: Memory,
    slope: Memory,
    size: int,
    height: int,
    angles: Sequence[int],
) -> None:
    """Write a value (height,) and a derivative (height, size) from a function's values at points.

    `angles` are the components of the value that are angles.
    """

    def write(code: Code, points: Memory, values: Memory, value: Memory, slope: Memory) -> None:
        for i in range(height):
            value.store(i, values.load(i))
        with code.loop(size) as j:
            first = j * len(_AROUND) + 1
            taken = points.load(first * size + j) - points.load(j)
            for i in range(height):
                a, b, c, d = (values.load((first + k) * height + i) for k in range(4))
                near, far = a - b, c - d
                if i in angles:
                    near, far = near - step.turns(near), far - step.turns(far)
                slope.store(j + i * size, (8.0 * near - far) / (12.0 * taken))

    _shared(f"slopes {size} {height} {tuple(angles)}", write, points, values, value, slope)


def _shared(name: str, write: Any, *memories: Memory) -> None:
    """Call a function of the module's, which is written at its first call, with arrays' cells."""
    code = memories[0].code
    kinds = (ADDRESS, WHOLE, WHOLE) * len(memories)
    told = " ".join((name, *map(lie, memories)))
    helper = code.module.helper(told, kinds, code.lanes, None)
    if helper.fresh:
        given = helper.code.arguments
        cells = [
            inside(helper.code, like, *given[3 * k : 3 * k + 3]) for k, like in enumerate(memories)
        ]
        write(helper.code, *cells)
    code.call(helper.code, *(value for cells in memories for value in place(cells)))


def _steps(code: Code, mean: Memory, cov: Memory, size: int) -> Memory:
    """The steps of differences along each component, by the lengths of `gaussian.lengths`."""
    stds, units, steps = (code.room(size, name) for name in ("stds", "units", "steps"))
    with code.loop(size) as i:
        std = sqrt(most(cov.load(i * size + i), 0.0))
        stds.store(i, std)
        units.store(i, where(std > 0.0, std, 1.0))
    with code.loop(size) as i:
        std, number = stds.load(i), mean.load(i)
        shared = code.variable(0.0 * std)
        with code.loop(size) as j, code.when(i != j):
            correlation = cov.load(i * size + j) / units.load(i) / units.load(j)
            shared.set(most(shared.get(), correlation * correlation))
        left = _TENFOLD * sqrt(most(1.0 - shared.get(), 0.0))
        length = std * most(least(left, 1.0), _LEAST)
        due = most(most(_PART * length, code.constant(_STEP)), _BESIDE * abs(number))
        steps.store(i, (number + due) - number)
    return steps
