"""The forward pass: messages in moment form, from cluster 0 to cluster T, and their record.

A step's belief is *predicted* before its measurements and *known* after them. Records are (T+1,
runs, ...); a sweep works on arrays with the runs last, and without that axis if there is one run.
A sweep may linearise the sensors of a step again and again. The *residual* of such an iteration is
the largest distance, over all steps, of a mean from where it was linearised, in standard
deviations, (runs,).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Generator, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np

from pgm.beliefs.moments.compiled import sweep as compiled
from pgm.beliefs.moments.compiled.sweep import Swept
from pgm.beliefs.moments.steps import gate
from pgm.beliefs.moments.steps.chain import MomentChain
from pgm.beliefs.moments.steps.cost import require_cost
from pgm.beliefs.moments.steps.diffuse import Diffuse
from pgm.beliefs.moments.steps.plan import ChainPlan
from pgm.beliefs.moments.steps.readings import Moments
from pgm.errors import PgmError
from pgm.kernels import shares
from pgm.kernels.arrays import Array, stacked, vacant
from pgm.posteriors.status import Status
from pgm.progress import counted
from pgm.resources import retain
from pgm.schedules import sweep
from pgm.schedules.iteration import Anchor
from pgm.schedules.schedule import ONCE, Filtering

# From this many runs on, only the known beliefs of a filter are kept; predictions are found by a
# second sweep, if they are asked for.
MANY = 8
# Such a filter sweeps at most so many runs at a time: what a step touches then stays in a cache of
# some megabytes.
MOST = 10_000
# Between mild measurements a `Watch` looks at beliefs every so many steps, at the last, and where a
# variance has grown by this factor since.
_EVERY, _GROWN = 8, 1e2
# The part of a variance that mild measurements leave.
_MILD = 1e-3
# Where a mean and a covariance may go.
Room = tuple[Array, Array]
# Means, covariances, and log-densities of a record.
Arrays = tuple[Array, ...]


@dataclass(frozen=True, eq=False)
class Forward:
    """The moments of a forward sweep, before and after measurements, (T+1, runs, ...).

    `predicted_mean` and `predicted_cov` are those before measurements. Controls at step 0 are zero.
    `log_density` (T+1, runs) is ln p of each step's measurements given those of the steps before.
    `closest` is the smallest share that any component's variance keeps when the components before
    it in the slice are given, or when a step's measurements are; zero if it was not looked for.
    `far` says that a mean may be 10⁸ standard deviations from zero; it is true also if that was not
    checked. `diffuse` has the covariances before measurements along their known and their unknown
    directions, None unless a flat prior leaves some unknown. `nis` (T+1, runs) is the normalised
    innovation squared of each step's measurements, None if the sweep has not kept it. `held` says
    that the belief was lost in no run (see `pgm.posteriors.lost`), None if the sweep has not tested
    that. `squares` are the NIS of each sensor that was read, by itself, (T+1, runs); empty if the
    sweep has not kept them.
    """

    predicted_mean: Array
    predicted_cov: Array
    mean: Array
    cov: Array
    log_density: Array
    closest: float = 0.0
    far: bool = True
    diffuse: Diffuse | None = None
    nis: Array | None = None
    held: bool | None = None
    squares: tuple[Array, ...] = ()

    @classmethod
    def empty(cls, plan: ChainPlan) -> Forward:
        """The record of a sweep over a plan, all zeros, whose arrays the sweep fills."""
        size, shape = plan.layout.slice_size, (plan.steps + 1, plan.runs)

        def moments() -> tuple[Array, Array]:
            return stacked(shape, (size,)), stacked(shape, (size, size))

        return cls(*moments(), *moments(), np.zeros(shape))

    @property
    def ahead(self) -> Diffuse:
        """The covariances before measurements, along known and unknown directions."""
        return Diffuse.known(self.predicted_cov) if self.diffuse is None else self.diffuse

    @property
    def last(self) -> Forward:
        """The pass over the last step alone."""
        (mean, cov), (known, spread, density), row = self.predicted, self.known, slice(-1, None)
        diffuse = None if self.diffuse is None else self.diffuse.at(row)
        ends = mean[row], cov[row], known[row], spread[row], density[row]
        return Forward(*ends, diffuse=diffuse)

    @property
    def known(self) -> Arrays:
        """Means and covariances after measurements, and the measurements' log-densities."""
        return self.mean, self.cov, self.log_density

    @property
    def predicted(self) -> tuple[Array, Array]:
        """Means and covariances before measurements."""
        return self.predicted_mean, self.predicted_cov

    def went(self, swept: Swept) -> Forward:
        """The pass, of which a sweep tells how it went."""
        names = "closest", "far", "nis", "held", "squares"
        told = {name: getattr(swept, name) for name in names}
        return replace(self, **told)


