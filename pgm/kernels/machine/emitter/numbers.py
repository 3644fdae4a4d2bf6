"""Numbers and truths of a function that is being written."""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING, NoReturn, TypeAlias

from pgm.kernels.machine.emitter.kinds import packed

if TYPE_CHECKING:
    from pgm.kernels.machine.emitter.code import Code
    from pgm.kernels.machine.emitter.wholes import Whole


class Number:
    """A float, or a truth, of one run or of each run of a pack.

    Beside a pack, a number of one lane is that in all lanes; a truth in arithmetic is 0 or 1.
    """

    __slots__ = ("code", "lanes", "text", "truth")

    def __init__(self, code: Code, text: str, lanes: int = 1, truth: bool = False) -> None:
        self.code, self.text, self.lanes, self.truth = code, text, lanes, truth

    @property
    def kind(self) -> str:
        """The type in LLVM."""
        return packed("i1" if self.truth else "double", self.lanes)

    def __add__(self, other: Operand) -> Number:
        return self._with("fadd", other)

    def __radd__(self, other: Operand) -> Number:
        return constant(self.code, other)._with("fadd", self)

    def __sub__(self, other: Operand) -> Number:
        return self._with("fsub", other)

    def __rsub__(self, other: Operand) -> Number:
        return constant(self.code, other)._with("fsub", self)

    def __mul__(self, other: Operand) -> Number:
        return self._with("fmul", other)

    def __rmul__(self, other: Operand) -> Number:
        return constant(self.code, other)._with("fmul", self)

    def __truediv__(self, other: Operand) -> Number:
        return self._with("fdiv", other)

    def __rtruediv__(self, other: Operand) -> Number:
        return constant(self.code, other)._with("fdiv", self)

    def __neg__(self) -> Number:
        own = self.number()
        return own.like(f"fneg {own.kind} {own.text}")

    def __abs__(self) -> Number:
        return self.intrinsic("fabs")

    def __lt__(self, other: Operand) -> Number:
        return self._against("olt", other)

    def __le__(self, other: Operand) -> Number:
        return self._against("ole", other)

    def __gt__(self, other: Operand) -> Number:
        return self._against("ogt", other)

    def __ge__(self, other: Operand) -> Number:
        return self._against("oge", other)

    def __eq__(self, other: Operand) -> Number:  # type: ignore[override]
        return self._against("oeq", other)

    def __ne__(self, other: Operand) -> Number:  # type: ignore[override]
        return self._against("une", other)

    __hash__ = object.__hash__

    def __and__(self, other: Operand) -> Number:
        return self._logical("and", other)

    __rand__ = __and__

    def __or__(self, other: Operand) -> Number:
        return self._logical("or", other)

    __ror__ = __or__

    def __invert__(self) -> Number:
        return self._logical("xor", True)

    def __bool__(self) -> NoReturn:
        raise TypeError("a truth is known only when its code runs; use `when` or `where`")

    def apply(self, name: str, *others: Operand) -> Number:
        """The operation of this NumPy name on this number and others."""
        return self.code.applied(name, self, *others)

    def where(self, yes: Operand, no: Operand) -> Number:
        """One or the other number, by this truth."""
        yes, no = constant(self.code, yes), constant(self.code, no)
        if not (yes.truth and no.truth):
            yes, no = yes.number(), no.number()
        lanes = max(self.lanes, yes.lanes, no.lanes)
        truth, yes, no = self.as_truth(), yes.spread(lanes), no.spread(lanes)
        truth = truth.spread(lanes) if truth.lanes > 1 else truth  # one decides for whole packs
        chosen = f"select {truth.kind} {truth.text}, {yes.kind} {yes.text}, {no.kind} {no.text}"
        return yes.like(chosen)

    def choose(self, truth: Operand, yes: Operand, no: Operand) -> Number:
        """One or the other number, by a truth."""
        return constant(self.code, truth).where(yes, no)

    def number(self) -> Number:
        """The float of this: of a truth, 0 or 1."""
        if not self.truth:
            return self
        to = packed("double", self.lanes)
        return Number(
            self.code, self.code.value(f"uitofp {self.kind} {self.text} to {to}"), self.lanes
        )

    def as_truth(self) -> Number:
        """Whether this differs from zero."""
        return self if self.truth else self != 0.0

    def whole(self) -> Whole:
        """The whole number of a float of one lane, without its fraction; the bounds beyond them."""
        return self.code.rounded(self)

    def spread(self, lanes: int) -> Number:
        """The pack that has this in each of so many lanes; a pack of so many is itself."""
        if self.lanes == lanes:
            return self
        if self.lanes > 1:
            raise TypeError(f"a pack of {self.lanes} lanes meets one of {lanes}")
        return self.code.spread(self, lanes)

    def lane(self, place: int) -> Number:
        """The number of one lane."""
        if self.lanes == 1:
            return self
        found = self.code.value(f"extractelement {self.kind} {self.text}, i32 {place}")
        return Number(self.code, found, 1, self.truth)

    def with_lane(self, place: int, other: Operand) -> Number:
        """The pack with another number in one lane."""
        if self.lanes == 1:
            return constant(self.code, other)
        new = constant(self.code, other)
        new = new.as_truth() if self.truth else new.number()
        return self.like(
            f"insertelement {self.kind} {self.text}, {new.kind} {new.text}, i32 {place}"
        )

    def intrinsic(self, name: str, *others: Operand) -> Number:
        """The function of LLVM's own of this number and others."""
        return self.code.intrinsic(name, self, *others)

    def like(self, instruction: str) -> Number:
        """The value of an instruction, of the kind of this number."""
        return Number(self.code, self.code.value(instruction), self.lanes, self.truth)

    def _with(self, instruction: str, other: Operand) -> Number:
        a, b = alike(self, constant(self.code, other))
        return a.like(f"{instruction} {self.code.flags}{a.kind} {a.text}, {b.text}")

    def _against(self, relation: str, other: Operand) -> Number:
        a, b = alike(self, constant(self.code, other))
        found = self.code.value(f"fcmp {relation} {a.kind} {a.text}, {b.text}")
        return Number(self.code, found, a.lanes, True)

    def _logical(self, instruction: str, other: Operand) -> Number:
        a, b = self.as_truth(), constant(self.code, other).as_truth()
        lanes = max(a.lanes, b.lanes)
        a, b = a.spread(lanes), b.spread(lanes)
        return a.like(f"{instruction} {a.kind} {a.text}, {b.text}")


# What may stand beside a number.
Operand: TypeAlias = Number | float | bool


def constant(code: Code, value: Operand) -> Number:
    """The number of a value that is known; a number is itself."""
    if isinstance(value, Number):
        return value
    if isinstance(value, bool):
        return Number(code, "true" if value else "false", 1, True)
    # The bits, since LLVM's decimals are those that a float has exactly.
    return Number(code, f"0x{struct.pack('>d', value).hex()}")


def alike(a: Number, b: Number) -> tuple[Number, Number]:
    """Floats of equally many lanes."""
    if a.truth or b.truth:
        a, b = a.number(), b.number()
    if a.lanes != b.lanes:
        lanes = max(a.lanes, b.lanes)
        a, b = a.spread(lanes), b.spread(lanes)
    return a, b
