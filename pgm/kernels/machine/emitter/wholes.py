"""Whole numbers and addresses of a function that is being written."""

from __future__ import annotations

from typing import TYPE_CHECKING, NoReturn

from pgm.kernels.machine.emitter.numbers import Number

if TYPE_CHECKING:
    from pgm.kernels.machine.emitter.code import Code


# Instructions that leave a number as it is.
_NOTHING = {("add", 0), ("sub", 0), ("mul", 1), ("udiv", 1), ("xor", 0)}


class Whole:
    """A whole number of 64 bits: a count, an index or a distance in memory."""

    __slots__ = ("code", "text")
    kind = "i64"

    def __init__(self, code: Code, text: str) -> None:
        self.code, self.text = code, text

    def __add__(self, other: Whole | int) -> Whole:
        return self._with("add", other)

    __radd__ = __add__

    def __sub__(self, other: Whole | int) -> Whole:
        return self._with("sub", other)

    def __rsub__(self, other: int) -> Whole:
        return self.code.whole(other) - self

    def __mul__(self, other: Whole | int) -> Whole:
        return self._with("mul", other)

    __rmul__ = __mul__

    def __floordiv__(self, other: Whole | int) -> Whole:
        """The quotient of counts, none of them negative."""
        return self._with("udiv", other)

    def __mod__(self, other: Whole | int) -> Whole:
        """The remainder of counts, none of them negative."""
        return self._with("urem", other)

    def __xor__(self, other: Whole | int) -> Whole:
        return self._with("xor", other)

    def product(self, other: Whole | int) -> tuple[Whole, Whole]:
        """The upper and the lower 64 bits of a product of words, numbers without a sign."""
        value = self.code.value
        texts = [each.text for each in (self, self.code.whole(other))]
        a, b = (value(f"zext i64 {text} to i128") for text in texts)
        whole = value(f"mul i128 {a}, {b}")
        above = value(f"lshr i128 {whole}, 64")
        high, low = (Whole(self.code, value(f"trunc i128 {k} to i64")) for k in (above, whole))
        return high, low

    def __lt__(self, other: Whole | int) -> Number:
        return self._against("slt", other)

    def __le__(self, other: Whole | int) -> Number:
        return self._against("sle", other)

    def __gt__(self, other: Whole | int) -> Number:
        return self._against("sgt", other)

    def __ge__(self, other: Whole | int) -> Number:
        return self._against("sge", other)

    def __eq__(self, other: Whole | int) -> Number:  # type: ignore[override]
        return self._against("eq", other)

    def __ne__(self, other: Whole | int) -> Number:  # type: ignore[override]
        return self._against("ne", other)

    __hash__ = object.__hash__

    def __bool__(self) -> NoReturn:
        raise TypeError("a whole number is known only when its code runs; compare it, then `when`")

    def at_most(self, other: Whole) -> Whole:
        """The lesser of two whole numbers."""
        two = f"i64 {self.text}, i64 {other.text}"
        return Whole(self.code, self.code.value(f"select i1 {(self < other).text}, {two}"))

    def number(self) -> Number:
        """The nearest float, of one lane."""
        return Number(self.code, self.code.value(f"sitofp i64 {self.text} to double"))

    def _with(self, instruction: str, other: Whole | int) -> Whole:
        if isinstance(other, int) and (instruction, other) in _NOTHING:
            return self
        text = other.text if isinstance(other, Whole) else str(other)
        return Whole(self.code, self.code.value(f"{instruction} i64 {self.text}, {text}"))

    def _against(self, relation: str, other: Whole | int) -> Number:
        text = other.text if isinstance(other, Whole) else str(other)
        found = self.code.value(f"icmp {relation} i64 {self.text}, {text}")
        return Number(self.code, found, truth=True)


class Address:
    """An address in memory; added to, it moves on by so many floats."""

    __slots__ = ("code", "text")
    kind = "ptr"

    def __init__(self, code: Code, text: str) -> None:
        self.code, self.text = code, text

    def __add__(self, count: Whole | int) -> Address:
        return self.moved(count, "double")

    def moved(self, count: Whole | int, scalar: str = "double") -> Address:
        """The address that lies so many scalars of an LLVM type further on."""
        if isinstance(count, int) and not count:
            return self
        text = count.text if isinstance(count, Whole) else str(count)
        where = f"getelementptr {scalar}, ptr {self.text}, i64 {text}"
        return Address(self.code, self.code.value(where))

    def is_null(self) -> Number:
        """Whether there is no memory at this address."""
        return Number(self.code, self.code.value(f"icmp eq ptr {self.text}, null"), truth=True)
