"""Functions that are being written: values, variables, loops, branches and calls."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from operator import index
from typing import TYPE_CHECKING, Any

from pgm.kernels.machine.emitter.body import Body
from pgm.kernels.machine.emitter.kinds import ADDRESS, WHOLE, Kind, packed, symbol
from pgm.kernels.machine.emitter.memory import Cells, Memory, Runs
from pgm.kernels.machine.emitter.numbers import Number, Operand, constant
from pgm.kernels.machine.emitter.operations import OPERATIONS
from pgm.kernels.machine.emitter.variables import Held, Value, Variable
from pgm.kernels.machine.emitter.wholes import Address, Whole

if TYPE_CHECKING:
    from pgm.kernels.machine.emitter.module import Module

# The widest vectors that processors load at once, in bytes.
_WIDEST = 64


class Code(Body):
    """A function that is being written, for one run or for a pack of `lanes` runs at once."""

    def __init__(
        self,
        module: Module,
        name: str,
        kinds: Sequence[Kind],
        result: Kind | None,
        lanes: int,
        heading: str,
        ending: str,
        disjoint: bool,
    ) -> None:
        super().__init__()
        self.module, self.name, self.lanes = module, name, lanes
        self.kinds, self.result = tuple(kinds), result
        self.flags = "contract " if module.contract else ""
        self.symbol = f'@"{symbol(name)}"'
        self._ends: list[str] = []  # of the loops around this point, the innermost last
        self._choice: tuple[int, str, str] | None = None  # the `when` that has just ended
        self._gives = False
        apart = {ADDRESS: "noalias"} if disjoint else {}
        marks = [apart.get(kind, kind.extended) for kind in kinds]
        named = [
            f"{kind.written(lanes)} {mark} %a{k}"
            for k, (kind, mark) in enumerate(zip(kinds, marks, strict=True))
        ]
        given = f"{self._returned(result)} {self.symbol}({', '.join(named)})"
        self._heading = f"{heading} {given} {ending} {{"
        self.arguments: tuple[Any, ...] = tuple(
            self._opened(kind, f"%a{k}") for k, kind in enumerate(kinds)
        )

    # Values

    def constant(self, value: float | bool) -> Number:
        """The number that is this in every lane."""
        return constant(self, value).spread(self.lanes)

    def whole(self, value: Whole | int) -> Whole:
        """The whole number of a value that is known."""
        return value if isinstance(value, Whole) else Whole(self, str(index(value)))

    def address(self, value: int) -> Address:
        """The address that is known as the code is written; its memory must outlive the code."""
        return Address(self, f"inttoptr (i64 {value} to ptr)")

    def variable(self, initial: Held) -> Variable[Held]:
        """A variable that begins as a value; of floats and truths that are known see `varying`."""
        if isinstance(initial, float | int):
            raise TypeError(
                f"a variable begins as a value of the code, not {initial!r}; see varying"
            )
        return Variable(self, initial)

    def varying(self, initial: float | bool) -> Variable[Number]:
        """A variable that begins as a number that is known, in every lane."""
        return Variable(self, self.constant(initial))

    def room(self, count: int, name: str = "room") -> Memory:
        """Memory for so many numbers of every lane, until the function gives back."""
        aligned = min(8 * self.lanes, _WIDEST)
        place = self.reserve(f"[{count} x {packed('double', self.lanes)}]", aligned)
        where = Address(self, place)
        return Memory(self, where, length=count, step=self.lanes, alignment=aligned, name=name)

    def memory(
        self,
        address: Address,
        *,
        length: Whole | int | None = None,
        step: Whole | int | None = None,
        runs: Runs = Runs.BESIDE,
        apart: Whole | int = 1,
        alignment: int = 8,
        name: str = "memory",
    ) -> Memory:
        """Memory of numbers at an address; see `Memory`.

        Without a step, numbers lie next to each other: pack by pack where runs do.
        """
        if step is None:
            step = self.lanes if runs is Runs.BESIDE else 1
        return Memory(
            self,
            address,
            length=length,
            step=step,
            runs=runs,
            apart=apart,
            alignment=alignment,
            name=name,
        )

    def wholes(
        self, address: Address, length: Whole | int | None = None, name: str = "wholes"
    ) -> Cells[Whole]:
        """Memory of whole numbers of 64 bits."""
        return Cells(self, address, Whole, length, name)

    def truths(
        self, address: Address, length: Whole | int | None = None, name: str = "truths"
    ) -> Cells[Number]:
        """Memory of truths, of a byte each, as of NumPy's bool."""
        return Cells(self, address, Number, length, name)

    def addresses(
        self, address: Address, length: Whole | int | None = None, name: str = "addresses"
    ) -> Cells[Address]:
        """Memory of addresses."""
        return Cells(self, address, Address, length, name)

    def some(self, truth: Number) -> Number:
        """Whether a truth holds in some lane."""
        return self._together(truth, "ne", 0)

    def every(self, truth: Number) -> Number:
        """Whether a truth holds in every lane."""
        return self._together(truth, "eq", -1)

    def bits(self, truth: Number) -> Whole:
        """The whole number whose bit k is the truth of lane k."""
        truth, bits = truth.as_truth(), f"i{truth.lanes}"
        found = truth.text
        if truth.lanes > 1:
            found = self.value(f"bitcast {truth.kind} {found} to {bits}")
        return Whole(self, self.value(f"zext {bits} {found} to i64"))

    def spread(self, number: Number, lanes: int) -> Number:
        """The pack that has a number of one lane in each."""
        one, kind = number.kind, packed(number.kind, lanes)
        if not number.text.startswith("%"):
            return Number(self, f"splat ({one} {number.text})", lanes, number.truth)
        first = self.value(f"insertelement {kind} poison, {one} {number.text}, i64 0")
        same = f"{kind} {first}, {kind} poison, <{lanes} x i32> zeroinitializer"
        return Number(self, self.value(f"shufflevector {same}"), lanes, number.truth)

    def rounded(self, number: Number) -> Whole:
        """The whole number of a float of one lane; see `Number.whole`."""
        if number.lanes > 1:
            raise TypeError("a whole number is made of one lane; name it by lane(k)")
        self.module.declare("declare i64 @llvm.fptosi.sat.i64.f64(double)")
        found = self.value(f"call i64 @llvm.fptosi.sat.i64.f64(double {number.number().text})")
        return Whole(self, found)

    def applied(self, name: str, number: Number, *others: Operand) -> Number:
        """The operation of this NumPy name on numbers."""
        return OPERATIONS[name](number, *others)

    def intrinsic(self, name: str, number: Number, *others: Operand) -> Number:
        """The function of LLVM's own on numbers."""
        given = [number.number(), *(constant(self, other).number() for other in others)]
        lanes = max(each.lanes for each in given)
        given = [each.spread(lanes) for each in given]
        kind, size = given[0].kind, f"v{lanes}" if lanes > 1 else ""
        return self.from_outside(f"llvm.{name}.{size}f64", given, kind, "")

    def from_outside(self, symbol: str, given: list[Number], kind: str, ending: str) -> Number:
        """The value of a function beyond the module, of numbers of its own kind."""
        kinds = ", ".join([kind] * len(given))
        self.module.declare(f"declare {kind} @{symbol}({kinds}) {ending}".rstrip())
        values = ", ".join(f"{kind} {each.text}" for each in given)
        return given[0].like(f"call {kind} @{symbol}({values})")

    # What runs, and how often

    @contextmanager
    def loop(
        self, count: Whole | int, first: Whole | int = 0, *, down: bool = False
    ) -> Iterator[Whole]:
        """The code inside runs for each whole number from `first` to below `count`."""
        head, body, after, end = self.labels("head", "body", "next", "end")
        start = self.whole(count) - 1 if down else self.whole(first)
        place = self.variable(start)
        self.to(head)
        self.begin(head)
        now = place.get()
        goes = now >= self.whole(first) if down else now < self.whole(count)
        self.fork(goes.text, body, end)
        self.begin(body)
        self._ends.append(end)
        yield now
        self._ends.pop()
        self.to(after)
        self.begin(after)
        place.set(now + (-1 if down else 1))
        self.to(head)
        self.begin(end)

    def leave_when(self, truth: Number) -> None:
        """End the innermost loop here, where a truth of one lane holds."""
        (on,) = self.labels("on")
        self.fork(self._decision(truth), self._end(), on)
        self.begin(on)

    def leave_unless(self, truth: Number) -> None:
        """End the innermost loop here, unless a truth of one lane holds."""
        self.leave_when(~truth)

    def leave(self) -> None:
        """End the innermost loop here."""
        self.to(self._end())
        self.begin(*self.labels("beyond"))

    @contextmanager
    def when(self, truth: Number) -> Iterator[None]:
        """The code inside runs where a truth of one lane holds; `otherwise` may follow it."""
        yes, no, after = self.labels("yes", "no", "after")
        self.fork(self._decision(truth), yes, no)
        self.begin(yes)
        yield
        self.to(after)
        self.begin(no)
        self.to(after)
        self.begin(after)
        self._choice = (self.place(), no, after)

    @contextmanager
    def otherwise(self) -> Iterator[None]:
        """The code inside runs where that of the `when` right before it does not."""
        if self._choice is None or self._choice[0] != self.place():
            raise ValueError("`otherwise` follows right after `when`, with no code between")
        _, no, after = self._choice
        self.forget(3)  # of the empty branch that stood for this one
        self.begin(no)
        yield
        self.to(after)
        self.begin(after)
        self._choice = None

    # Functions

    def call(self, other: Code, *given: Value | float | bool) -> Any:
        """The value of another function of the module."""
        if len(given) != len(other.kinds):
            raise TypeError(f"{other.name} takes {len(other.kinds)} arguments, not {len(given)}")
        if other.lanes != self.lanes and Kind.PACK in (*other.kinds, other.result):
            raise TypeError(f"{other.name} is of {other.lanes} lanes, {self.name} of {self.lanes}")
        pairs = zip(other.arguments, given, strict=True)
        return self._called(other.symbol, [self.operand(*pair) for pair in pairs], other.result)

    def call_at(self, address: Address, *given: Value, result: Kind | None = None) -> Any:
        """The value of the function at an address, of arguments as C passes them."""
        return self._called(address.text, list(given), result)

    def give(self, value: Value | float | bool | None = None) -> None:
        """End the function here, with a value where it has one."""
        self._gives = True
        if self.result is None:
            self.line("ret void")
        else:
            like = self._opened(self.result, "")
            given = self.operand(like, value)
            self.line(f"ret {like.kind} {given.text}")
        self.begin(*self.labels("beyond"))

    def operand(self, like: Value, value: Any) -> Any:
        """A value as one of the kind of another."""
        if isinstance(like, Number):
            number = constant(self, value)
            number = number.as_truth() if like.truth else number.number()
            return number.spread(like.lanes)
        value = self.whole(value) if isinstance(like, Whole) else value
        if type(value) is not type(like):
            told = f"{type(like).__name__.lower()}, not {type(value).__name__}"
            raise TypeError(f"{self.name}: the value must be of kind {told}")
        return value

    # Text

    def named(self, like: Value, text: str) -> Value:
        """The value of this name, of the kind of another value."""
        if isinstance(like, Number):
            return Number(self, text, like.lanes, like.truth)
        return type(like)(self, text)

    def stop(self, truth: Number, tell: Callable[[], None]) -> None:
        """Give back at once, with zero for a value, where a truth of one lane holds."""
        bad, on = self.labels("bad", "on")
        self.fork(self._decision(truth), bad, on)
        self.begin(bad)
        tell()
        self.line(self._nothing)
        self.begin(on)

    def text(self) -> str:
        """The function in LLVM's assembly language."""
        if self.result is not None and not self._gives:
            raise ValueError(f"{self.name} is to give a {self.result.name.lower()} and gives none")
        return "\n".join((self._heading, *self.written(), self._nothing, "}"))

    @property
    def _nothing(self) -> str:
        if self.result is None:
            return "ret void"
        return f"ret {self.result.written(self.lanes)} zeroinitializer"

    def _returned(self, result: Kind | None) -> str:
        return f"{result.extended} {result.written(self.lanes)}" if result else "void"

    def _opened(self, kind: Kind, text: str) -> Any:
        if kind is ADDRESS:
            return Address(self, text)
        if kind is WHOLE:
            return Whole(self, text)
        lanes = self.lanes if kind is Kind.PACK else 1
        return Number(self, text, lanes, kind is Kind.TRUTH)

    def _called(self, callee: str, given: list[Any], result: Kind | None) -> Any:
        values = ", ".join(
            f"{each.kind} {'zeroext ' if each.kind == 'i1' else ''}{each.text}" for each in given
        )
        call = f"call {self._returned(result)} {callee}({values})"
        if result is None:
            self.line(call)
            return None
        return self._opened(result, self.value(call))

    def _together(self, truth: Number, relation: str, value: int) -> Number:
        truth = truth.as_truth()
        if truth.lanes == 1:
            return truth
        bits = f"i{truth.lanes}"
        found = self.value(f"bitcast {truth.kind} {truth.text} to {bits}")
        return Number(self, self.value(f"icmp {relation} {bits} {found}, {value}"), truth=True)

    def _decision(self, truth: Number) -> str:
        if truth.lanes > 1:
            raise TypeError("code runs by a truth of one lane; ask for some() or every() of a pack")
        return truth.as_truth().text

    def _end(self) -> str:
        if not self._ends:
            raise ValueError(f"{self.name} leaves a loop outside of one")
        return self._ends[-1]
