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
    """A CPD's function, by itself and with its derivative: ``f(x, u, value, slope)``.

    Both take the stacked hidden parents and the stacked others; rows of the derivative are padded
    with zeros to whole fours, as kernels have them. `kept` keeps both in memory.
    `trace` is of the function together with the derivatives that were given.
    """

    value: int
    slope: int
    kept: tuple[Any, ...]
    trace: Trace


def compiled(template: FunctionTemplate, before: object = None) -> Functions | str:
    """Compile a function, if it is not as it was before; a reason, where that cannot be."""
    reason = template.whole_reason
    if reason is not None:
        return reason
    trace = template.whole.trace
    assert trace is not None
    if isinstance(before, Functions) and before.trace is trace:
        return before
    program = _program(template, trace)
    slope, value = machine_code(program), machine_code(replace(program, slope=()))
    return Functions(value.address, slope.address, (value, slope), trace)


def _program(template: FunctionTemplate, trace: Trace) -> Program:
    graph, height = trace.graph.copy(), template.height
    value, known = trace.outputs[:height], iter(trace.outputs[height:])
    inputs = [graph.input(*column) for column in template.columns]
    rows = derivatives(graph, value, inputs)
    slope: list[int | None] = []
    for row in rows:
        slope += [row.get(j) for j in range(template.size)] + [None] * (-template.size % 4)
    apart = len(slope) // height
    for _, width, place, jacobian in template.derivatives:
        if jacobian is not None:
            columns = np.arange(template.size)[place].tolist()
            for k in range(height * width):
                slope[k // width * apart + columns[k % width]] = next(known)
    return Program(graph, trace.widths, template.columns, value, tuple(slope))
