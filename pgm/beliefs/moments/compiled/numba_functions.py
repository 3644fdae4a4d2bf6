"""Functions of CPDs in machine code, by their addresses."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from pgm.linearisers import FunctionTemplate
from pgm.tracing import Program
from pgm.tracing.compiled import compiled as machine_code


class Functions(NamedTuple):
    """The addresses of a CPD's function, by itself and with its derivative.

    Both are called as ``f(x, u, apart, value, slope)``, with the stacked hidden parents x and the
    stacked others u; rows of the derivative of one run are padded with zeros to whole fours, as
    kernels have them. `kept` keeps both in memory; they may be one, where the function by itself is
    hardly called. `trace` is of the function together with the derivatives that were given.
    """

    value: int
    slope: int
    kept: tuple[Any, ...]
    trace: Program


def compiled(
    template: FunctionTemplate,
    trace: Program,
    before: Functions | None,
    *,
    alone: bool,
    together: bool = False,
) -> Functions:
    """Compile a function, if its trace is not that of before.

    `alone` says whether its values are needed by themselves, as on points; `together`, whether it
    is of packs of runs.
    """
    if before and before.trace is trace and (not alone or len(before.kept) > 1):
        return before
    program = _program(template, trace, per_row=1 if together else 4)
    kept = [machine_code(program, together=together)]
    if alone:
        kept.append(machine_code(replace(program, slope=()), together=together))
    return Functions(kept[-1].address, kept[0].address, tuple(kept), trace)


def _program(template: FunctionTemplate, trace: Program, per_row: int) -> Program:
    """The value and the whole derivative: given parts from the trace, and its own of the rest."""
    height, size = template.height, template.size
    alone = trace.by(template.missing_columns, height)
    slope = np.full((height, size + -size % per_row), None)
    slope[:, template.missing] = np.reshape(np.array(alone.slope), (height, -1))
    first = height
    for _, width, place, jacobian in template.derivatives:
        if jacobian is not None:
            given = np.reshape(trace.value[first : first + height * width], (height, width))
            slope[:, place], first = given, first + height * width
    return replace(alone, columns=template.columns, slope=tuple(slope.ravel().tolist()))
