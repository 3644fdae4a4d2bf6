"""A step of an online filter in machine code: from a belief and the evidence given to the next one.

Python calls ``step(belief, values)``, in which `values` maps variables to their evidence, and may
be None where a prediction has no inputs. The answer is the next belief; it is made here, too, since
in Python that takes longer than its numbers do. It is None where the belief is of another filter,
the evidence of another kind than the step is made for, or more care is needed, because numbers are
too far apart for float64, or some are not finite.

The numbers of a belief are one bytes object: the mean (n,), the covariance (n, n), the
log-evidence, and with a watch its numbers (`lost`). Behind them an update puts 1 if weights of
robust noise are not settled, else 0, if there is any; the record of its iterations, if there are
any (`settling`); of each sensor with a gate the number M of sightings, their squares (M,), and 1 of
each that is rejected, else 0 (M,); and of each with robust noise the weights (M,) and the squares
that these are of (M,). A prediction that is to be reversed puts its linearisations there: see
`kept`. The belief has its numbers in a slot, and others for the filter's steps, the number of the
step, the kind of belief, how records are read, and whatever is kept of the steps behind it, which
is handed on (`evidence.Slots`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import accumulate
from math import inf, prod
from operator import and_
from typing import TYPE_CHECKING, Any

from pgm.kernels.machine.emitter.code import Code
from pgm.kernels.machine.emitter.kinds import WHOLE
from pgm.kernels.machine.emitter.module import Module
from pgm.kernels.machine.emitter.python import Python, written
from pgm.kernels.machine.emitter.wholes import Address
from pgm.kernels.machine.matrices.in_memory.frame import Frame
from pgm.kernels.machine.matrices.lines import Lines
from pgm.kernels.machine.matrices.loops import Loops
from pgm.kernels.machine.sweeps import lost, told
from pgm.kernels.machine.sweeps.evidence import (
    BELIEFS,
    CONSTANTS,
    KIND,
    RECORDS,
    STEPS,
    Evidence,
    Rows,
    Slots,
    Table,
    read,
)
from pgm.kernels.machine.sweeps.extent import is_long
from pgm.kernels.machine.sweeps.motion import predicted
from pgm.kernels.machine.sweeps.reading import taken
from pgm.kernels.machine.sweeps.writer import Writer
from pgm.kernels.numbers import where
from pgm.kernels.step import AnyMatrix

if TYPE_CHECKING:
    from pgm.kernels.machine.emitter.compiled import Compiled

STEP = "step"
_NOTHING: dict[object, object] = {}
# As of `beliefs.is_moderate`, and of `last_places.of_step`, which tells what has lost digits.
_REGULAR, _FAR = 1.0 / 2e7, (2e-6 / 2.0**-52) ** 2


@dataclass(frozen=True)
class Step:
    """A prediction, if it `moves`, or an update: its chain of one step, and what it is made from.

    `constants` are the arrays whose numbers the step is bound to, one after another, and behind
    them the settings of iterations. `watched` says that beliefs have a watch; `iterations` is how
    often measurements are linearised at most.
    """

    chain: told.Forward
    moves: bool
    constants: tuple[told.Array, ...]
    evidence: tuple[Evidence, ...]
    slots: Slots
    watched: bool = False
    iterations: int = 1

    @property
    def weighs(self) -> bool:
        """Whether some sensor has robust noise."""
        return any(sensor.weighs for sensor in self.chain.sensors)

    @property
    def record(self) -> int:
        """How many numbers the record of its iterations has."""
        return self.iterations + 1 if self.chain.iterated else 0


def kept(motion: told.Motion) -> list[told.Array]:
    """The matrix F, the offset and the noise of a linearisation, so far as they are kept."""
    found = (motion.matrix, motion.offset) if motion.curved else ()
    return [array for array in (*found, motion.kept) if array is not None]


@lru_cache(maxsize=128)
def made(online: Step) -> Compiled:
    """The machine code of a step; see `python.bound`."""
    module = Module()
    written(module, STEP, 2, lambda python: _write(python, online))
    return module.compile()


def _write(python: Python, online: Step) -> None:
    code, chain = python.code, online.chain
    belief, values = python.given
    before = _Core(python, belief, online)
    size = chain.size
    last = size + size * size
    count = last + 1 + (lost.SIZE if online.watched else 0)
    table = Table(code, chain)
    begin = python.bytes(before.numbers, 8 * count)
    table.put(chain.begin[0], begin)
    table.put(chain.begin[1], begin + size)
    settings = _constants(python, online, table)
    given = code.variable(values)
    if online.moves and not online.evidence:  # which may be left out
        with code.when(python.is_same(values, code.address(id(None)))):
            given.set(code.address(id(_NOTHING)))
    finite, rows = read(python, online.evidence, online.slots, table, given.get())
    lines = [array for motion in chain.motions for array in kept(motion)]
    length = code.whole(count + sum(prod(array.shape) for array in lines))
    length = length + int(online.weighs) + online.record
    for sensor in chain.sensors:
        length = length + (2 * table.count(sensor) + 1) * int(sensor.gate is not None)
        length = length + 2 * table.count(sensor) * int(sensor.weighs)
    most = length + sum((1 + each.rows * each.width for each in rows), code.whole(1))
    later = python.held(python.call("PyBytes_FromStringAndSize", python.null, 8 * most))
    end = python.memory_of(later)
    _copy(code, rows, end + length)
    table.put(chain.known[0], end)
    table.put(chain.known[1], end + size)
    table.put(chain.density, end + last)
    place = end + (count + int(online.weighs))
    if chain.iterated:
        table.put_iterations(online.iterations, settings, place)
        with code.loop(code.whole(online.record)) as k:
            code.memory(place).store(k, 0.0)
    _sightings(chain, table, place + online.record)
    _put(table, lines, place)

    frame = Frame.of_function(code)
    w = Writer(code, table.address, chain, Loops(code, frame) if is_long(chain, 1) else Lines(code))
    mean, cov = w.column(chain.begin[0]), w.symmetric(chain.begin[1])
    total, at = code.memory(begin).load(last), code.whole(0)
    watch = code.memory(begin + (last + 1)), code.memory(end + (last + 1))
    if online.moves:
        moved = predicted(w, chain, at, mean, cov)
        after, spread, sure = moved.mean, moved.cov, moved.sure
        cov = spread
        if online.watched:
            lost.on(*watch)
    else:
        found = taken(w, chain, at, mean, cov)
        after, spread, sure = found.moments.mean, found.moments.cov, found.sure
        total = total + found.density
        if online.watched:
            lost.read(*watch, found)
        if online.weighs:
            code.memory(end + count).store(0, where(found.settled, 0.0, 1.0))
    sure = sure & finite & (abs(total) < inf) & _is_moderate(w, after, spread, cov)
    w.keep(chain.known[0], after)
    w.keep(chain.known[1], spread)
    w.at(chain.density).store(0, total)
    python.give_none_unless(sure)
    code.give(before.after(later))
    frame.settle()


class _Core:
    """The slots of a belief, from which a step makes those of the next one."""

    def __init__(self, python: Python, belief: Address, online: Step) -> None:
        self._python, self._belief, self._online = python, belief, online
        slots = online.slots
        python.give_none_unless(python.is_a(belief, python.mine(BELIEFS)))
        steps = python.slot(belief, slots.steps)
        python.give_none_unless(python.is_same(steps, python.mine(STEPS)))
        self.numbers = python.slot(belief, slots.numbers)
        self._step = python.slot(belief, slots.number)
        self._count = python.call("PyLong_AsLongLong", self._step, result=WHOLE)
        if not online.moves:  # an update at step 0 is Python's
            python.give_none_unless(self._count != 0)

    def after(self, numbers: Address) -> Address:
        """The belief after the step, whose numbers, which are held, these are."""
        python, slots, step = self._python, self._online.slots, self._step
        if self._online.moves:
            step = python.held(python.call("PyLong_FromLongLong", self._count + 1))
        found = python.new(python.mine(BELIEFS))
        step = python.passed(step) if self._online.moves else python.more(step)
        python.fill(found, slots.steps, python.more(python.mine(STEPS)))
        python.fill(found, slots.number, step)
        python.fill(found, slots.numbers, python.passed(numbers))
        python.fill(found, slots.kind, python.more(python.mine(KIND)))
        python.fill(found, slots.records, python.more(python.mine(RECORDS)))
        python.fill(found, slots.behind, python.more(python.slot(self._belief, slots.behind)))
        if not self._online.moves:
            python.fill(found, slots.before, python.more(self.numbers))
        return python.passed(found)


def _sightings(chain: told.Forward, table: Table, place: Address) -> None:
    """Tell where the decisions of gates lie, and behind them robust weights."""
    for sensor in chain.sensors:
        if sensor.gate is not None:
            count = table.count(sensor)
            table.code.memory(place).store(0, count.number())
            table.put(sensor.gate.squares, place + 1, 1)
            table.put(sensor.gate.rejected, place + 1 + count, 1)
            place = place + 1 + 2 * count
    for sensor in chain.sensors:
        if sensor.loss is not None:
            count = table.count(sensor)
            table.put(sensor.loss.weights, place, 1)
            table.put(sensor.loss.squares, place + count, 1)
            place = place + 2 * count


def _copy(code: Code, rows: list[Rows], place: Address) -> None:
    """Put arrays of the evidence behind one another, and how many numbers that were."""
    total = code.whole(0)
    for address, count, width in rows:
        to, of, size = code.memory(place), code.memory(address), count * width
        to.store(0, count.number())
        with code.loop(size) as k:
            to.store(k + 1, of.load(k))
        place, total = place + (size + 1), total + size + 1
    code.memory(place).store(0, total.number())


def _constants(python: Python, online: Step, table: Table) -> Address:
    """Tell where constants lie; gives the address behind them."""
    count = sum(prod(array.shape) for array in online.constants)
    begin = python.bytes(python.mine(CONSTANTS), 8 * count)
    _put(table, online.constants, begin)
    return begin + count


def _put(table: Table, arrays: Sequence[told.Array], begin: Address) -> None:
    """Tell that arrays lie one behind another."""
    places = accumulate((prod(array.shape) for array in arrays), initial=0)
    for array, place in zip(arrays, places, strict=False):
        table.put(array, begin + place)


def _is_moderate(w: Writer, mean: AnyMatrix, cov: AnyMatrix, before: AnyMatrix) -> Any:
    """Whether float64 has digits enough for a belief after a step from a covariance."""
    m, found = w.matrices, []
    for x, variance, old in zip(m.beside(mean), m.diagonal(cov), m.diagonal(before), strict=True):
        none = (x == 0.0) & (variance == 0.0) & (old == 0.0)  # as behind the last component
        found.append(none | ((variance > _REGULAR * old) & (x * x < _FAR * variance)))
    return w.together(and_, found) & (w.open_share(cov) > _REGULAR)