@dataclass(frozen=True, eq=False)
class Filtered:
    """The known beliefs of a forward sweep; a second sweep finds the predicted beliefs if asked.

    `mean` (T+1, runs, n) and `cov` (T+1, runs, n, n) are the known moments, and `log_density` (T+1,
    runs) is ln p of each step's measurements given those of the steps before. `plan` is the one
    that was swept, and `schedule` says how the second sweep linearises. `closest` is the smallest
    share that any component's variance keeps when the components before it in the slice are given,
    or when a step's measurements are. `far` says that a mean may be 10⁸ standard deviations from
    zero, or that this was not checked. `nis`, `held` and `squares` are as of `Forward`.
    """

    plan: ChainPlan
    mean: Array
    cov: Array
    log_density: Array
    schedule: Filtering = ONCE
    closest: float = 1.0
    far: bool = True
    nis: Array | None = None
    held: bool | None = None
    squares: tuple[Array, ...] = ()

    @classmethod
    def by(cls, plan: ChainPlan, schedule: Filtering, known: Arrays, went: Swept) -> Filtered:
        """The beliefs that a sweep by a schedule has found, whose gates' decisions stay."""
        (mean, cov, log_density), own = known, replace(schedule, gate=None)
        rest = went.closest, went.far, went.nis, went.held, went.squares
        return cls(plan, mean, cov, log_density, own, *rest)

    @cached_property
    def whole(self) -> Forward:
        """Known and predicted beliefs, by a second sweep, whose linearisations the plan keeps."""
        return run(self.plan, self.schedule)[0]


class Watch:
    """An observer of a sweep, which finds how small a share of a variance is ever left.

    The share tells whether float64 had digits enough (`certificate`). A step's measurements are
    *mild* if they leave a thousandth of each variance or more, else *sharp*. `closest`
    is the smallest share so far that any component's variance keeps when the components before it
    in the slice are given, or when sharp measurements are. To save time, what components keep given
    those before them is looked at only where measurements are sharp, where a variance has grown by
    a factor of 100, at every eighth step, and at the last.
    """

    def __init__(self) -> None:
        self.closest, self._step = 1.0, 0
        self._level: Array | float = np.inf

    def look(self, predicted: Array, known: Array, *, last: bool) -> None:
        """Look at the covariances (n, n, runs) of a step, before and after its measurements.

        `last` says that the step is the last.
        """
        spread = np.einsum("iir->ir", predicted)
        mild = bool((np.einsum("iir->ir", known) >= _MILD * spread).all())
        regular = mild and not (spread > _GROWN * self._level).any()
        if not regular:
            self._level = spread.copy()
            self._see(shares.open_share(predicted))
        if not mild:
            self._see(shares.least_left(predicted, known))
        if not self._step:
            self._level = np.einsum("iir->ir", known).copy()
        if not regular or last or (self._step and self._step % _EVERY == 0):
            self._level = np.minimum(self._level, np.einsum("iir->ir", known))
            self._see(shares.open_share(known))
        self._step += 1

    def _see(self, share: float) -> None:
        """Lower `closest` to a share of variance, if that is less."""
        self.closest = min(self.closest, share)


