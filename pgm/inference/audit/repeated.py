"""A chain with each of its runs several times, so that smoothers from many starts are one call.

The array of a CPD is (rows, runs, ...), or (rows, 1, ...) if it is the same for all runs. Rows are
the steps of a transition, the measurements of a sensor, or, in a network without time, the CPD's
copies.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from pgm.beliefs.moments.steps.plan import ChainPlan, Link
from pgm.kernels.arrays import Kind
from pgm.linearisation.family import Family
from pgm.linearisers import TAYLOR


def repeated(plan: ChainPlan, count: int) -> ChainPlan:
    """The plan of a chain with all its runs one after another, `count` times.

    Run r of copy c becomes run c · runs + r. Arrays that are the same for all runs are shared.
    Nonlinear CPDs without a lineariser of their own are expanded to first order, so that the steps
    of a smoother can be controlled by their cost. Measurements that gates have rejected stay
    rejected.
    """
    runs = plan.runs

    def links(every: list[Link]) -> list[Link]:
        return [replace(link, family=of_family(link.family, count, runs)) for link in every]

    sensors = [
        replace(
            sensor,
            family=of_family(sensor.family, count, runs),
            taken=None if sensor.taken is None else tiled(sensor.taken, count),
            values=tiled(sensor.values, count),
            gated=None,
            cross={},
        )
        for sensor in plan.sensors
    ]
    return replace(
        plan,
        lead=(count * runs,),
        prior=links(plan.prior),
        transition=links(plan.transition),
        sensors=sensors,
    )


def of_family(family: Family, count: int, runs: int) -> Family:
    """A family, a CPD at its rows, with all its runs `count` times, not linearised yet.

    `runs` is the number of runs of the family; run r of copy c becomes run c · runs + r. A
    nonlinear CPD without a lineariser of its own is to be expanded to first order.
    """
    rows, _, height, width = family.shape
    own = tiled(family.own_noise, count)
    total = count * runs
    made = replace(
        family,
        inputs={parent: tiled(values, count) for parent, values in family.inputs.items()},
        own_noise=own,
        lineariser=getattr(family.cpd, "lineariser", None) or TAYLOR,
        batch=() if total == 1 else (total,),
        approximate=False,
    )
    made.noise = np.broadcast_to(own, (rows, total, height, height))
    if family.exact:
        constant, shift = family.affine
        shift = tiled(shift, count)
        constant = tiled(constant, count) if constant.ndim == 4 else constant
        made.affine = constant, shift
        slope = constant if constant.ndim == 4 else constant[..., None, :, :]
        made.matrix = np.broadcast_to(slope, (rows, total, height, width))
        made.offset = np.broadcast_to(shift, (rows, total, height))
    return made


def tiled(array: npt.NDArray[Kind], count: int) -> npt.NDArray[Kind]:
    """An array (rows, runs, ...) with its runs `count` times; (rows, 1, ...) stays as it is."""
    if array.shape[1] == 1:
        return array
    return np.concatenate([array] * count, axis=1)
