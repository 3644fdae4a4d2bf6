"""Numbers, wholes, truths and addresses in memory, by their place."""

from __future__ import annotations

from enum import Enum
from typing import TYPE_CHECKING, Any, Generic, TypeVar, cast

from pgm.kernels.machine.emitter.checks import check_alignment, check_index
from pgm.kernels.machine.emitter.kinds import packed
from pgm.kernels.machine.emitter.numbers import Number, Operand, constant
from pgm.kernels.machine.emitter.wholes import Address, Whole

if TYPE_CHECKING:
    from pgm.kernels.machine.emitter.code import Code


class Runs(Enum):
    """How the runs of a pack lie in memory."""

    BESIDE = "one next to another"
    SAME = "one number for all of them"
    APART = "at a distance from each other"


class Memory:
    """Numbers in memory: number k of run r is the float at ``address + k step + r apart``.

    They are of as many runs as the function is, or of so many `lanes`.
    """

    def __init__(
        self,
        code: Code,
        address: Address,
        *,
        length: Whole | int | None = None,
        step: Whole | int = 1,
        runs: Runs = Runs.BESIDE,
        apart: Whole | int = 1,
        alignment: int = 8,
        name: str = "memory",
        lanes: int | None = None,
    ) -> None:
        self.code, self.address, self.name = code, address, name
        self.length, self.step = length, step
        self.lanes = code.lanes if lanes is None else lanes
        self.runs, self.apart = runs if self.lanes > 1 else Runs.BESIDE, apart
        self.alignment = alignment

    def load(self, index: Whole | int) -> Number:
        """The number at a place."""
        code, place = self.code, self._place(index, "load")
        if self.runs is Runs.BESIDE:
            kind = packed("double", self.lanes)
            found = code.value(f"load {kind}, ptr {place.text}, align {self.alignment}")
            return Number(code, found, self.lanes)
        if self.runs is Runs.SAME:
            found = code.value(f"load double, ptr {place.text}, align 8")
            return Number(code, found)
        pack = Number(code, "poison", self.lanes)
        for lane in range(self.lanes):
            at = place + self._distance(lane)
            one = Number(code, code.value(f"load double, ptr {at.text}, align 8"))
            pack = pack.with_lane(lane, one)
        return pack

    def store(self, index: Whole | int, value: Operand) -> None:
        """Write a number to a place."""
        code = self.code
        if self.runs is Runs.SAME:
            raise TypeError(f"{self.name} has one number for all runs of a pack: it is only read")
        place = self._place(index, "store")
        value = constant(code, value).number().spread(self.lanes)
        if self.runs is Runs.BESIDE:
            code.line(f"store {value.kind} {value.text}, ptr {place.text}, align {self.alignment}")
            return
        for lane in range(self.lanes):
            at = place + self._distance(lane)
            code.line(f"store double {value.lane(lane).text}, ptr {at.text}, align 8")

    def moved(self, count: Whole | int, length: Whole | int | None = None) -> Memory:
        """The memory that begins so many numbers further on."""
        return Memory(
            self.code,
            self.address + self._steps(count),
            length=length,
            step=self.step,
            runs=self.runs,
            apart=self.apart,
            alignment=self.alignment,
            name=self.name,
            lanes=self.lanes,
        )

    def _place(self, index: Whole | int, what: str) -> Address:
        code = self.code
        if code.module.checked:
            check_index(code, index, self.length, f"{what} in {self.name}")
        place = self.address + self._steps(index)
        if code.module.checked:
            check_alignment(code, place, self.alignment, f"{what} in {self.name}")
        return place

    def _steps(self, count: Whole | int) -> Whole | int:
        return count if isinstance(self.step, int) and self.step == 1 else self.step * count

    def _distance(self, lane: int) -> Whole | int:
        return self.apart * lane if lane else 0


Value = TypeVar("Value", bound=Whole | Address | Number)


class Cells(Generic[Value]):
    """Values in memory that are no floats, one for all runs: wholes, addresses, truths of a byte.

    Truths lie as NumPy's arrays of bool have them.
    """

    def __init__(
        self,
        code: Code,
        address: Address,
        kind: type[Value],
        length: Whole | int | None = None,
        name: str = "cells",
    ) -> None:
        self.code, self.address, self.length, self.name = code, address, length, name
        self._kind: Any = kind
        self._scalar = {Whole: "i64", Address: "ptr"}.get(self._kind, "i8")
        self._width = 1 if self._scalar == "i8" else 8

    def load(self, index: Whole | int) -> Value:
        """The value at a place."""
        place = self._place(index, "load")
        found = self.code.value(f"load {self._scalar}, ptr {place.text}, align {self._width}")
        if self._scalar == "i8":
            truth = self.code.value(f"icmp ne i8 {found}, 0")
            return cast(Value, Number(self.code, truth, truth=True))
        if self._kind is Address:
            return cast(Value, self.code.module.target.pointed(Address(self.code, found)))
        return cast(Value, self._kind(self.code, found))

    def store(self, index: Whole | int, value: Value) -> None:
        """Write a value to a place."""
        place, text = self._place(index, "store"), value.text
        if isinstance(value, Number):
            text = self.code.value(f"zext i1 {value.as_truth().text} to i8")
        self.code.line(f"store {self._scalar} {text}, ptr {place.text}, align {self._width}")

    def _place(self, index: Whole | int, what: str) -> Address:
        if self.code.module.checked:
            check_index(self.code, index, self.length, f"{what} in {self.name}")
        place = self.address.moved(index, self._scalar)
        if self.code.module.checked:
            check_alignment(self.code, place, self._width, f"{what} in {self.name}")
        return place
