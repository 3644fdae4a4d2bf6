"""The rows at which a sensor's measurement has a belief that does not know its own value."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pgm.compile import SliceLayout
from pgm.errors import EvidenceError
from pgm.evidence import BoundEvidence, Reading
from pgm.kernels.arrays import Array, Integers, Mask
from pgm.variables import Variable


def where_unread(
    unread: Sequence[Reading], layout: SliceLayout, variable: Variable
) -> Reading | None:
    """A sensor at all steps where it may be forecast, as `BoundEvidence.unread` has it.

    They begin at step 1 where a hidden parent is none of the states. None if its readings have all
    rows, or values of its observed parents are not known.
    """
    for reading in unread:
        if reading.cpd.child == variable:
            slice_ = set(layout.slice)
            stands = {v for v in reading.cpd.parents if v in slice_} <= set(layout.states)
            if stands or not reading.step.size or reading.step[0]:
                return reading
            return replace(
                reading,
                step=reading.step[1:],
                order=reading.order[1:] - 1,
                values=reading.values[1:],
                taken=reading.taken[1:],
                inputs={v: values[1:] for v, values in reading.inputs.items()},
            )
    return None


def read_by(bound: BoundEvidence, variable: Variable) -> Reading | None:
    """The readings of a sensor, ``z`` or ``z.at(3)``; None if it has no evidence."""
    template = variable.template
    return next((each for each in bound.readings if each.cpd.child == template), None)


def rows_of(
    bound: BoundEvidence, layout: SliceLayout, variable: Variable
) -> tuple[Reading, Integers]:
    """The measurements of a sensor that have beliefs, and their rows in the order of the evidence.

    Of ``z.at(3)`` that is the one row of the step. An EvidenceError refuses a sensor whose observed
    parents are not known.
    """
    reading = where_unread(bound.unread, layout, variable.template)
    reading = read_by(bound, variable) if reading is None else reading
    if reading is None:
        raise untold(layout, variable.template)
    rows = np.argsort(reading.order)
    if variable.step is not None:
        rows = rows[[one_row(reading.step[rows], variable)]]
    return reading, rows


def one_row(steps: Integers, variable: Variable) -> int:
    """The row of ``z.at(3)`` among the `steps` of rows; an EvidenceError unless there is one."""
    rows = np.flatnonzero(steps == variable.step)
    if rows.size == 1:
        return int(rows[0])
    name, step = variable.template.name, variable.step
    if rows.size:
        text = f"there are {rows.size} sightings; ask for {name}, whose rows are sightings"
    elif steps.size:
        text = (
            f"there is no row of it: those of {name} are of steps {steps.min()}..{steps.max()}. "
            "Where values of observed parents are given with sightings, a sighting of NaN tells "
            "them at a step where nothing was read"
        )
    else:
        text = "there are no rows of it"
    raise EvidenceError(f"{variable!r}: at step {step} {text}", variable=variable, step=step)


def require_unread(
    variable: Variable, step: Integers, taken: Mask, *, residuals: bool = False
) -> None:
    """Refuse a measurement, ``z`` or ``z.at(3)``, of which some run read a component.

    `step` (rows,) are the steps of its readings, and `taken` (rows, runs or 1, d) marks those read.
    With `residuals` the posterior has innovations, too.
    """
    steps = step[taken.any(axis=(1, 2))]
    if not steps.size or (variable.step is not None and variable.step not in steps):
        return
    name = variable.template.name
    at = f"at steps {steps.min()}..{steps.max()}" if variable.step is None else "there"
    raise EvidenceError(
        f"{variable!r} has evidence {at}, and so no belief: posterior.predicted[{name}] has the "
        f"belief before each reading is taken, "
        + f"posterior.innovations[{name}] how far off it was, " * residuals
        + f"and {name}.at(t) is of one step, where nothing was read",
        variable=variable,
        step=variable.step,
    )


def as_read(
    step: Integers, order: Integers, values: Array, lead: tuple[int, ...]
) -> tuple[Integers, Array]:
    """Readings (M, runs or 1, d) sorted by step in the order of the evidence, (*lead, M, d).

    Row k came from row order[k] of the evidence.
    """
    rows = np.argsort(order)
    wide = np.broadcast_to(values, (len(step), math.prod(lead), values.shape[-1]))[rows]
    return step[rows], np.moveaxis(wide, 0, 1).reshape(*lead, *wide.shape[::2])


def no_readings(variable: Variable, lead: tuple[int, ...]) -> tuple[Integers, Array]:
    """The steps and values of the readings of a sensor without evidence, as of `as_read`."""
    return np.empty(0, dtype=np.intp), np.empty((*lead, 0, variable.dimension))


def untold(layout: SliceLayout, variable: Variable) -> EvidenceError:
    """The error for a sensor without forecasts, since observed parents are not known."""
    cpd = next(cpd for cpd in layout.model.observation if cpd.child == variable)
    slice_ = set(layout.slice)
    lacking = [parent for parent in cpd.parents if parent.template not in slice_]
    return EvidenceError(
        f"{variable!r} has no belief, as evidence does not tell its observed parents {lacking} at "
        f"all steps: give them at the top level, or in sightings of NaN, "
        f"pgm.sightings(values, step=, given={{{lacking[0].name}: ...}})",
        variable=variable,
        cpd=cpd,
    )
