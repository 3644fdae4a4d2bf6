"""CPDs at particles: where their parents stand, and the code of their values.

A law is a CPD with the values of its observed parents, its *inputs*, (rows, runs or 1, d). Hidden
parents are among the components of a particle: of its step, or of the step before.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from pgm.kernels.arrays import Array
from pgm.kernels.machine.emitter.functions import Function
from pgm.kernels.machine.emitter.memory import Memory, Runs
from pgm.kernels.machine.emitter.wholes import Whole
from pgm.kernels.machine.studies.rows import ChildWriter, Form
from pgm.kernels.machine.studies.sums import Cells, Given

# Where a parent stands: in the slice before, in that of the step, or among a law's inputs.
BEFORE, NOW, INPUT = "before", "now", "input"


class Parent(NamedTuple):
    """A parent: where it stands, its first component there, and how many it has."""

    where: str
    first: int
    width: int


class LawForm(NamedTuple):
    """All that decides the code of a law.

    function: The CPD's function, whose arguments are observed; None of a sum of its parents.
    parents: As the CPD is given them.
    height: The number of components of the child.
    child: The child's first component in the slice; of a sensor it is idle.
    angles: Which of the child's components are angles.
    tails: Whether the noise is Student-t, of a sensor.
    """

    function: Function | None
    parents: tuple[Parent, ...]
    height: int
    child: int
    angles: tuple[bool, ...]
    tails: bool

    @property
    def row(self) -> Form:
        """The form of the CPD's child, where particles stand for runs."""
        given = tuple((each.width, _RUNS[each.where]) for each in self.parents)
        return Form(self.function, given, self.height, Runs.BESIDE, Runs.BESIDE)


_RUNS = {BEFORE: Runs.BESIDE, NOW: Runs.BESIDE, INPUT: Runs.SAME}


def cells(array: Array) -> Cells:
    """An array (rows, runs or 1, d) in memory, where one run's numbers are those of all."""
    found = Cells.of(array.swapaxes(0, 1))
    return found if array.shape[1] > 1 else found._replace(across=0)


class ByRow:
    """An array that `cells` tells of, among the numbers given."""

    def __init__(self, given: Given) -> None:
        self._code, self._begin = given.code, given.address()
        self._across, self._down, self._cell = given.whole(), given.whole(), given.whole()

    def at(self, row: Whole, run: Whole) -> Memory:
        """The numbers of a row and a run, which all particles of a pack have."""
        place = self._begin + (row * self._down + run * self._across)
        return Memory(self._code, place, step=self._cell, runs=Runs.SAME)


class LawWriter:
    """A law that is being written; given are its constants, see `rows.constants`, and inputs."""

    def __init__(self, form: LawForm, given: Given) -> None:
        self.form, self.child = form, ChildWriter(form.row, given)
        self._inputs = [ByRow(given) if each.where == INPUT else None for each in form.parents]

    def parents(self, row: Whole, run: Whole, now: Memory, before: Memory) -> Sequence[Memory]:
        """Where the parents are, at a row of the inputs, for a pack of a run's particles."""
        found = []
        for parent, inputs in zip(self.form.parents, self._inputs, strict=True):
            if inputs is not None:
                found.append(inputs.at(row, run))
            else:
                found.append((now if parent.where == NOW else before).moved(parent.first))
        return found