class _Record:
    """The arrays that a sweep fills, one row a step.

    `known` are means, covariances and log-densities after measurements, `predicted` means and
    covariances before them, all (T+1, runs, ...); `predicted` is empty for a sweep that keeps none,
    at whose beliefs `watch` looks instead. `nis` (T+1, runs) gets the squares that `chain`, the
    family that is swept, has of each step. `reached` counts the steps stored so far.
    """

    def __init__(
        self, chain: MomentChain, known: Arrays, predicted: Arrays = (), nis: Array | None = None
    ) -> None:
        self.chain, self.plan, self.reached, self.watch = chain, (plan := chain.plan), 0, Watch()
        if nis is None:
            nis = np.empty(known[2].shape)
        self.nis = nis if plan.batch else nis[:, 0]
        self.predicted = [_rows(plan, part, own) for own, part in enumerate(predicted, 1)]
        self.mean, self.cov = _rows(plan, known[0], 1), _rows(plan, known[1], 2)
        self.log_density = known[2] if plan.batch else known[2][:, 0]

    def keep(
        self, step: int, predicted: Moments, known: Moments, log_density: Array | float
    ) -> None:
        """Store the beliefs of a step.

        If predictions are not kept, the watch looks at both covariances, as they are not there
        later.
        """
        self.mean[step], self.cov[step] = known.mean, known.cov
        self.log_density[step], self.nis[step] = log_density, self.chain.square
        self.reached = step + 1
        if self.predicted:
            self.predicted[0][step], self.predicted[1][step] = predicted.mean, predicted.cov
        else:
            size = len(known.mean)
            before, after = (each.cov.reshape(size, size, -1) for each in (predicted, known))
            self.watch.look(before, after, last=step == self.plan.steps)

    @contextmanager
    def refusing(self, schedule: Filtering | None) -> Iterator[None]:
        """A context for a sweep, after which the first step whose belief is not finite is refused.

        If the sweep itself raises an error, an earlier step that is not finite is refused instead.
        The error names the CPD or sensor to blame. `schedule` is that of the sweep, None for the
        plan's linearisations.
        """
        retain()
        try:
            yield
        except PgmError:
            self.refuse(schedule)
            raise
        if not self.is_finite:
            self.refuse(schedule)

    @property
    def is_finite(self) -> bool:
        """Whether all numbers are finite.

        Of the covariances only those of the last step are tested, as NaN goes on to all later ones.
        """
        total = self.mean.sum() + self.cov[-1].sum() + self.log_density.sum()
        return bool(np.isfinite(total + sum(part.sum() for part in self.predicted)))

    def refuse(self, schedule: Filtering | None) -> None:
        """Raise the error of the first step that failed, or whose belief is not finite.

        Later failures follow from the first. That step is done again, with the `schedule` of the
        sweep (None for the plan's linearisations) and all numbers checked, which raises an error
        that names the CPD or sensor to blame. If the check passes, nothing is raised.
        """
        lost = np.zeros(self.reached, dtype=bool)
        for part in (self.mean, self.cov, self.log_density):
            rows = part[: self.reached]
            lost |= ~np.isfinite(rows).all(axis=tuple(range(1, rows.ndim)))
        step = int(np.flatnonzero(lost)[0]) if lost.any() else self.reached
        if step > self.plan.steps:
            return
        chain = MomentChain(self.plan, schedule, keep=False, check=True)
        if not step:
            belief = chain.start()
        else:
            belief = chain.predict(step, Moments(self.mean[step - 1], self.cov[step - 1]))
        chain.take(step, belief)


def _rows(plan: ChainPlan, array: Array, own: int) -> Array:
    """An array (steps, runs, ...) as a sweep takes it: (steps, ..., runs), a view.

    `own` is the number of its axes of components. If there is one run, the axis of runs is dropped.
    """
    if not plan.batch:
        return array[:, 0]
    return array.transpose(0, *range(2, 2 + own), 1)


def stored(
    plan: ChainPlan, anchor: Anchor | None = None, gated: gate.Asked | None = None
) -> Forward:
    """The forward pass with the linearisations that the plan holds.

    `anchor` holds all slices near a point, for a step control (Levenberg–Marquardt), None for no
    anchor. The gates `gated` decide anew which sightings to reject; with None earlier decisions
    stand.
    """
    out = Forward.empty(plan)
    if anchor is None and gated is None:
        ahead = Pass(plan, None, out.known, out.predicted, keep=False)
        sweep_all(ahead)
        return out.went(ahead.went)
    if anchor is not None and gated is None:
        found = compiled.forward(plan, None, out.known, out.predicted, keep=False, anchor=anchor)
        if found is not None and not found.left:
            return out.went(found)
    chain = MomentChain(plan, None, anchor=anchor, gated=gated)
    sweep_all([Part(chain, _Record(chain, out.known, out.predicted))])
    return out


