"""Evidence of one step as Python gives it, read in machine code: variables to arrays of numbers."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf
from typing import NamedTuple

from pgm.kernels.machine.emitter.arrays import floats
from pgm.kernels.machine.emitter.code import Code
from pgm.kernels.machine.emitter.memory import Cells
from pgm.kernels.machine.emitter.numbers import Number
from pgm.kernels.machine.emitter.python import Python
from pgm.kernels.machine.emitter.wholes import Address, Whole
from pgm.kernels.machine.sweeps import told
from pgm.kernels.machine.sweeps.writer import arrays

# What a step is bound to: its constants, the classes of arrays, sightings and beliefs; the filter's
# steps, the kind and the records of its beliefs; and the variables in the order of the evidence.
CONSTANTS, ARRAYS, SIGHTINGS, BELIEFS, STEPS, KIND, RECORDS, VARIABLES = range(8)


@dataclass(frozen=True)
class Evidence:
    """Evidence of a variable: a row (d,), or the sightings of a sensor, (M, d).

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


class Slots(NamedTuple):
    """The places of slots (`python.place_of_slot`) of sightings and of beliefs.

    Those of sightings are `values`, `time` (their steps) and `given`; those of beliefs have the
    parts of a core, see `online`.
    """

    values: int
    time: int
    given: int
    steps: int
    number: int
    numbers: int
    kind: int
    records: int
    behind: int
    before: int


class Table:
    """The table of a chain (`told`), filled while code runs, in memory of the function's own."""

    def __init__(self, code: Code, chain: told.Forward) -> None:
        self.code = code
        ends = [array.place + told.CELL for array in arrays(chain)]
        ends += [sensor.bounds for sensor in chain.sensors if sensor.bounds is not None]
        size = 1 + max(ends, default=told.FIRST)
        self.address = Address(code, code.reserve(f"[{size} x i64]"))
        self._wholes = Cells(code, self.address, Whole)
        self._addresses = Cells(code, self.address, Address)
        self._counts: dict[int, Whole] = {}
        for place in range(told.FIRST):
            self._wholes.store(place, code.whole(int(place == told.RUNS)))

    def put(self, array: told.Array, address: Address, down: int = 0) -> None:
        """Tell where an array lies, whose cells are next to each other."""
        self._addresses.store(array.place, address)
        for what, distance in ((told.DOWN, down), (told.ACROSS, 0), (told.CELL, 1)):
            self._wholes.store(array.place + what, self.code.whole(distance))

    def put_bounds(self, place: int, count: Whole) -> None:
        """Tell that a step has so many sightings of a sensor."""
        bounds = Cells(self.code, Address(self.code, self.code.reserve("[2 x i64]")), Whole)
        bounds.store(0, self.code.whole(0))
        bounds.store(1, count)
        self._addresses.store(place, bounds.address)
        self._counts[place] = count

    def put_iterations(self, most: int, settings: Address, record: Address) -> None:
        """Tell how often measurements are linearised, and where settings and the record are."""
        self._wholes.store(told.ITERATIONS, self.code.whole(most))
        self._addresses.store(told.SETTINGS, settings)
        self._addresses.store(told.RESIDUALS, record)

    def count(self, sensor: told.Sensor) -> Whole:
        """How many sightings of a sensor the step has."""
        return self.code.whole(1) if sensor.bounds is None else self._counts[sensor.bounds]


class Rows(NamedTuple):
    """An array of the evidence: where its rows begin, how many they are, and how wide."""

    address: Address
    rows: Whole
    width: int


def read(
    python: Python, evidence: tuple[Evidence, ...], slots: Slots, table: Table, values: Address
) -> tuple[Number, list[Rows]]:
    """Put what is given into a table; whether all of it is finite, or missing; and its arrays.

    The arrays are in the order of the evidence, a sensor's before those given with it. The function
    that is written ends with None where the evidence is of another kind.
    """
    reader = _Reader(python, slots, table)
    items = python.items(values, len(evidence))
    for (variable, value), each in zip(items, evidence, strict=True):
        reader.take(variable, value, each)
    return reader.finite.get(), reader.arrays


class _Reader:
    """A reader of evidence, which counts the variables that it has met."""

    def __init__(self, python: Python, slots: Slots, table: Table) -> None:
        self.python, self.slots, self.table, self.code = python, slots, table, python.code
        self.finite = self.code.varying(True)
        self.arrays: list[Rows] = []
        self._arrays, self._met = python.mine(ARRAYS), 0

    def take(self, variable: Address, value: Address, due: Evidence) -> None:
        """Take what is given of a variable."""
        python = self.python
        self._meet(variable)
        if due.given is None:
            self._rows(value, due.array, 1, missing=due.missing)
            return
        python.give_none_unless(python.is_a(value, python.mine(SIGHTINGS)))
        time = python.slot(value, self.slots.time)
        python.give_none_unless(python.is_same(time, self.code.address(id(None))))
        parents = python.slot(value, self.slots.given)
        own = python.slot(value, self.slots.values)
        count = self._rows(own, due.array, 2, missing=due.missing)
        items = python.items(parents, len(due.given))
        for (parent, its), array in zip(items, due.given, strict=True):
            self._meet(parent)
            python.give_none_unless(self._rows(its, array, 2) == count)
        if due.bounds is None:
            python.give_none_unless(count == 1)
        else:
            self.table.put_bounds(due.bounds, count)

    def _meet(self, variable: Address) -> None:
        due = self.python.mine(VARIABLES + self._met)
        self._met += 1
        self.python.give_none_unless(self.python.is_same(variable, due))

    def _rows(
        self, value: Address, array: told.Array, axes: int, *, missing: bool = False
    ) -> Whole:
        """Take an array of one row, or of several, of which there are as many as it says."""
        (width,) = array.shape
        address, shape = floats(self.python, value, self._arrays, axes)
        self.python.give_none_unless(shape[-1] == width)
        count = shape[0] if axes == 2 else self.code.whole(1)
        self.table.put(array, address, width if axes == 2 else 0)
        self.arrays.append(Rows(address, count, width))
        with self.code.loop(count) as at:
            row = self.code.memory(address + at * width)
            for x in map(row.load, range(width)):
                fine = abs(x) < inf
                fine = fine | (x != x) if missing else fine
                self.finite.set(self.finite.get() & fine)
        return count
