"""Functions of CPDs in machine code, by their addresses."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from pgm.linearisers import FunctionTemplate


class Functions(NamedTuple):
    """A CPD's function, by itself and with its derivative: ``f(x, u, value, slope)``.

    Both take the stacked hidden parents and the stacked others; `kept` keeps them in memory.
    """

    value: int
    slope: int
    kept: tuple[Any, ...]


def sources(template: FunctionTemplate) -> tuple[str, str] | str:
    """The code of a function, alone and with its derivative; a reason, where there is none."""
    return "not traced"


def compiled(template: FunctionTemplate) -> Functions | str:
    """Compile a function; a reason, where that cannot be."""
    found = sources(template)
    if isinstance(found, str):
        return found
    value, slope = map(_compiled, found)
    return Functions(value.address, slope.address, (value, slope))


def _compiled(source: str) -> Any:
    from numba import cfunc, types

    numbers = types.CPointer(types.float64)
    names: dict[str, Any] = {name: getattr(math, name) for name in dir(math)}
    exec(compile(source, "<a function of a CPD>", "exec"), names)
    made = cfunc(types.void(numbers, numbers, numbers, numbers), error_model="numpy")
    return made(names["pointer"])
