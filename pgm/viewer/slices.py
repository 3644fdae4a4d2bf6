"""The parts that the page of every chain has: its slices and its evidence."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from pgm.compile import DynamicGraph
from pgm.evidence import Reading
from pgm.inference.kind import Kind
from pgm.kernels.arrays import Array, Integers
from pgm.variables import Variable
from pgm.viewer.numbers import Numbers
from pgm.viewer.words import cpd, variable


def head(
    graph: DynamicGraph, kind: Kind, span: range, hidden: Iterable[Variable]
) -> dict[str, Any]:
    """The chain itself for the page: steps, variables and CPDs, without a belief."""
    model, states = graph.model, graph.layout.states
    return {
        "kind": "chain",
        "about": str(kind),
        "steps": {"first": span[0], "last": span[-1], "end": graph.steps},
        "variables": [variable(v) | {"state": v in states} for v in hidden],
        "prior": [cpd(each) for each in model.prior],
        "transition": [cpd(each) for each in model.transition],
        "inputs": [v.name for v in model.inputs],
    }


def sighted(
    numbers: Numbers,
    sensors: Mapping[Any, tuple[Integers, Array, Mapping[Variable, Array]]],
    span: range,
    run: int,
) -> list[dict[str, Any]]:
    """The measurements of the steps shown in one run, by sensor.

    sensors: The step of each measurement, (M,) ascending, its values, (M, runs or 1, d), and those
        of its observed parents.
    """
    found = []
    for sensor, (step, values, inputs) in sensors.items():
        first, last = np.searchsorted(step, [span[0], span[-1] + 1])
        if first == last:
            continue

        def own(rows: Array) -> Array:
            """The rows of this run and these steps."""
            return rows[first:last, run if rows.shape[1] > 1 else 0].astype(np.float64)  # noqa: B023 - called at once

        found.append(
            {
                "cpd": cpd(sensor),
                "child": variable(sensor.child),
                "step": numbers.add(step[first:last, None].astype(np.float64)),
                "values": numbers.add(own(values)),
                "given": [
                    {"components": list(v.components), "values": numbers.add(own(rows))}
                    for v, rows in inputs.items()
                    if v.dimension > 1
                ],
            }
        )
    return found


def readings(
    given: Iterable[Reading],
) -> dict[Any, tuple[Integers, Array, Mapping[Variable, Array]]]:
    """The measurements of sensors as evidence holds them; missing components are NaN."""
    found = {}
    for each in given:
        values = each.values.astype(np.float64)
        if each.taken.shape[-1] == values.shape[-1]:
            values = np.where(each.taken, values, np.nan)
        found[each.cpd] = each.step, values, each.inputs
    return found
