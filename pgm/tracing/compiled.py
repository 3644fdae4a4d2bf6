"""Programs compiled by Numba, for code that is compiled itself and calls them by address."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any

import numpy as np

from pgm.tracing.operations import IN_C, SCALAR
from pgm.tracing.program import Program, made

# LLVM has these as instructions, or C has them: they return what NumPy's do.
_OF_MATH = ("sqrt", "sin", "cos", "tan", "exp", "log", "hypot", "copysign")


def compiled(program: Program, *, together: bool = False) -> Any:
    """A C function of pointers: x (n,), u, the floats between runs in u, value (d,), slope (d n,).

    Parameters
    ----------
    program : Program
    together : bool
        Whether x, value and slope are of packs of runs, in place of floats.

    Returns
    -------
    numba.core.ccallback.CFunc
        Its ``address`` is what compiled code calls; keep it as long as that is used.

    Raises
    ------
    ImportError
        Where Numba is not installed.
    """
    return _compiled(program.pointer_source, together)


@lru_cache(maxsize=256)
def _compiled(source: str, together: bool) -> Any:
    from numba import cfunc, types

    from pgm.kernels.compiled import packs
    from pgm.kernels.compiled.memory import take

    if together:
        names = {name: packs.of_c(*own) for name, own in IN_C.items()}
        names |= {"sqrt": math.sqrt, "floor": packs.floor, "ceil": packs.ceil}
        names |= {"trunc": packs.trunc, "rint": packs.whole}
    else:
        names = {name: getattr(np, name) for name in SCALAR}
        names |= {name: getattr(math, name) for name in _OF_MATH}
    names |= {"where": packs.where, "opposite": packs.opposite, "take": take}
    kind = packs.Packs(packs.RUN_PACK) if together else packs.NUMBERS
    signature = types.void(kind, packs.NUMBERS, types.int64, kind, kind)
    return cfunc(signature, error_model="numpy")(made(source, "pointer", names))