def run(plan: ChainPlan, schedule: Filtering) -> tuple[Forward, Status]:
    """The forward pass, with each CPD linearised at its incoming belief, and the pass's status.

    The plan keeps the linearisations. A ModelError refuses nonlinear sensors of singular noise if
    the schedule controls steps by their cost (`require_cost`).
    """
    ahead = WholePass(plan, schedule)
    sweep_all(ahead)
    return ahead.result()


class Part(NamedTuple):
    """Some runs of a forward pass, that NumPy is to sweep: their family, and the record to fill.

    `others` has the parts of all runs together, which are swept where these runs alone fail, since
    the first error may be of other runs; None where these are all.
    """

    chain: MomentChain
    record: _Record
    others: Callable[[], Iterable[Part]] | None = None

    @contextmanager
    def refusing(self) -> Iterator[None]:
        """A context for the part's sweep, in which what fails or is not finite is refused."""
        try:
            with self.record.refusing(self.chain.schedule):
                yield
        except PgmError:
            if self.others is not None:
                sweep_all(self.others())
            raise


def sweep_all(parts: Iterable[Part]) -> None:
    """Sweep the parts of a forward pass, one after another."""
    for part in parts:
        with part.refusing():
            sweep.forward(part.chain, part.chain.plan.steps, part.record)


class Pass:
    """A forward pass into arrays, which asks for what machine code does not sweep of it.

    `known` has means, covariances and log-densities, `predicted` means and covariances, or nothing
    if they are not to be kept. Without a schedule the plan's linearisations are used; with one,
    `keep` says whether the plan stores the new linearisations.

    To iterate sweeps in machine code, if it is used for the plan, and gives the parts of the runs
    that are left to NumPy: each is to be swept before the next is asked for. After the last `went`
    tells how the sweep went: by run the residual of each iteration and whether the iterations
    converged; the smallest share of a variance that is left, be it given other components or after
    measurements; and whether a mean may be 10⁸ standard deviations from zero.
    """

    went: Swept

    def __init__(
        self,
        plan: ChainPlan,
        schedule: Filtering | None,
        known: Arrays,
        predicted: Arrays = (),
        *,
        keep: bool,
    ) -> None:
        self.plan, self.schedule, self.keep = plan, schedule, keep
        self.known, self.predicted = known, predicted

    def __iter__(self) -> Iterator[Part]:
        self.went = yield from self._left()

    def _left(self) -> Generator[Part, None, Swept]:
        """The parts left to NumPy, and how the whole sweep went.

        They are of runs that machine code gives up, or of all runs of a plan that it cannot sweep.
        """
        plan, schedule, keep = self.plan, self.schedule, self.keep
        rest = self.known, self.predicted
        found = compiled.forward(plan, schedule, *rest, keep=keep)
        if found is None:
            return (yield from _stepwise(plan, schedule, *rest, keep=keep))
        if not found.left:
            return found
        if schedule is None:  # the plan of some runs has none of the linearisations of this one
            return (yield from _stepwise(plan, schedule, *rest, keep=keep))
        closest, converged, residuals = found.closest, found.converged, found.residuals
        squares = found.squares if len(found.squares) == 1 else ()
        for runs in found.left:
            whole = runs == slice(0, plan.runs)
            part = plan if whole else plan.of(runs)
            arrays = (tuple(array[:, runs] for array in each) for each in rest)
            others = None if whole else partial(_stepwise, plan, schedule, *rest, keep=False)
            again = yield from _stepwise(part, schedule, *arrays, keep=keep, others=others)
            closest, converged[runs] = min(closest, again.closest), again.converged
            residuals = joined(residuals, again.residuals, runs, plan.runs)
            if keep and not whole:
                plan.put_runs(runs, part)
            squares = squares if again.squares else ()
            for array, own in zip(squares, again.squares, strict=False):
                array[:, runs] = own
        return Swept([], residuals, converged, closest, squares=squares)

    @property
    def status(self) -> Status:
        """How the iterations of the sweep went."""
        return Status.of(self.went.residuals, self.went.converged, self.plan.lead)


