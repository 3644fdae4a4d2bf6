"""Sweeps of a plan in machine code: what they leave is what the general kernels leave."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from importlib.util import find_spec
from typing import Any

import numpy as np

from pgm.beliefs.moments.compiled.judged import judge
from pgm.beliefs.moments.compiled.table import (
    Integers64,
    Rows,
    Uncompiled,
    address,
    link_row,
    sensor_row,
    unknown,
)
from pgm.beliefs.moments.steps.chain import MomentChain
from pgm.beliefs.moments.steps.plan import ChainPlan
from pgm.compile.machine import CONTROL, GATE, Compiled
from pgm.kernels.arrays import Array, Mask, vacant
from pgm.kernels.compiled import tables as t
from pgm.kernels.moments import Conditional
from pgm.resources import in_threads
from pgm.schedules.damping import LevenbergMarquardt
from pgm.schedules.schedule import ONCE, Filtering

# Machine code repays its loading from a second of the general kernels on: a step of theirs takes as
# long as the arithmetic of so many runs, and four million of such a quarter of a microsecond each.
_STEP, _LONG = 200, 4_000_000
_LINE = 64
# Why runs are left to the general kernels, going forward and back.
_FAR = "readings are too sharp, a covariance is singular, or numbers are too far apart"
_SINGULAR = "a covariance is singular on the way back"
_PREDICTED = t.PREDICTED_MEAN, t.PREDICTED_COV


@dataclass(frozen=True, eq=False)
class Swept:
    """How a sweep went: the runs that are left to the general kernels, and what it says of others.

    `residuals` and `converged` are as of a `MomentChain`, `closest` and `far` as of `Forward`.
    """

    left: list[slice]
    residuals: list[Array]
    converged: Mask
    closest: float
    far: bool = True


def is_used(plan: ChainPlan) -> bool:
    """Whether a plan is to be swept in machine code; its account says why not."""
    choice, account = plan.layout.compiled, plan.account
    if choice is False:
        account.rest = "compiled=False"
    elif choice is None and plan.steps * (_STEP + plan.runs) < _LONG:
        account.rest = "machine code is loaded for longer work, or by compiled=True"
    elif choice is None and find_spec("numba") is None:
        account.rest = "Numba is not installed: pip install sepset[fast]"
    elif choice is None and not _stays():
        account.rest = "no folder keeps machine code (NUMBA_CACHE_DIR), save by compiled=True"
    else:
        account.due = True
        return True
    return False


def _stays() -> bool:
    """Whether machine code is kept on disk; to compile it in each process saves no time."""
    from pgm.kernels.compiled.sweeps import forward  # here, since Numba is slow to import

    return forward._cache.cache_path is not None


def forward(
    plan: ChainPlan,
    schedule: Filtering | None,
    known: tuple[Array, ...],
    predicted: tuple[Array, ...] = (),
    *,
    keep: bool,
) -> Swept | None:
    """Sweep a plan forward into arrays of its record; None if it is not compiled.

    Parameters
    ----------
    plan : ChainPlan
    schedule : Filtering or None
        None leaves all CPDs as they were linearised.
    known, predicted : tuple of ndarray
        Moments (T+1, runs, ...) and log-densities (T+1, runs) given measurements; moments before
        them, if they are kept.
    keep : bool
        Whether the plan keeps how it is linearised.
    """
    if not is_used(plan):
        return None
    from pgm.kernels.compiled import sweeps as s

    asked = schedule or ONCE
    try:
        if asked.gate is not None:
            raise Uncompiled(GATE)
        if isinstance(asked.damping, LevenbergMarquardt):
            raise Uncompiled(CONTROL)
        chain = Chain(plan)
        chain.lay_out(schedule is None, keep)
    except Uncompiled as error:
        plan.account.leave(str(error))
        return None
    first = replace(plan, transition=[], sensors=[])
    if plan.batch and plan.begin is None and all(link.family.uniform for link in plan.prior):
        first = first.of(slice(0, 1))  # which is as all are
    begin = MomentChain(first, schedule, keep=keep).start()
    chain.put(t.BEGIN_MEAN, _by_row(first, begin.mean, 1))
    chain.put(t.BEGIN_COV, _by_row(first, begin.cov, 2))
    if not predicted and any(f.compiled for f in plan.families):
        predicted = tuple(np.empty_like(part) for part in known[:2])  # for the judge alone
    chain.out = *known, *predicted
    for place, array in zip((t.MEAN, t.COV, t.DENSITY, *_PREDICTED), chain.out, strict=False):
        chain.put(place, array)
    closest = np.full((plan.layout.slice_size + 2, plan.runs), np.inf)
    closest[0], closest[-1] = 1.0, 0.0
    chain.fields[t.CLOSEST] = address(closest)
    record = np.zeros((asked.iterations + 1, plan.runs if asked.iterations > 1 else 0))
    if asked.iterations > 1:
        settings = np.array([asked.tolerance, asked.damping])
        chain.fields[t.ITERATIONS] = asked.iterations
        chain.fields[t.SETTINGS] = chain.rows.at(settings)
        chain.fields[t.RESIDUALS] = address(record)
    left = chain.run((s.forward, s.forward_together))
    chain.count(left, _FAR)
    if schedule is not None:
        judge(plan, known, predicted or known, chain.status == t.DONE, again=asked.iterations > 1)
    longest = int(record[-2].max(initial=0.0))
    converged = np.full(plan.runs, plan.linear)
    if asked.iterations > 1 and not plan.linear:
        converged = record[-1] == 0.0
    found = float(closest[0].min(initial=1.0)), bool(closest[-1].any())
    return Swept(left, list(record[:longest]), converged, *found)


def backward(
    plan: ChainPlan,
    ahead: Any,
    transition: Conditional,
    slices: Conditional | None,
    *,
    smooth: bool,
) -> tuple[Conditional, tuple[Array, Array] | None] | None:
    """The states given the slices after them, (T, runs, ...), and smoothed moments, if asked for.

    None where the plan is not compiled, or a covariance is singular. `transition` and `slices` are
    as of `Reverse`.
    """
    if not is_used(plan):
        return None
    from pgm.kernels.compiled import sweeps as s

    chain, layout = Chain(plan), plan.layout
    lead, front, width = (plan.steps, plan.runs), layout.state_size, layout.slice_size
    states = Conditional(*(vacant(lead, own) for own in ((front, width), (front,), (front, front))))
    parts = {t.STEP_MATRIX: transition.matrix, t.STEP_NOISE: transition.cov}
    parts |= dict(zip((t.GAIN, t.SHIFT, t.REST), states, strict=True))
    for place, name in ((t.MEAN, "mean"), (t.PREDICTED_MEAN, "predicted_mean")):
        parts |= {place: getattr(ahead, name), place + 4: getattr(ahead, name[:-4] + "cov")}
    beliefs = None
    if smooth:
        every = plan.steps + 1, plan.runs
        beliefs = vacant(every, (width,)), vacant(every, (width, width))
        parts |= dict(zip((t.LATER_MEAN, t.LATER_COV), beliefs, strict=True))
        if slices is not None:
            places = t.CONTROL_GAIN, t.CONTROL_SHIFT, t.CONTROL_REST
            parts |= dict(zip(places, slices, strict=True))
    for place, array in parts.items():
        chain.put(place, array)
    chain.out = *states, *(beliefs or ())
    left = chain.run((s.backward, s.backward_together))
    chain.count([slice(0, plan.runs)] if left else [], _SINGULAR)
    return None if left else (states, beliefs)


def _by_row(plan: ChainPlan, array: Array, own: int) -> Array:
    """Moments (own axes, *batch) as of one row, (1, runs, own axes)."""
    if not plan.batch:
        return array[None, None]
    return array.transpose(own, *range(own))[None]


class Chain:
    """A plan as a row of integers, the tables it tells of, and room to work in."""

    def __init__(self, plan: ChainPlan, *, rows: Rows | None = None) -> None:
        layout = plan.layout
        self.plan, self.rows = plan, rows or Rows(plan.runs >= t.RUNS)
        self.fields = np.zeros(t.FIELDS, dtype=np.int64)
        self.status = np.zeros(plan.runs, dtype=np.int64)
        self.out: Sequence[Array] = ()
        fields = self.fields
        fields[t.LAST], fields[t.SINGLE] = plan.steps, layout.single
        fields[t.FRONT], fields[t.WIDTH] = layout.state_size, layout.slice_size
        fields[t.STATES] = self.rows.places(layout.state_places, layout.slice_size)
        fields[t.STATUS], fields[t.RUN_COUNT] = address(self.status), plan.runs

    def lay_out(self, stored: bool, keep: bool) -> None:
        """Lay out the tables of CPDs, `stored` as the plan has them linearised.

        Others are linearised by the sweep, and to `keep` that puts it into the plan.
        """
        plan, rows = self.plan, self.rows
        why = unknown(plan)
        if why is not None:
            raise Uncompiled(why)
        read = plan.read
        links = np.zeros((len(plan.transition), t.COLUMNS), dtype=np.int64)
        sensors = np.zeros((len(read), t.COLUMNS), dtype=np.int64)
        kept = keep and not stored
        for link, row in zip(plan.transition, links, strict=True):
            link_row(plan, link, rows, row, stored=stored)
            if kept:
                _keep(link.family, row, rows)
        for sensor, row in zip(read, sensors, strict=True):
            sensor_row(plan, sensor, rows, row, stored=stored)
            if kept:
                _keep(sensor.family, row, rows)
            if kept and sensor.variable.angles:
                row[t.MOVED : t.MOVED + 4] = rows.told(sensor.moved, 1)
        self.links, self.sensors = links, sensors
        self.fields[t.LINKS], self.fields[t.LINK_COUNT] = rows.at(links), len(links)
        self.fields[t.SENSORS], self.fields[t.SENSOR_COUNT] = rows.at(sensors), len(sensors)

    def put(self, place: int, array: Array) -> None:
        """Lay out an array (steps, runs, ...)."""
        self.fields[place : place + 4] = self.rows.told(array, array.ndim - 2)

    def count(self, left: list[slice], why: str) -> None:
        """Note in the plan's account how a sweep went: the runs that it left, and why."""
        account, runs = self.plan.account, sum(each.stop - each.start for each in left)
        account.compiled += runs < self.plan.runs
        if runs:
            account.leave(why, runs)

    def run(self, kernel: Any) -> list[slice]:
        """Run a kernel on all runs; those that it leaves."""
        from pgm.kernels.compiled import sweeps as s
        from pgm.kernels.compiled.memory import ready

        plan, rows = self.plan, self.rows
        chain, choice = address(self.fields), plan.layout.compiled
        together = plan.runs >= t.RUNS
        lanes, kernel = (t.RUNS, kernel[1]) if together else (1, kernel[0])
        threads = choice.threads if isinstance(choice, Compiled) else 1
        threads = max(min(threads, plan.runs // lanes), 1)
        ready(kernel, "int64(int64,int64,int64,int64)")
        size = s.room(
            plan.layout.slice_size, plan.layout.state_size, rows.height, rows.points, lanes
        )

        def work(first: int, last: int) -> None:
            # Large pages of fresh memory are cleared once, each by one thread.
            for array in self.out if threads > 1 else ():
                begin, end = (runs * len(array) // plan.runs for runs in (first, last))
                array[begin:end, first:last:512] = 0.0
            room = np.empty(size + _LINE)
            kernel(chain, first, last, -(-address(room) // _LINE) * _LINE)  # a line of the cache

        in_threads(work, plan.runs, threads)
        return stretches(self.status != t.DONE)


def _keep(family: Any, row: Integers64, rows: Rows) -> None:
    """Tell where a CPD keeps how it is linearised."""
    if family.template is None:
        return
    row[t.MATRIX : t.MATRIX + 4] = rows.told(family.matrix, 2)
    row[t.OFFSET : t.OFFSET + 4] = rows.told(family.offset, 1)
    if row[t.KIND] == t.REGRESSION:
        family.keep_errors()
        row[t.KEPT_NOISE : t.KEPT_NOISE + 4] = rows.told(family.noise, 2)


def stretches(mask: Mask) -> list[slice]:
    """The stretches of a mask that are true, or all of it, where that takes less time."""
    if not mask.any():
        return []
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(int)))
    if len(edges) // 2 * _STEP + mask.sum() >= _STEP + mask.size:
        return [slice(0, mask.size)]
    return [slice(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]
