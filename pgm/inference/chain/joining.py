"""What parts of the runs leave, as one posterior of them all."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any, NamedTuple

import numpy as np

from pgm.compile import DynamicGraph
from pgm.evidence import BoundEvidence
from pgm.inference.chain.backward import Beliefs, Reverse
from pgm.inference.chain.forward import Forward
from pgm.inference.chain.many import Filtered
from pgm.inference.chain.plan import ChainPlan, Sensor
from pgm.inference.chain.posterior import ChainPosterior
from pgm.inference.family import Family
from pgm.inference.status import Status
from pgm.kernels.arrays import Array
from pgm.linearisers import Lineariser


class Line(NamedTuple):
    """What a lineariser has made of a CPD; its errors may be none."""

    matrix: Array
    offset: Array
    noise: Array
    approximate: bool


@dataclass(frozen=True, eq=False)
class Share:
    """All that inference leaves of a part of the runs, without what it was given.

    Attributes
    ----------
    kind : type
        Of posterior.
    forward, smoothed, reverse
        Of that.
    lines : sequence of Line
        Of the CPDs that were linearised.
    moved : sequence of ndarray or None
        Of each sensor the readings, where it has angles, which were moved.
    cross : sequence of mapping
        Of each sensor.
    """

    kind: type[ChainPosterior]
    forward: Forward
    smoothed: Beliefs | None
    reverse: Reverse | None
    lines: Sequence[Line]
    moved: Sequence[Array | None]
    cross: Sequence[Mapping[int, Array]]

    @classmethod
    def of(cls, found: ChainPosterior) -> Share:
        """The share of a part."""
        plan = found._plan
        return cls(
            type(found),
            found._forward,
            found._smoothed,
            found._reverse_given,
            [Line(f.matrix, f.offset, f.noise, f.approximate) for f in _linearised(plan)],
            [sensor.moved if sensor.variable.angles else None for sensor in plan.sensors],
            [sensor.cross for sensor in plan.sensors],
        )


def joined(
    graph: DynamicGraph,
    bound: BoundEvidence,
    lineariser: Lineariser,
    status: Status,
    shares: Sequence[Share],
) -> ChainPosterior:
    """What one run of everything would have left."""
    plan = ChainPlan.make(graph, bound, lineariser, probe=False)
    for family, *lines in zip(_linearised(plan), *_each(shares, "lines"), strict=True):
        _line(family, lines)
    parts = zip(plan.sensors, *_each(shares, "moved"), strict=True)
    for sensor, *moved in parts:
        if moved[0] is not None:
            sensor.moved = np.concatenate(moved, axis=1)
    runs = [share.forward.mean.shape[1] for share in shares]
    for sensor, *cross in zip(plan.sensors, *_each(shares, "cross"), strict=True):
        _cross(sensor, cross, runs)
    return shares[0].kind(
        graph,
        status,
        plan,
        _along_runs(Forward, _each(shares, "forward")),
        _along_runs(Beliefs, _each(shares, "smoothed")),
        _along_runs(Reverse, _each(shares, "reverse")),
    )


def swept_once(
    graph: DynamicGraph,
    bound: BoundEvidence,
    lineariser: Lineariser,
    status: Status,
    beliefs: Sequence[Array],
) -> ChainPosterior:
    """The posterior of a filter or smoother that linearised once, of its `Wanted` beliefs.

    Another sweep leaves the rest, once it is asked for.
    """
    plan = ChainPlan.make(graph, bound, lineariser, probe=False)
    mean, cov, log_density, *smoothed = beliefs
    swept = Filtered(plan, mean, cov, log_density)
    return ChainPosterior(
        graph, status, plan, swept, Beliefs(*smoothed) if smoothed else None, None
    )


def one_status(statuses: Iterable[Status], lead: tuple[int, ...]) -> Status:
    """One status of all runs; a part that was done earlier keeps its last residuals."""
    every = tuple(statuses)
    longest = max(len(status.residuals) for status in every)
    records = []
    for status in every:
        record = status.residuals.reshape(len(status.residuals), status.converged.size)
        last = record[-1:].repeat(longest - len(record), axis=0)
        records.append(np.concatenate([record, last]))
    converged = np.concatenate([status.converged.reshape(-1) for status in every])
    status = Status.of(list(np.concatenate(records, axis=1)), converged, lead)
    if all(each.digits is None for each in every):
        return status
    digits = [_digits(each) for each in every]
    return status.with_digits(np.concatenate(digits).reshape(lead))


def _digits(status: Status) -> Array:
    """The digits of runs; all that float64 has, where they were not measured."""
    if status.digits is None:
        return np.full(status.converged.size, -np.log10(np.finfo(np.float64).eps))
    return status.digits.reshape(-1)


def _linearised(plan: ChainPlan) -> list[Family]:
    return [family for family in plan.families if not family.exact]


def _line(family: Family, lines: Sequence[Line]) -> None:
    family.matrix = np.concatenate(_each(lines, "matrix"), axis=1)
    family.offset = np.concatenate(_each(lines, "offset"), axis=1)
    family.approximate = any(_each(lines, "approximate"))
    if family.approximate:
        family.noise = np.concatenate(_each(lines, "noise"), axis=1)


def _cross(sensor: Sensor, parts: Sequence[Mapping[int, Array]], runs: Sequence[int]) -> None:
    for step in {step for part in parts for step in part}:
        some = next(part[step] for part in parts if step in part)
        none = [np.zeros((count, *some.shape[1:])) for count in runs]
        own = [part.get(step, zeros) for part, zeros in zip(parts, none, strict=True)]
        sensor.cross[step] = np.concatenate(own)


def _along_runs(kind: type[Any], parts: Sequence[Any]) -> Any:
    """An array with the runs as second axis, or a value made of such, from those of its parts.

    What is said of parts is said of the whole if it holds of all of them.
    """
    if parts[0] is None:
        return None
    if kind is bool:
        return all(parts)
    if issubclass(kind, np.ndarray):
        return np.concatenate(parts, axis=1)
    found = {}
    for name in getattr(kind, "_fields", None) or [field.name for field in fields(kind)]:
        values = _each(parts, name)
        found[name] = _along_runs(type(values[0]), values)
    return kind(**found)


def _each(parts: Sequence[Any], name: str) -> list[Any]:
    return [getattr(part, name) for part in parts]