class WholePass(Pass):
    """A forward pass of which all beliefs are kept, as are the plan's linearisations; see `run`."""

    def __init__(self, plan: ChainPlan, schedule: Filtering) -> None:
        require_cost(schedule, (sensor.family for sensor in plan.sensors))
        self.out = Forward.empty(plan)
        super().__init__(plan, schedule, self.out.known, self.out.predicted, keep=True)

    def result(self) -> tuple[Forward, Status]:
        """The beliefs and the status, once all is swept."""
        self.plan.settle()
        return self.out.went(self.went), self.status


class BarePass(Pass):
    """A forward pass of which the known beliefs are kept, without the predicted ones.

    Each CPD is linearised at its incoming belief; the plan keeps no linearisations. `room` has the
    arrays for means (T+1, runs, n) and covariances (T+1, runs, n, n) that are filled; None for new
    ones.
    """

    def __init__(self, plan: ChainPlan, schedule: Filtering, room: Room | None = None) -> None:
        require_cost(schedule, (sensor.family for sensor in plan.sensors))
        size, shape = plan.layout.slice_size, (plan.steps + 1, plan.runs)
        mean, cov = room or (vacant(shape, (size,)), vacant(shape, (size, size)))
        super().__init__(plan, schedule, (mean, cov, np.empty(shape)), keep=False)

    def result(self) -> tuple[Filtered, Status]:
        """The beliefs and the status, once all is swept."""
        assert self.schedule is not None
        return Filtered.by(self.plan, self.schedule, self.known, self.went), self.status


def _stepwise(
    plan: ChainPlan,
    schedule: Filtering | None,
    known: Arrays,
    predicted: Arrays,
    *,
    keep: bool,
    others: Callable[[], Iterable[Part]] | None = None,
) -> Generator[Part, None, Swept]:
    """The parts of a pass that NumPy sweeps alone, without machine code, and how the sweep went.

    All runs are swept together, or, if `predicted` is empty, in parts of at most 10,000 runs, whose
    arrays stay in the processor's cache. The smallest share of a variance is looked for if
    `predicted` is empty; else it is zero. Arguments are as of `Pass` and `Part`.
    """
    parts, closest, converged = 1, 0.0 if predicted else 1.0, np.ones(plan.runs, dtype=bool)
    if not predicted:
        parts = math.ceil(plan.runs / MOST)
    residuals: list[Array] = []
    nis = np.empty((plan.steps + 1, plan.runs))
    edges = [part * plan.runs // parts for part in range(parts + 1)]
    for runs in counted(list(map(slice, edges, edges[1:])), "parts of the runs"):
        part = plan.of(runs) if parts > 1 else plan
        chain = MomentChain(part, schedule, keep=keep)
        mine, before = (tuple(array[:, runs] for array in each) for each in (known, predicted))
        record = _Record(chain, mine, before, nis[:, runs])
        yield Part(chain, record, others)
        closest, converged[runs] = min(closest, record.watch.closest), chain.converged
        residuals = joined(residuals, chain.residuals, runs, plan.runs)
    # A sensor of singular noise tells some components for certain, which have no innovation.
    exact = any(sensor.exact for sensor in plan.read)
    if exact:
        return Swept([], residuals, converged, closest)
    squares = (nis,) if len(plan.read) == 1 else ()
    return Swept([], residuals, converged, closest, nis=nis, squares=squares)


def joined(record: list[Array], part: list[Array], runs: slice, count: int) -> list[Array]:
    """The residuals of a sweep's iterations, in which some runs are replaced by those of `part`.

    `record` has an array (`count`,) for each iteration, over all `count` runs, and so has the
    result; `part` has one for each iteration of the sweep of the runs `runs` alone. The shorter
    list repeats its last array; an empty `record` counts as zeros, and an empty `part` changes
    nothing.
    """
    longest = max(len(record), len(part))
    found = [each.copy() for each in record + (record[-1:] or [np.zeros(count)]) * longest]
    for row, own in zip(found[:longest], (part + part[-1:] * longest)[:longest], strict=False):
        row[runs] = own
    return found[:longest]
