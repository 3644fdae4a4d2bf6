"""Studies on a card: runs drawn, and beliefs about them judged; `card_sums` has their sums.

Arrays of runs have a *stride*, from one number of a run to its next: the runs that there is room
for, which lie beside each other. Each kernel is ``kernel(table, first, last)``, a thread for each
number from `first` to below `last`: a run, or what is said of each.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import lru_cache
from math import nan
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from pgm.kernels import philox
from pgm.kernels.machine.emitter.arena import Arena
from pgm.kernels.machine.emitter.card import Card, printed, thread
from pgm.kernels.machine.emitter.code import Code
from pgm.kernels.machine.emitter.driver import Device
from pgm.kernels.machine.emitter.kinds import ADDRESS, WHOLE
from pgm.kernels.machine.emitter.memory import Memory, Runs
from pgm.kernels.machine.emitter.module import Module
from pgm.kernels.machine.emitter.wholes import Whole
from pgm.kernels.machine.matrices.lines import Lines
from pgm.kernels.machine.studies.beliefs import figures
from pgm.kernels.machine.studies.draws import fill, uniform
from pgm.kernels.machine.studies.normals import quantile
from pgm.kernels.machine.studies.rows import Child, Form, RowWriter
from pgm.kernels.machine.studies.sums import Cells, Given
from pgm.kernels.numbers import Matrix, where

KINDS = (ADDRESS, WHOLE, WHOLE)
DRAW, JUDGE, PICK = "draw", "judge", "pick"
Capability = tuple[int, int]


def loaded(make: Callable[..., str], name: str, device: Device, *form: Any) -> Any:
    """A kernel of this name on a card, of the text that is made for its form."""
    return _loaded(make, name, device, form)


@lru_cache(maxsize=64)
def _loaded(make: Callable[..., str], name: str, device: Device, form: tuple[Any, ...]) -> Any:
    with device.current():
        return device.kernel(make(*form, device.capability), name)


def table(arena: Arena, *given: Any) -> int:
    """The address of a kernel's table there; arrays that are given are copied."""
    numbers: list[int] = []
    for each in given:
        if isinstance(each, Cells):
            numbers += each
        else:
            numbers.append(arena.put(each) if isinstance(each, np.ndarray) else int(each))
    return arena.put(np.array(numbers, dtype=np.int64))


@contextmanager
def each_thread(code: Code) -> Iterator[Whole]:
    """The number of the thread at hand, from zero on, if there is work for it."""
    _, first, last = code.arguments
    own = thread(code)
    with code.when(first + own < last):
        yield own


# Draws


class Drawing(NamedTuple):
    """The forms of CPDs that are drawn: of the prior, the transition, and the sensors."""

    prior: tuple[Form, ...]
    transition: tuple[Form, ...]
    sensors: tuple[Form, ...]

    @property
    def all(self) -> tuple[Form, ...]:
        """The forms, in order."""
        return (*self.prior, *self.transition, *self.sensors)


class Drawn(NamedTuple):
    """A child whose noise is drawn at each of its rows, by counters as of `counted`.

    variable: The child's place among the network's variables.
    order: The row that counters have, of each row.
    """

    child: Child
    variable: int
    order: npt.NDArray[np.int64]

    @property
    def numbers(self) -> list[Any]:
        """The numbers of a table, in the order of `drawing`."""
        return [self.variable, len(self.order), self.order, *self.child.numbers]


@lru_cache(maxsize=32)
def drawing(forms: Drawing, capability: Capability) -> str:
    """The kernel that draws runs: at all steps, from one to the next, and then readings of them.

    Its table has the key, where a sum of all of a run's values is put, and the numbers of each
    `Drawn`. `first` is the number of the first run.
    """
    code = Module(target=Card(capability)).function(DRAW, KINDS)
    given, first = Given(code, code.arguments[0]), code.arguments[1]
    key, sums = (given.whole(), given.whole()), given.address()
    drawn = [_Drawn(form, given) for form in forms.all]
    ahead, after = len(forms.prior), len(forms.prior) + len(forms.transition)
    white = code.room(max(form.height for form in forms.all), "noise")
    noise = _noise(code.module)
    with each_thread(code) as run:
        total = code.varying(0.0)

        def draw(each: _Drawn, k: Whole) -> None:
            row = code.wholes(each.order).load(k)
            code.call(noise, white.address, each.form.height, *key, first + run, row, each.variable)
            *parents, out = (cells(run) for cells in each.writer.at(k))
            for value in each.writer.write(parents, white, out):
                total.set(total.get() + value)

        for each in drawn[:ahead]:
            draw(each, code.whole(0))
        if drawn[ahead:after]:
            with code.loop(drawn[ahead].count) as k:
                for each in drawn[ahead:after]:
                    draw(each, k)
        for each in drawn[after:]:
            with code.loop(each.count) as k:
                draw(each, k)
        code.memory(sums).store(run, total.get())
    return printed(code.module, [DRAW])


