"""A step of an online filter in machine code: from a belief and the evidence given to the next one.

A belief is one bytes object: the mean (n,), the covariance (n, n), and the log-evidence. Python
calls ``step(belief, values)``, in which `values` is the mapping from variables to their evidence.
The answer is the next belief; None where the evidence is of another kind than the step is made
for; and no bytes, ``b""``, where more care is needed: numbers are too far apart for float64, or
some are not finite.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import accumulate
from math import inf, prod
from typing import TYPE_CHECKING, Any

from pgm.kernels import step
from pgm.kernels.machine import told
from pgm.kernels.machine.code import Code
from pgm.kernels.machine.memory import Cells
from pgm.kernels.machine.module import Module
from pgm.kernels.machine.motion import predicted
from pgm.kernels.machine.numbers import Number
from pgm.kernels.machine.python import Python, written
from pgm.kernels.machine.reading import taken
from pgm.kernels.machine.wholes import Address, Whole
from pgm.kernels.machine.writer import Writer, arrays
from pgm.kernels.numbers import Matrix

if TYPE_CHECKING:
    from pgm.kernels.machine.compiled import Compiled

STEP = "step"
# What a step is bound to: the constants, the class of arrays, that of sightings, the names of what
# sightings have, and the variables in the order of the evidence.
CONSTANTS, ARRAYS, SIGHTINGS, VALUES, TIME, GIVEN, VARIABLES = range(7)
# As of `beliefs.is_moderate`, and of `last_places.of_step`, which tells what has lost digits.
_REGULAR, _FAR = 1.0 / 2e7, (2e-6 / 2.0**-52) ** 2


@dataclass(frozen=True)
class Evidence:
    """What is given of a variable: a row (d,), or the sightings of a sensor, (M, d).

    Attributes
    ----------
    array : told.Array
    missing : bool
        Whether components may be NaN.
    given : tuple of told.Array or None
        The parents that are given with sightings; None of a row.
    bounds : int or None
        Of sightings, the sensor's `told.Sensor.bounds`; None where there is to be one.
    """

    array: told.Array
    missing: bool
    given: tuple[told.Array, ...] | None = None
    bounds: int | None = None


@dataclass(frozen=True)
class Step:
    """A prediction, if it `moves`, or an update: its chain of one step, and what it is made from.

    `constants` are the arrays whose numbers the step is bound to, one after another.
    """

    chain: told.Forward
    moves: bool
    constants: tuple[told.Array, ...]
    evidence: tuple[Evidence, ...]


@lru_cache(maxsize=128)
def made(online: Step) -> Compiled:
    """The machine code of a step; see `python.bound`."""
    module = Module()
    written(module, STEP, 2, lambda python: _write(python, online))
    return module.compile()


def _write(python: Python, online: Step) -> None:
    code, chain = python.code, online.chain
    known, values = python.given
    size = chain.size
    count = size + size * size + 1
    table = _Table(code, chain)
    begin = python.bytes(known, 8 * count)
    table.put(chain.begin[0], begin)
    table.put(chain.begin[1], begin + size)
    _constants(python, online, table)
    finite = _evidence(python, online, table, values)
    later = python.call("PyBytes_FromStringAndSize", python.null, 8 * count)
    python.give_null_if(later.is_null())
    end = python.call("PyBytes_AsString", later)
    table.put(chain.known[0], end)
    table.put(chain.known[1], end + size)
    table.put(chain.density, end + (count - 1))

    w = Writer(code, table.address, chain)
    mean, cov = w.column(chain.begin[0]), w.symmetric(chain.begin[1])
    total, at = code.memory(begin).load(count - 1), code.whole(0)
    if online.moves:
        moved = predicted(w, chain, at, mean, cov)
        after, spread, sure = moved.mean, moved.cov, moved.sure
        cov = spread
    else:
        found = taken(w, chain, at, mean, cov)
        after, spread, sure = found.moments.mean, found.moments.cov, found.sure
        total = total + found.density
    sure = sure & finite & (abs(total) < inf) & _is_moderate(after, spread, cov)
    w.keep(chain.known[0], after)
    w.keep(chain.known[1], spread)
    w.keep(chain.density, Matrix.column([total]))
    with code.when(~sure):
        python.call("Py_DecRef", later, result=None)
        code.give(python.call("PyBytes_FromStringAndSize", python.null, 0))
    code.give(later)


class _Table:
    """The table of a chain (`told`), filled while code runs, in memory of the function's own."""

    def __init__(self, code: Code, chain: told.Forward) -> None:
        self._code = code
        size = 1 + max((array.place + told.CELL for array in arrays(chain)), default=0)
        size = max(size, *(1 + each.bounds for each in chain.sensors if each.bounds), told.FIRST)
        self.address = Address(code, code.reserve(f"[{size} x i64]"))
        self._wholes = Cells(code, self.address, Whole)
        self._addresses = Cells(code, self.address, Address)
        for place in range(told.FIRST):
            self._wholes.store(place, code.whole(int(place == told.RUNS)))

    def put(self, array: told.Array, address: Address, down: int = 0) -> None:
        """Tell where an array lies, whose cells are next to each other."""
        self.put_address(array.place, address)
        for what, distance in ((told.DOWN, down), (told.ACROSS, 0), (told.CELL, 1)):
            self._wholes.store(array.place + what, self._code.whole(distance))

    def put_address(self, place: int, address: Address) -> None:
        """Put an address into a place."""
        self._addresses.store(place, address)


