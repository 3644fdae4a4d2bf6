"""Decisions of gates at an update of an online filter; the test whether its belief is lost."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from pgm.inference.associations import Found
from pgm.inference.chain.fixed_lag import Window
from pgm.inference.chain.gate import Asked
from pgm.inference.chain.innovations import by_step
from pgm.inference.chain.readings import Moments, Reading
from pgm.inference.chain.sensor import GateRecord
from pgm.inference.chain.vector import vector
from pgm.inference.gates import gate_of
from pgm.inference.lost import PageTest, Read
from pgm.kernels import mahalanobis
from pgm.kernels.arrays import Array, Integers, Mask
from pgm.variables import Variable

# A sensor, the decisions of its gate, and the order of its sightings.
Decided = tuple[Variable, GateRecord, Integers]


class Watch(NamedTuple):
    """The test whether a belief is lost, after the step before, and what its step has read.

    Sightings with candidates are counted apart, since a window reads all of its step again.
    """

    before: PageTest
    read: Read | None = None
    opened: Read | None = None

    @classmethod
    def start(cls, lead: tuple[int, ...]) -> Watch:
        """The watch at the prior, before any measurement."""
        return cls(PageTest.start(math.prod(lead)))

    def test(self, step: int) -> PageTest:
        """The test after the step of this number."""
        parts = [each for each in (self.read, self.opened) if each is not None]
        if not parts:
            return self.before
        read = parts[0] if len(parts) == 1 else parts[0].and_(parts[1])
        return self.before.over(len(read.nis)).on(step, read.weights)

    def on(self, step: int) -> Watch:
        """After the step of this number, at the next one."""
        return Watch(self.test(step))

    def and_(self, read: Read) -> Watch:
        """After another update of the step."""
        return self._replace(read=read if self.read is None else self.read.and_(read))

    def told(self, associations: Found, gate: Asked | None) -> Watch:
        """After sightings of the step were associated."""
        found = self.opened
        for variable, each in associations.items():
            strange, opened = each.judged(gated=gate_of(gate, variable) is not None)
            read = Read.of_open(strange.sum(axis=0), opened.sum(axis=0), each.outliers)
            found = read if found is None else found.and_(read)
        return self._replace(opened=found)


def of_update(
    watch: Watch | None, parts: Sequence[Reading], known: Moments
) -> tuple[tuple[Decided, ...], Watch | None]:
    """The gates' decisions at an update, and the watch after it."""
    gated = tuple(_decided(part) for part in parts if part.gated is not None)
    if watch is None or not parts:
        return gated, watch
    mean, cov, _ = known
    matrix, residual, noise, missing = vector([part.seen for part in parts], mean)
    if mean.ndim == 1:
        spread = matrix @ cov @ matrix.T + noise
    else:
        spread = np.einsum("ijr,jkr,lkr->ilr", matrix, cov, matrix, optimize=_PATH) + noise
        residual = np.broadcast_to(residual, (len(residual), *mean.shape[1:]))
    nis = mahalanobis.squares(residual[None], spread[None]).reshape(-1)
    dof = np.full(nis.shape, len(residual), dtype=np.intp)
    if missing is not None:
        dof -= np.asarray(missing, dtype=np.intp)
    records = iter(gated)
    each = [None if part.gated is None else next(records)[1].judged for part in parts]
    judged = [
        found if part.weights is None else part.weights.judged(found)
        for part, found in zip(parts, each, strict=True)
    ]
    return gated, watch.and_(_read(nis, dof, judged))


# First along the covariance, then along the rows.
_PATH = ["einsum_path", (0, 1), (0, 1)]


def of_window(watch: Watch | None, window: Window) -> tuple[tuple[Decided, ...], Watch | None]:
    """The decisions at the newest step of a window, with all of its measurements."""
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
    nis, dof = by_step(plan, plan.read, window.ahead)
    return gated, watch._replace(read=_read(np.nan_to_num(nis[-1]), dof[-1], judged))


def _read(nis: Array, dof: Integers, each: Sequence[tuple[Mask, Mask] | None]) -> Read:
    """The squares of innovations at a step, and the counts of sightings rejected and judged."""
    rejected, judged = np.zeros_like(dof), np.zeros_like(dof)
    for found in each:
        if found is not None:
            rejected += found[0].sum(axis=0)
            judged += found[1].sum(axis=0)
    return Read(nis, dof, rejected, judged)


def _decided(part: Reading) -> Decided:
    """The decisions of a gate about a sensor's sightings, with the variable and their order."""
    assert part.gated is not None
    rejected, square = (each.reshape(len(each), -1) for each in part.gated)
    nothing = np.ones((0, 0, 0), dtype=bool)
    record = GateRecord(part.gate, nothing, rejected.astype(bool), square.astype(float))
    return part.sensor.variable, record, part.sensor.order