def _noise(module: Module) -> Code:
    """The function that puts so many standard normal numbers of a row of a run into memory.

    It is called rather than copied to where it is due, as it is long.
    """
    kinds = (ADDRESS, *[WHOLE] * 6)
    code = module.function("noise", kinds, internal=True, inline=False)
    out, count, *key, run, row, variable = code.arguments
    words, blocks = code.room(philox.BLOCK, "words"), (count + philox.BLOCK - 1) // philox.BLOCK
    with code.loop(count) as i:
        block, place = i // philox.BLOCK, i % philox.BLOCK
        with code.when(place == 0):
            counter = run * blocks + block, row, variable, code.whole(0)
            fill(code, words.address, 1, (key[0], key[1]), counter)
        code.memory(out).store(i, quantile(code, uniform(code, words.address + place)))
    return code


class _Drawn:
    """A `Drawn` that is being written."""

    def __init__(self, form: Form, given: Given) -> None:
        self.form, self.variable, self.count = form, given.whole(), given.whole()
        self.order, self.writer = given.address(), RowWriter(form, given)


# Figures


class Judging(NamedTuple):
    """A state that is judged: its places in a slice of so many components, and which are angles."""

    places: tuple[int, ...]
    size: int
    angles: tuple[bool, ...]

    @property
    def cells(self) -> int:
        """How many figures there are: errors, their squares, the NEES, and if a region holds it."""
        return 2 * len(self.places) + 2


@lru_cache(maxsize=32)
def judging(form: Judging, capability: Capability) -> str:
    """The kernel that judges a state's beliefs at all steps, a thread a run.

    Its table has the number of steps, the stride, means and covariances of slices, truths, and
    where figures are put, (steps, cells, stride), all as `Cells` but for the last, and the limit of
    the regions of confidence. The NEES of a covariance that is singular is NaN.
    """
    code = Module(target=Card(capability)).function(JUDGE, KINDS)
    given, lines = Given(code, code.arguments[0]), Lines(code)
    steps, stride = given.whole(), given.whole()
    means, covs, truths = (given.array(Runs.BESIDE) for _ in range(3))
    out, limit = given.address(), Memory(code, given.address()).load(0)
    size, places = len(form.places), form.places
    with each_thread(code) as run, code.loop(steps) as step:
        mean, cov = means(step, run), covs(step, run)
        found = figures(
            lines,
            Matrix.column(mean.load(k) for k in places),
            lines.symmetric_of(cov, places, form.size),
            lines.column(truths(step, run), size),
            form.angles,
        )
        nees = where(found.proper, found.nees, nan)
        held = where(found.proper, (found.nees <= limit).number(), nan)
        squares = [error * error for error in found.errors]
        cells = Memory(code, out + (stride * form.cells * step + run), step=stride)
        for k, figure in enumerate([*found.errors, *squares, nees, held]):
            cells.store(k, figure)
    return printed(code.module, [JUDGE])


# A few runs


@lru_cache(maxsize=4)
def picking(capability: Capability) -> str:
    """The kernel that copies a few runs of an array, a thread for each number of a run.

    Its table has the array, its stride, how many runs are copied, the distance between them, and
    where they are put, beside each other.
    """
    code = Module(target=Card(capability)).function(PICK, KINDS)
    given = Given(code, code.arguments[0])
    array, stride, count, apart, out = (
        given.address(),
        given.whole(),
        given.whole(),
        given.whole(),
        given.address(),
    )
    with each_thread(code) as own, code.loop(count) as k:
        value = code.memory(array).load(own * stride + k * apart)
        code.memory(out).store(own * count + k, value)
    return printed(code.module, [PICK])