def _constants(python: Python, online: Step, table: _Table) -> None:
    sizes = [prod(array.shape) for array in online.constants]
    *places, count = accumulate(sizes, initial=0)
    begin = python.bytes(python.mine(CONSTANTS), 8 * count)
    for array, place in zip(online.constants, places, strict=True):
        table.put(array, begin + place)


def _evidence(python: Python, online: Step, table: _Table, values: Address) -> Number:
    """Put the evidence given into the table; whether all of it is finite, or missing.

    The function ends with None where the evidence is of another kind.
    """
    code = python.code
    kind, variables = python.mine(ARRAYS), iter(range(VARIABLES, 10**9))
    finite: Any = code.constant(True)

    def of(variable: Address) -> None:
        python.give_none_unless(python.is_same(variable, python.mine(next(variables))))

    def row(value: Address, each: Evidence, array: told.Array, axes: int, like: Any = None) -> Any:
        address, shape = python.floats(value, kind, axes)
        (width,) = array.shape
        python.give_none_unless(shape[-1] == width)
        count: Any = shape[0] if axes == 2 else 1
        if like is not None:
            python.give_none_unless(count == like)
        table.put(array, address, width if axes == 2 else 0)
        nonlocal finite
        missing = each.missing and array is each.array
        finite = finite & _is_finite(code, address, width, count, missing=missing)
        return count

    for (variable, value), each in zip(
        python.items(values, len(online.evidence)), online.evidence, strict=True
    ):
        of(variable)
        if each.given is None:
            row(value, each, each.array, 1)
            continue
        python.give_none_unless(python.is_a(value, python.mine(SIGHTINGS)))
        time = python.attribute(value, python.mine(TIME))
        python.give_none_unless(python.is_same(time, code.address(id(None))))
        parents = python.attribute(value, python.mine(GIVEN))
        count = row(python.attribute(value, python.mine(VALUES)), each, each.array, 2)
        for (parent, its), array in zip(
            python.items(parents, len(each.given)), each.given, strict=True
        ):
            of(parent)
            row(its, each, array, 2, count)
        if each.bounds is None:
            python.give_none_unless(count == 1)
            continue
        bounds = Cells(code, Address(code, code.reserve("[2 x i64]")), Whole)
        bounds.store(0, code.whole(0))
        bounds.store(1, count)
        table.put_address(each.bounds, bounds.address)
    return finite  # type: ignore[no-any-return]


def _is_finite(
    code: Code, address: Address, width: int, count: Whole | int, *, missing: bool
) -> Number:
    """Whether rows of numbers are finite, or, where they may be `missing`, NaN."""
    found = code.variable(True)
    with code.loop(count) as at:
        cells = code.memory(address + at * width)
        for k in range(width):
            x = cells.load(k)
            fine = abs(x) < inf
            found.set(found.get() & (fine | (x != x) if missing else fine))
    return found.get()


def _is_moderate(mean: Matrix, cov: Matrix, before: Matrix) -> Number:
    """Whether float64 has digits enough for a belief after a step from a covariance."""
    found: Any = step.open_share(cov) > _REGULAR
    for (x,), variance, old in zip(mean.rows, cov.diagonal, before.diagonal, strict=True):
        found = found & (variance > _REGULAR * old) & (x * x < _FAR * variance)
    return found  # type: ignore[no-any-return]
