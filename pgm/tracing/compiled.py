"""Programs compiled by Numba, for code that is compiled itself and calls them by address."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any

import numpy as np

from pgm.tracing.operations import SCALAR
from pgm.tracing.program import Program, made

# LLVM has these as instructions, or C has them: they return what NumPy's do.
_OF_MATH = ("sqrt", "sin", "cos", "tan", "exp", "log", "hypot", "copysign")


def compiled(program: Program) -> Any:
    """A C function of pointers to float64: x (n,), u, value (d,), slope (d n,), row by row.

    Parameters
    ----------
    program : Program

    Returns
    -------
    numba.core.ccallback.CFunc
        Its ``address`` is what compiled code calls; keep it as long as that is used.

    Raises
    ------
    ImportError
        Where Numba is not installed.
    """
    return _compiled(program.pointer_source)


@lru_cache(maxsize=256)
def _compiled(source: str) -> Any:
    from numba import cfunc

    names = {name: getattr(np, name) for name in SCALAR}
    names |= {name: getattr(math, name) for name in _OF_MATH}
    signature = f"void({', '.join(['CPointer(float64)'] * 4)})"
    return cfunc(signature, error_model="numpy")(made(source, "pointer", names))
