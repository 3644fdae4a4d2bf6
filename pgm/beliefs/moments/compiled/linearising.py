"""How CPDs are linearised: by their traced function, by its values at points, or by NumPy."""

from __future__ import annotations

from typing import Any

import numpy as np

from pgm.beliefs.moments.compiled.called import Call, Lines
from pgm.beliefs.moments.compiled.functions import function_of, points_of
from pgm.beliefs.moments.compiled.groups import Group, GroupCall, GroupLines, together, widened
from pgm.beliefs.moments.compiled.table import Get, Table
from pgm.kernels.machine.sweeps import told
from pgm.linearisation.family import Family
from pgm.variables import Variable

# Components of which differences are worth their code.
_FEW = 12


def linearising_of(family: Family, table: Table, held: int) -> dict[str, Any]:
    """A CPD's linearisation, as attributes of its `told.Row`."""
    rule, template = points_of(family), family.template
    assert template is not None
    if isinstance(rule, str):
        return {"called": _by_numpy(Lines(family, held), table, rule)}
    answers = family.compiled or family.trace_whole()
    if not isinstance(answers, str):
        inputs = tuple(
            table.of(family, _input(parent))
            for parent, place in zip(template.given, template.places, strict=True)
            if place is None
        )
        function = function_of(template, answers.trace)
        return {"function": function, "points": rule, "inputs": inputs}
    few = template.size <= _FEW and (rule is not None or len(template.numerical) == template.size)
    if not few:
        return {"called": _by_numpy(Lines(family, held), table, answers)}
    call = Call(family, _most_points(family, rule), held)
    return {"called": _by_values(call, rule, table, held, answers), "points": rule}


def joint_linearising_of(group: Group, table: Table) -> dict[str, Any]:
    """The linearisation of the sightings of a step together, likewise."""
    family, template = group.family, group.family.template
    assert template is not None
    rule, answers = points_of(family), family.compiled or family.trace_whole()
    if isinstance(rule, str):
        return {"called": _by_numpy(GroupLines(group), table, rule)}
    assert rule is not None
    points = widened(rule, group.most)
    if not isinstance(answers, str):
        function = function_of(template, answers.trace)
        inputs = tuple(
            table.of(group, _inputs(parent))
            for parent, place in zip(template.given, template.places, strict=True)
            if place is None
        )
        function = together(function, answers.trace.widths, group.most)
        return {"function": function, "points": points, "inputs": inputs}
    if template.size > _FEW:
        return {"called": _by_numpy(GroupLines(group), table, answers)}
    call = GroupCall(group, _most_points(family, rule))
    return {"called": _by_values(call, rule, table, 1, answers), "points": points}


def _by_numpy(call: Lines, table: Table, why: str) -> told.Called:
    """A CPD that is linearised by NumPy, and why."""
    cov, value, matrix = map(table.by_runs, (call.cov, call.value, call.matrix))
    error = None if call.error is None else table.by_runs(call.error)
    lines = told.Lines(cov, value, matrix, error, table.array(np.ones((1, 1, 1))))
    return table.called(call, lines, why)


def _by_values(
    call: Call, rule: told.Points | None, table: Table, held: int, why: str
) -> told.Called:
    """A CPD that is linearised by values of its function at points, and why."""
    height, size, runs = call.told.shape[2], *call.points.shape[1:]
    own = (height,), (height, size), (height, height), (1,)
    cells = [table.by_runs(np.zeros((held, *each, runs))) for each in own]
    value, matrix, error, sure = cells
    lines = told.Lines(None, value, matrix, None if rule is None else error, sure)
    return table.called(call, lines, why)


def _most_points(family: Family, rule: told.Points | None) -> int:
    """At how many points a function is called at most, to be linearised by a rule.

    Differences are of four points for each component, beside the mean, which stands before those of
    a rule too.
    """
    return max(4 * family.shape[3], 0 if rule is None else len(rule.points)) + 1


def _input(parent: Variable) -> Get:
    return lambda family: family.inputs[parent]


def _inputs(parent: Variable) -> Get:
    return lambda group: group.inputs(parent)
