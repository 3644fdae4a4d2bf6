"""Variables of a function that is being written."""

from __future__ import annotations

from typing import TYPE_CHECKING, Generic, TypeAlias, TypeVar, cast

from pgm.kernels.machine.emitter.numbers import Number, constant
from pgm.kernels.machine.emitter.wholes import Address, Whole

if TYPE_CHECKING:
    from pgm.kernels.machine.emitter.code import Code

Value: TypeAlias = Number | Whole | Address
Held = TypeVar("Held", bound=Value)


class Variable(Generic[Held]):
    """A value that changes as code runs: the way out of loops and branches for what they find."""

    def __init__(self, code: Code, initial: Held) -> None:
        self._code, self._like = code, initial
        self._place = code.reserve(initial.kind)
        self.set(initial)

    def get(self) -> Held:
        """The value at this point of the code."""
        like = self._like
        text = self._code.value(f"load {like.kind}, ptr {self._place}")
        return cast(Held, self._code.named(like, text))

    def set(self, value: Held | float | bool) -> None:
        """Give the variable another value from here on."""
        text = self._code.operand(self._like, value).text
        self._code.line(f"store {self._like.kind} {text}, ptr {self._place}")


def held(code: Code, number: Number | float) -> Variable[Number]:
    """A variable that begins as a number, of all runs at hand."""
    number = constant(code, number)
    return code.variable(number.spread(max(code.lanes, number.lanes)))
