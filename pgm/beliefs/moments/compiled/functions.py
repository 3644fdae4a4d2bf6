"""Functions of CPDs, and the points of their rules, as machine code is told of them."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np

from pgm.compile.machine import rule_told
from pgm.cpds import RobustNoise
from pgm.cpds.radius import kept
from pgm.kernels.arrays import Array
from pgm.kernels.machine.emitter.functions import Function
from pgm.kernels.machine.sweeps import told
from pgm.linearisation.family import Family
from pgm.linearisers import FunctionTemplate, Taylor
from pgm.linearisers.points import Points
from pgm.linearisers.regression import StatisticalRegression
from pgm.tracing import Program, Tracer
from pgm.tracing.program import Column

# Entries of a regression that are rounding of zero, as a part of the largest of their row.
_NOTHING = 1e-15


def function_of(template: FunctionTemplate, trace: Program) -> Function:
    """A function with its whole derivative: given parts from the trace, and its own of the rest.

    `trace` is that of the value, followed by the derivatives that were given.
    """
    known: Function | None = template.compiled.get(trace)
    if known is None:
        known = template.compiled[trace] = _function(template, trace)
    return known


def _function(template: FunctionTemplate, trace: Program) -> Function:
    height, size = template.height, template.size
    alone = trace.by(template.missing_columns, height)
    slope = np.full((height, size), None)
    for i in range(height):
        for j, column in enumerate(template.missing):
            slope[i, column] = alone.slope[i * len(template.missing) + j]
    first = height
    for _, width, place, jacobian in template.derivatives:
        if jacobian is not None:
            for i in range(height):
                slope[i, place] = trace.value[first + i * width : first + (i + 1) * width]
            first += height * width
    flat = slope.ravel().tolist()
    every = [(a, i) for a, width in enumerate(trace.widths) for i in range(width)]
    observed = tuple(column for column in every if column not in template.columns)
    return _told_function(alone, alone.value[:height], flat, template.columns, observed)


def _told_function(
    program: Program,
    value: Sequence[int],
    slope: Sequence[int | None],
    hidden: Sequence[Column],
    observed: Sequence[Column],
) -> Function:
    """Some operations of a program, without those on which they do not depend."""
    order = program.graph.reachable([*value, *(k for k in slope if k is not None)])
    new = {number: k for k, number in enumerate(order)}
    operations = []
    for number in order:
        name, *operands = program.graph.operations[number]
        plain = name in ("constant", "input")
        operations.append((name, *(operands if plain else (new[k] for k in operands))))
    return Function(
        tuple(operations),
        tuple(new[k] for k in value),
        tuple(None if k is None else new[k] for k in slope),
        tuple(hidden),
        tuple(observed),
    )


@kept
def loss_of(noise: RobustNoise, count: int) -> tuple[Function, ...] | str:
    """Of sightings of so many components w(s), the surplus of s and w, and 2 ρ(s); or why not."""

    def weight(square: Array) -> Array:
        return noise.weight(square, count)

    def surplus(square: Array, weight: Array) -> Array:
        return noise.surplus(square, count, weight)

    def cost(square: Array) -> Array:
        return 2.0 * noise.loss(square, count)

    found = []
    each: list[tuple[Any, tuple[int, ...]]] = [(weight, (1,)), (surplus, (1, 1)), (cost, (1,))]
    for k, (function, widths) in enumerate(each):
        if not count:  # nothing was measured
            function = _NOTHING_MEASURED[k]
        program = Tracer(function, widths, np.zeros(1, dtype=bool)).traced()
        if isinstance(program, str):
            return program
        inputs = tuple((k, 0) for k in range(len(widths)))
        found.append(_told_function(program, program.value, (), inputs, ()))
    return tuple(found)


# The same of a sighting without measured components.
_NOTHING_MEASURED = (lambda s: 0.0 * s + 1.0), (lambda s, w: 0.0 * s), (lambda s: 0.0 * s)


def points_of(family: Family) -> told.Points | str | None:
    """The points by which a CPD is linearised, None of `Taylor`; or why they are not compiled."""
    template, rule = family.template, family.lineariser
    assert template is not None
    if not family.hidden or type(rule) is Taylor:
        return None
    why = rule_told(rule, template)
    if why is not None:
        return why
    assert isinstance(rule, StatisticalRegression)
    return _points(rule, template.size, template.child.name, template.variances)


@lru_cache(maxsize=256)
def _points(
    rule: StatisticalRegression, size: int, name: str, variances: Sequence[float]
) -> told.Points:
    points: Points = rule.points(size, name, 0)
    fit = points.fit
    mean, slope, rest = (_told(_cleared(each.array)) for each in fit[:3])
    signs = () if fit.signs is None else tuple(fit.signs.diagonal)
    return told.Points(
        _told(points.points),
        mean,
        slope,
        rest,
        signs,
        points.centred,
        points.fitted_rounding,
        tuple(map(float, variances)),
    )


def _cleared(matrix: Array) -> Array:
    """The matrix, with zeros for entries that are rounding of their row."""
    size = np.abs(matrix)
    found: Array = np.where(size > _NOTHING * size.max(axis=1, keepdims=True), matrix, 0.0)
    return found


def _told(matrix: Array) -> told.Rows:
    return tuple(tuple(row) for row in matrix.tolist())
