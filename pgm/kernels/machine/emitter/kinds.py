"""Kinds of values that functions of machine code take and give."""

from __future__ import annotations

import ctypes
from enum import Enum
from typing import Any


class Kind(Enum):
    """A kind of value: its type in LLVM and in ctypes."""

    ADDRESS = ("ptr", ctypes.c_void_p)
    WHOLE = ("i64", ctypes.c_int64)
    FLOAT = ("double", ctypes.c_double)
    TRUTH = ("i1", ctypes.c_bool)
    # A float of each lane; between functions of one module alone, but where there is one lane.
    PACK = ("pack", ctypes.c_double)

    def written(self, lanes: int) -> str:
        """The type in LLVM, in a function of so many lanes."""
        return packed("double", lanes) if self is Kind.PACK else str(self.value[0])

    @property
    def extended(self) -> str:
        """The mark of an argument or result that fills a register with zeros, as C's bool does."""
        return "zeroext" if self is Kind.TRUTH else ""

    @property
    def in_c(self) -> Any:
        """The type in ctypes."""
        return self.value[1]


ADDRESS, WHOLE, FLOAT, TRUTH, PACK = Kind


def packed(scalar: str, lanes: int) -> str:
    """The type in LLVM of so many scalars side by side."""
    return scalar if lanes == 1 else f"<{lanes} x {scalar}>"


def symbol(name: str) -> str:
    """The name of a function for the linker, apart from those of C; assemblers of cards know it."""
    return f"pgm_{name}"
