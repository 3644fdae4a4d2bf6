"""Posteriors of parts of the runs, joined to one posterior of all runs.

A part is a slice of the runs, whose posterior was computed by itself. Here `graph` is the compiled
network, `bound` the evidence in arrays for all runs, and `lineariser` the rule for nonlinear CPDs
that have none of their own. A plan (`ChainPlan`) has the CPDs with their evidence and their
linearisations. Arrays are (steps or measurements, runs, ...), if no other shape is given.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import fields
from typing import Any

import numpy as np

from pgm.beliefs.moments.outcomes.outcome import ChainOutcome
from pgm.beliefs.moments.passes.backward import Beliefs, Reverse
from pgm.beliefs.moments.passes.forward import Filtered, Forward
from pgm.beliefs.moments.smoothers.fixed_lag import Windows
from pgm.beliefs.moments.steps.plan import ChainPlan
from pgm.beliefs.moments.steps.sensor import Sensor
from pgm.compile import DynamicGraph
from pgm.evidence import BoundEvidence
from pgm.kernels.arrays import Array
from pgm.linearisation.family import Family
from pgm.linearisers import Lineariser
from pgm.posteriors.belief_kind import FILTERED, SMOOTHED
from pgm.posteriors.gate_record import GateRecord
from pgm.posteriors.status import Status


def joined(
    graph: DynamicGraph,
    bound: BoundEvidence,
    lineariser: Lineariser,
    status: Status,
    found: Sequence[ChainOutcome],
) -> ChainOutcome:
    """The posterior of all runs from the posteriors of its parts, `found`, in their order.

    It equals the posterior of one call for all runs. `graph`, `bound` and `status`, like the
    result, are of all runs.
    """
    plan = ChainPlan.make(graph, bound, lineariser, probe=False)
    return type(found[0])(
        graph,
        status,
        found[0].kind,
        plan,
        _swept(plan, found),
        _along_runs(Beliefs, [each._smoothed for each in found]),
        _along_runs(Reverse, [each._reverse_given for each in found]),
        None,
        _along_runs(Windows, [each._windows for each in found]),
    )


def swept_once(
    graph: DynamicGraph,
    bound: BoundEvidence,
    lineariser: Lineariser,
    status: Status,
    beliefs: Sequence[Array],
    *,
    held: bool,
) -> ChainOutcome:
    """The posterior of a filter or smoother that linearised once, from its beliefs of all runs.

    `beliefs` are arrays (T+1, runs, ...) of the filtered means, covariances and log-densities,
    followed, if it is a smoother, by the smoothed means and covariances. Whatever else the
    posterior is asked for, it finds by passing over the runs once more. `held` says that the belief
    was lost in no run.
    """
    plan = ChainPlan.make(graph, bound, lineariser, probe=False)
    mean, cov, log_density, *smoothed = beliefs
    swept, kind = (
        Filtered(plan, mean, cov, log_density, held=held),
        SMOOTHED if smoothed else FILTERED,
    )
    last = Beliefs(smoothed[0], smoothed[1]) if smoothed else None
    return ChainOutcome(graph, status, kind, plan, swept, last, None)


def _swept(plan: ChainPlan, found: Sequence[ChainOutcome]) -> Forward:
    """The moments and log-densities of the parts' forward passes, joined to those of all runs.

    `found` are the posteriors of the parts, in order. `plan` is that of all runs, into which the
    findings of the parts' plans are written, such as linearisations, weights of robust noise, and
    which measurements were gated out.
    """
    plans = [each._plan for each in found]
    for family, *families in zip(plan.families, *(p.families for p in plans), strict=True):
        _family(family, families)
    for sensor, *sensors in zip(plan.sensors, *(p.sensors for p in plans), strict=True):
        _sensor(sensor, sensors)
    forward: Forward = _along_runs(Forward, [each._forward for each in found])
    return forward


def one_status(statuses: Iterable[Status], lead: tuple[int, ...]) -> Status:
    """One status of all runs, with `lead` as the user's axes of runs.

    `statuses` are those of the parts. The status records the residuals of each iteration, by run;
    where a part took fewer iterations than another, its last residuals are repeated, or zeros if it
    has none. The accounts of what ran as machine code (`Status.compilation`) are joined. Of the
    digits of the means that rounding leaves, a part that has not measured them counts with all of
    float64's; the cause of few digits is taken from the part with the fewest.
    """
    every = tuple(statuses)
    longest = max(len(status.residuals) for status in every)
    records = []
    for status in every:
        record = status.residuals.reshape(len(status.residuals), status.converged.size)
        last = record[-1] if len(record) else np.zeros(status.converged.size)
        records.append(np.concatenate([record, np.tile(last, (longest - len(record), 1))]))
    converged = np.concatenate([status.converged.reshape(-1) for status in every])
    status = Status.of(list(np.concatenate(records, axis=1)), converged, lead)
    told = {part: None for each in every for part in [each.compilation] if part}
    status = status.with_compilation("; of other runs ".join(told))
    if all(each.digits is None for each in every):
        return status
    digits = [_digits(each) for each in every]
    fewest = min(range(len(every)), key=lambda k: digits[k].min(initial=np.inf))
    return status._measured(np.concatenate(digits).reshape(lead), every[fewest]._cause)


def _digits(status: Status) -> Array:
    """How many decimal digits of a mean rounding leaves in each run, (runs,).

    Where that was not measured it is 15.7, as many as float64 has.
    """
    if status.digits is None:
        return np.full(status.converged.size, -np.log10(np.finfo(np.float64).eps))
    return status.digits.reshape(-1)


def _family(whole: Family, parts: list[Family]) -> None:
    """Concatenate the parts' linearisations of one CPD along the runs, in `whole`.

    A linearisation is a matrix F, an offset b and a noise covariance Q for each step, or each
    measurement, and run. What is exact without linearisation is in `whole` already: F and b of an
    affine CPD, and Q where no linearisation adds an error to it.
    """
    if not whole.exact:
        whole.matrix = np.concatenate([part.matrix for part in parts], axis=1)
        whole.offset = np.concatenate([part.offset for part in parts], axis=1)
    whole.approximate = any(part.approximate for part in parts)
    if whole.approximate:
        whole.noise = np.concatenate([part.noise for part in parts], axis=1)


def _sensor(whole: Sensor, parts: list[Sensor]) -> None:
    """Concatenate the parts' records of one sensor along the runs, in `whole`.

    The records are the sensor's measurements, angles moved by whole turns to the branch that was
    used in linearising; the weights of robust noise; the decisions of gates; and, by step, the
    covariances (`cross`) between the errors of measurements that are linearised together.
    """
    whole.moved = np.concatenate([part.moved for part in parts], axis=1)
    if whole.robust:
        for name in ("weight", "square"):
            joined = [getattr(part.weights, name) for part in parts]
            setattr(whole.weights, name, np.concatenate(joined, axis=1))
    records = [part.gated for part in parts if part.gated is not None]
    if records:
        taken = [part.taken for part in parts if part.taken is not None]
        whole.taken = np.concatenate(taken, axis=1)
        whole.gated = GateRecord.joined(records)
    for step in {step for part in parts for step in part.cross}:
        some = next(part.cross[step] for part in parts if step in part.cross)

        def cross(part: Sensor, step: int = step, some: Array = some) -> Array:
            """A part's cross-covariances of one step, (runs, D, D); zeros if it has none there.

            D is the number of components of all measurements of the step. `some` is any part's
            array of this step, from which zeros have their shape.
            """
            return part.cross.get(step, np.zeros((part.moved.shape[1], *some.shape[1:])))

        whole.cross[step] = np.concatenate([cross(part) for part in parts])


def _along_runs(kind: type[Any], parts: Sequence[Any]) -> Any:
    """One result of all runs, from the results of the parts, which are all of the type `kind`.

    Arrays are concatenated along their second axis, which is of runs. Named tuples and dataclasses
    are joined field by field, and tuples of arrays one by one, which are empty if those of a part
    are; of bools and floats the least is taken. If a part's result is None, so is that of all.
    """
    if any(part is None for part in parts):
        return None
    if kind in (bool, float):  # of all, or the least
        return min(parts)
    if issubclass(kind, np.ndarray):
        return np.concatenate(parts, axis=1)
    if kind is tuple:
        each = zip(*parts, strict=True) if all(parts) else ()
        return tuple(np.concatenate(arrays, axis=1) for arrays in each)
    found = {}
    for name in getattr(kind, "_fields", None) or [field.name for field in fields(kind)]:
        values = _each(parts, name)
        found[name] = _along_runs(type(values[0]), values)
    return kind(**found)


def _each(parts: Sequence[Any], name: str) -> list[Any]:
    """An attribute of every part, as a list."""
    return [getattr(part, name) for part in parts]
