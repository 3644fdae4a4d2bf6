"""Judged sightings of an update of an online filter: decisions of gates, and the watch after them.

A sighting is one measurement of a sensor. A *judged* sighting is one about which a gate, or robust
noise that leaves outliers out, has decided. A `Decided` is a sensor, the record of its gate's
decisions, and the order of its sightings in the evidence. A `Watch` is the test whether the belief
is lost, that is, wrong by more than its covariance says; it counts these decisions and sums up the
innovations. None in its place means that the filter does not watch.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from pgm.beliefs.moments.online.watch import Watch
from pgm.beliefs.moments.outcomes.innovations import by_step
from pgm.beliefs.moments.passes.forward import Forward
from pgm.beliefs.moments.smoothers.fixed_lag import Window
from pgm.beliefs.moments.steps.plan import ChainPlan
from pgm.beliefs.moments.steps.readings import Moments, Reading
from pgm.beliefs.moments.steps.vector import vector
from pgm.kernels import gaussian, mahalanobis
from pgm.kernels.arrays import Array, Integers, Mask
from pgm.posteriors.gate_record import GateRecord
from pgm.posteriors.lost import Read
from pgm.variables import Variable

# A sensor, the decisions of its gate, and the order of its sightings.
Decided = tuple[Variable, GateRecord, Integers]


def of_update(
    watch: Watch | None, parts: Sequence[Reading], squares: Callable[[], tuple[Array, Integers]]
) -> tuple[tuple[Decided, ...], Watch | None]:
    """The gates' decisions about the readings `parts` of an update, and the watch after it.

    The watch takes in the normalised innovation squared νᵀS⁻¹ν and its degrees of freedom, (runs,),
    which `squares` finds: ν is stacked from all measured components that were taken in, with the
    sensors as they were linearised last. Without a `watch` None is returned for it.
    """
    gated = tuple(_decided(part) for part in parts if part.gated is not None)
    if watch is None or not parts:
        return gated, watch
    nis, dof = squares()
    records = iter(gated)
    each = [None if part.gated is None else next(records)[1].judged for part in parts]
    judged = [
        found if part.weights is None else part.weights.judged(found)
        for part, found in zip(parts, each, strict=True)
    ]
    return gated, watch.and_(_read(nis, dof, judged))


def at_moments(parts: Sequence[Reading], known: Moments) -> tuple[Array, Integers]:
    """νᵀS⁻¹ν of the readings of an update, and its degrees of freedom, (runs,).

    `known` are the moments before the update.
    """
    mean, cov = known
    matrix, residual, noise, missing = vector([part.seen for part in parts], mean)
    spread = gaussian.predict(cov, matrix, noise)
    residual = np.broadcast_to(residual, (len(residual), *mean.shape[1:]))
    nis = np.reshape(mahalanobis.squares(residual, spread), -1)
    dof = np.full(nis.shape, len(residual), dtype=np.intp)
    if missing is not None:
        dof -= np.asarray(missing, dtype=np.intp)
    return nis, dof


def at_last(plan: ChainPlan, forward: Forward) -> tuple[Array, Integers]:
    """νᵀS⁻¹ν of the readings of the last step, and its degrees of freedom, (runs,).

    `forward` is the forward pass over the plan, which has its linearisations. Directions of which
    nothing is known, given a flat prior, do not count.
    """
    nis, dof = by_step(plan, plan.read, forward)
    return np.nan_to_num(nis[-1]), dof[-1]


def of_window(watch: Watch | None, window: Window) -> tuple[tuple[Decided, ...], Watch | None]:
    """The decisions of gates at the newest step of a settled window, and the watch after it.

    The window has all measurements of the step. The watch therefore drops its numbers of earlier
    updates of the step, and takes those of the window. Without a `watch` None is returned for it.
    """
    plan, found, judged = window.plan, list[Decided](), list[tuple[Mask, Mask] | None]()
    for sensor in plan.sensors:
        rows = sensor.rows(plan.steps)
        if rows.stop <= rows.start:
            continue
        own = None
        if sensor.gated is not None:
            order = np.argsort(np.argsort(sensor.order[rows]))
            found.append((sensor.variable, sensor.gated.window(rows), order))
            own = found[-1][1].judged
        judged.append(sensor.weights.judged(own, rows) if sensor.robust else own)
    gated = tuple(found)
    if watch is None:
        return gated, None
    return gated, watch._replace(read=_read(*at_last(plan, window.ahead), judged))


def _read(nis: Array, dof: Integers, each: Sequence[tuple[Mask, Mask] | None]) -> Read:
    """The numbers of a step for the test whether the belief is lost.

    `nis` (runs,) is the normalised innovation squared νᵀS⁻¹ν and `dof` (runs,) the number of its
    components. `each` has a pair of masks (k, runs) for each sensor: which of its k sightings were
    rejected, and which were judged; or None where none could be. Both are counted over all sensors.
    """
    rejected, judged = np.zeros_like(dof), np.zeros_like(dof)
    for found in each:
        if found is not None:
            rejected += found[0].sum(axis=0)
            judged += found[1].sum(axis=0)
    return Read(nis, dof, rejected, judged)


def _decided(part: Reading) -> Decided:
    """The decisions of a gate about the M sightings of one sensor, the measurements `part`.

    The result is the sensor, the decisions (M, runs), and the `order` of the sightings: row k of
    the decisions is sighting ``order[k]`` of the evidence.
    """
    assert part.gated is not None
    return decided(part.sensor.variable, part.gate, *part.gated, part.sensor.order)


def decided(
    variable: Variable, gate: float, rejected: Mask, square: Array, order: Integers
) -> Decided:
    """The decisions (M, *batch) of a sensor's gate, whose probability is `gate`, as a record."""
    shape, nothing = (len(order), -1), np.ones((0, 0, 0), dtype=bool)
    masks, squares = rejected.reshape(shape).astype(bool), square.reshape(shape).astype(float)
    return variable, GateRecord(gate, nothing, masks, squares), order
