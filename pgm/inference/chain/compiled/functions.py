"""Functions of CPDs in machine code, by their addresses."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from pgm.linearisers import FunctionTemplate
from pgm.tracing import Program, Trace, Tracer
from pgm.tracing.compiled import compiled as machine_code
from pgm.tracing.derivatives import derivatives


class Functions(NamedTuple):
    """A CPD's function, by itself and with its derivative: ``f(x, u, value, slope)``.

    Both take the stacked hidden parents and the stacked others; rows of the derivative are padded
    with zeros to whole fours, as kernels have them. `kept` keeps both in memory.
    `tracer` and `trace` are of the function together with the derivatives that were given.
    """

    value: int
    slope: int
    kept: tuple[Any, ...]
    tracer: Tracer
    trace: Trace


def compiled(template: FunctionTemplate, before: object = None) -> Functions | str:
    """Compile a function, if it is not as it was before; a reason, where that cannot be."""
    tracer = before.tracer if isinstance(before, Functions) else _tracer(template)
    if not tracer.confirm([np.zeros(parent.dimension) for parent in template.given]):
        return tracer.reason or "not traced"
    assert tracer.trace is not None
    if isinstance(before, Functions) and before.trace is tracer.trace:
        return before
    program = _program(template, tracer.trace)
    slope, value = machine_code(program), machine_code(replace(program, slope=()))
    return Functions(value.address, slope.address, (value, slope), tracer, tracer.trace)


def _tracer(template: FunctionTemplate) -> Tracer:
    """Of the function, its value followed by the derivatives that were given."""
    given = [
        jacobian
        for jacobian, place in zip(template.jacobians, template.places, strict=True)
        if jacobian is not None and place is not None
    ]

    def joined(*arguments: Any) -> Any:
        slopes = [jacobian(*arguments) for jacobian in given]
        flat = [slope.reshape(*slope.shape[:-2], -1) for slope in slopes]
        return np.concatenate([template.function(*arguments), *flat], axis=-1)

    more = template.height * (template.size - len(template.missing))
    angles = np.concatenate([template.angles, np.zeros(more, dtype=bool)])
    return Tracer(joined, [parent.dimension for parent in template.given], angles)


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
