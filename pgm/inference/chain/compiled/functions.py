"""Functions of CPDs in machine code, by their addresses."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from pgm.linearisers import FunctionTemplate
from pgm.tracing import Program, Trace
from pgm.tracing.compiled import compiled as machine_code
from pgm.tracing.derivatives import derivatives


class Functions(NamedTuple):
    """A CPD's function, by itself and with its derivative: ``f(x, u, apart, value, slope)``.

    Both take the stacked hidden parents and the stacked others; rows of the derivative of one run
    are padded with zeros to whole fours, as kernels have them. `kept` keeps both in memory; they
    may be one, where the function by itself is hardly called.
    `trace` is of the function together with the derivatives that were given.
    """

    value: int
    slope: int
    kept: tuple[Any, ...]
    trace: Trace


def compiled(
    template: FunctionTemplate,
    before: Functions | str | None,
    *,
    alone: bool,
    together: bool = False,
) -> Functions | str:
    """Compile a function, if it is not as it was before; a reason, where that cannot be.

    `alone` says whether its values are needed by themselves, as on points; `together`, whether it
    is of packs of runs.
    """
    reason = template.whole_reason
    if reason is not None:
        return reason
    trace = template.whole.trace
    assert trace is not None
    known = isinstance(before, Functions) and before.trace is trace and before
    if known and (not alone or len(known.kept) > 1):
        return known
    program = _program(template, trace, per_row=1 if together else 4)
    kept = [machine_code(program, together=together)]
    if alone:
        kept.append(machine_code(replace(program, slope=()), together=together))
    return Functions(kept[-1].address, kept[0].address, tuple(kept), trace)


def _program(template: FunctionTemplate, trace: Trace, per_row: int) -> Program:
    graph, height = trace.graph.copy(), template.height
    value, known = trace.outputs[:height], iter(trace.outputs[height:])
    inputs = [graph.input(*column) for column in template.columns]
    rows = derivatives(graph, value, inputs)
    slope: list[int | None] = []
    for row in rows:
        slope += [row.get(j) for j in range(template.size)] + [None] * (-template.size % per_row)
    apart = len(slope) // height
    for _, width, place, jacobian in template.derivatives:
        if jacobian is not None:
            columns = np.arange(template.size)[place].tolist()
            for k in range(height * width):
                slope[k // width * apart + columns[k % width]] = next(known)
    return Program(graph, trace.widths, template.columns, value, tuple(slope))
