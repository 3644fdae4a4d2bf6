"""Modules of machine code, written function by function and compiled once."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from typing import TYPE_CHECKING, NamedTuple

from pgm.kernels.machine.emitter.code import Code
from pgm.kernels.machine.emitter.kinds import PACK, Kind
from pgm.kernels.machine.emitter.processor import PROCESSOR
from pgm.kernels.machine.emitter.target import Target

if TYPE_CHECKING:
    from pgm.kernels.machine.emitter.compiled import Compiled

_INLINE = {None: "", True: "alwaysinline ", False: "noinline "}


class Helper(NamedTuple):
    """A function that others of the module share, and whether it is still to be written."""

    code: Code
    fresh: bool


class Module:
    """Functions of machine code, written together and compiled once.

    With `contract`, a product and a sum may be rounded together. With `checked`, memory tests its
    indices and alignments, and `Compiled.callable` raises an IndexError for the first fault. The
    `target` is the machine that it is for.
    """

    def __init__(
        self, *, contract: bool = True, checked: bool = False, target: Target = PROCESSOR
    ) -> None:
        self.contract, self.checked, self.target = contract, checked, target
        self.faults: list[str] = []
        self._functions: dict[str, Code] = {}
        self._helpers: dict[str, Code] = {}
        self._exported: list[Code] = []
        self._declarations: dict[str, None] = {}  # in order, each once
        self._numbers: dict[str, dict[Hashable, int]] = {}

    def function(
        self,
        name: str,
        arguments: Sequence[Kind],
        result: Kind | None = None,
        *,
        lanes: int = 1,
        internal: bool = False,
        inline: bool | None = None,
        disjoint: bool = False,
        waits: bool = False,
    ) -> Code:
        """A new function, to be written.

        An internal one is called by others of the module alone. `inline` says whether it is copied
        to where it is called; by default LLVM weighs it. With `disjoint`, no memory written by way
        of one address is reached by way of another. One that `waits` begins with a `Waiting`.
        """
        if name in self._functions:
            raise ValueError(f"the module has a function {name!r} already")
        if not internal and lanes > 1 and PACK in (*arguments, result):
            raise ValueError(f"{name!r} takes or gives packs: only an internal function can")
        heading = "define internal" if internal else self.target.exported
        ending = f"{_INLINE[inline]}nounwind{' presplitcoroutine' if waits else ''}"
        code = Code(self, name, arguments, result, lanes, heading, ending, disjoint)
        self._functions[name] = code
        if not internal:
            self._exported.append(code)
        return code

    def helper(
        self,
        name: str,
        arguments: Sequence[Kind],
        lanes: int,
        result: Kind | None = PACK,
        *,
        disjoint: bool = False,
    ) -> Helper:
        """The function of this name that others share; fresh at its first call."""
        fresh = name not in self._helpers
        if fresh:
            self._helpers[name] = self.function(
                name,
                arguments,
                result,
                lanes=lanes,
                internal=True,
                inline=False,
                disjoint=disjoint,
            )
        return Helper(self._helpers[name], fresh)

    def declare(self, declaration: str) -> None:
        """Make a function from outside known."""
        self._declarations[declaration] = None

    def number(self, kind: str, thing: Hashable) -> int:
        """The number of a thing among those of its kind, which equal things share."""
        numbers = self._numbers.setdefault(kind, {})
        return numbers.setdefault(thing, len(numbers))

    def text(self) -> str:
        """The module in LLVM's assembly language."""
        return "\n".join((*self._declarations, *(code.text() for code in self._functions.values())))

    def compile(self, level: int = 2) -> Compiled:
        """Compile the functions, at a level of optimisation.

        Level 0 compiles a trace some ten times faster than level 2 and runs some 15 % slower;
        level 1 takes half the time, and runs straight lines as fast. From level 2 on, LLVM
        inlines by its own judgement and takes out of loops what stays the same in them.
        """
        from pgm.kernels.machine.emitter.compiled import Compiled

        signatures = {code.name: (code.kinds, code.result) for code in self._exported}
        return Compiled(self.text(), signatures, self.faults, level)
