"""Iterated smoothing: sweep forward and back, relinearise everything, sweep again.

A *slice* is the vector of all hidden variables of a step, of n components; a *pair* is the vector
of the states of the step before, then the slice. The steps are 0..T. A *sighting* is one
measurement by a sensor. `iterate` linearises a problem at a *point*, given means and covariances of
the slices, solves it, and goes on at the solution. *Dead reckoning* is the prior's mean carried on
by the transition's functions, without measurements. An *anchor* is an artificial measurement of all
components at each step, by which a step control (Levenberg–Marquardt) holds the solution near a
point.

A *solver* (plan, reference, anchor) smooths a chain with the linearisations that its plan has, and
with an anchor, if that is not None. The *reference* is a trajectory (T+1, runs, n) near the
beliefs, from which slices may be counted, so that large coordinates cost no digits. Where no CPD
needs covariances, as with `Taylor`, smoothing is Gauss–Newton for the means: their normal equations
may be solved alone (`newton`), and covariances follow by a pass at the end.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Generic, TypeVar

import numpy as np

from pgm.beliefs.moments.compiled import sweep as compiled
from pgm.beliefs.moments.compiled.judged import judge, judge_at
from pgm.beliefs.moments.compiled.points import Linearised
from pgm.beliefs.moments.compiled.uncompiled import Uncompiled, unknown
from pgm.beliefs.moments.digits import careful, careful_chain
from pgm.beliefs.moments.digits.adjoint import CarefulSmoothed
from pgm.beliefs.moments.passes import backward, forward, newton
from pgm.beliefs.moments.passes.backward import Ahead, Beliefs, Reverse
from pgm.beliefs.moments.passes.likelihoods import Readings
from pgm.beliefs.moments.passes.newton import Means
from pgm.beliefs.moments.passes.reweighting import reweigh, settled
from pgm.beliefs.moments.smoothers import exact_relations, parallel
from pgm.beliefs.moments.steps import cost
from pgm.beliefs.moments.steps.chain import on_chart, turns_far
from pgm.beliefs.moments.steps.plan import ChainPlan
from pgm.beliefs.moments.steps.sensor import linearise_grouped
from pgm.errors import NumericalError
from pgm.factors.scope import angle_mask
from pgm.kernels.angles import nearest_branch
from pgm.kernels.arrays import (
    Array,
    Integers,
    Mask,
    block,
    components_first,
    components_last,
    deviation,
)
from pgm.kernels.prefixes import gather
from pgm.posteriors.status import Status
from pgm.progress import counted
from pgm.schedules.damping import LevenbergMarquardt
from pgm.schedules.iteration import Anchor, Point, iterate
from pgm.schedules.schedule import Smoothing


@dataclass(frozen=True, eq=False)
class Smoothed:
    """A chain smoothed in float64: a forward pass, and the smoothed beliefs.

    `reverse` is the reversed chain, where it was made: where a CPD is linearised at a pair, so that
    `point` needs its covariances, and by the general kernels.
    """

    forward: Ahead
    beliefs: Beliefs
    reverse: Reverse | None
    paired: bool

    @classmethod
    def of(cls, plan: ChainPlan, ahead: Ahead) -> Smoothed:
        """The smoothed chain, by a backward pass from the forward one, `ahead`, of the plan."""
        paired = not plan.layout.single
        return cls(ahead, *backward.smoothed(plan, ahead, reverse=paired), paired)

    @property
    def means(self) -> Array:
        """The smoothed means of the slices, (T+1, runs, n)."""
        return self.beliefs.mean

    @cached_property
    def point(self) -> Point:
        """The moments of slices, and of pairs if `paired`, as a point of linearisation."""
        joint = None
        if self.paired:
            assert self.reverse is not None
            joint = backward.pairs(self.beliefs, self.reverse, slice(None)).cov
        return Point(self.beliefs.mean, self.beliefs.cov, joint)

    def reversed_of(self, plan: ChainPlan) -> Reverse:
        """The reversed chain, of a plan that is as it was linearised for this chain."""
        return self.reverse or Reverse.make(plan, self.forward)

    def at(self, plan: ChainPlan, mean: Array) -> Smoothed:
        """The same chain with other smoothed means, such as those that a step control kept.

        The reversed chain is moved to `mean` (T+1, runs, n); forward pass and covariances stay.
        """
        moved = self.reversed_of(plan).moved(mean, plan.layout.state_places)
        return Smoothed(self.forward, Beliefs(mean, self.beliefs.cov), moved, self.paired)


Either = TypeVar("Either", Smoothed, CarefulSmoothed)

# Steps from which on, and components of all runs together up to which, a scan beats a sweep.
_MANY_STEPS = 64
_FEW_NUMBERS = 200


def smooth(plan: ChainPlan, schedule: Smoothing, start: Array | None) -> tuple[Smoothed, Status]:
    """Run a smoothing schedule; without a `start` it begins with a filter, step by step.

    The filter linearises step after step; every other linearisation is of all steps at once. The
    linearised chain is solved by machine code, if it knows the plan; by a parallel scan, if there
    are many steps of few components; or by a sweep forward and back.

    Parameters
    ----------
    plan : ChainPlan
    schedule : Smoothing
    start : ndarray or None
        (T+1, runs, n): means of the slices for the first linearisation; None leaves that to the
        filter.
    """
    cost.require_cost(schedule, plan.families, first=start is None)
    first: Smoothed | Point
    if start is None:
        first = Smoothed.of(plan, forward.run(plan, schedule.first)[0])
    else:
        first = _start(plan, start)
    steps = _is_newton(plan, schedule) and schedule.gate is None and not plan.exact
    anchored = isinstance(schedule.damping, LevenbergMarquardt)
    machine = compiled.is_used(plan)
    if steps and machine:
        found = _compiled(plan, schedule, first)
        if found is not None:
            return found
    chain = None
    if machine and (schedule.iterations > 1 or anchored) and not plan.exact:
        chain = _by_machine(plan)
    if chain is None:
        machine = machine and unknown(plan) is None
        rounds = _is_long(plan) and schedule.iterations > 1 and not machine
        chain = Chain(plan, _in_rounds if rounds else swept)
    if isinstance(first, Smoothed):
        found = _iterated(chain, schedule, first, None)
    else:
        chain.begin(first, reckoned=False)
        if schedule.gate is not None:
            forward.stored(plan, gated=schedule.gate)
            if chain.machine is not None:
                chain.machine.rebind()
        found = _iterated(chain, schedule, chain.solve(), first)
    again = schedule.iterations > 1 or not isinstance(first, Smoothed)
    if again and any(family.compiled is not None for family in plan.families):
        moments = found[0].beliefs.mean, found[0].beliefs.cov
        judge(plan, moments, moments, np.ones(plan.runs, dtype=bool))
    return found


def scan(plan: ChainPlan, schedule: Smoothing, start: Array | None) -> tuple[Smoothed, Status]:
    """Run a smoothing schedule by parallel scans of O(log T) rounds.

    `start` (T+1, runs, n) are means for the first linearisation. Without them CPDs are first
    linearised along dead reckoning, since a filter's beliefs come one step after another.
    """
    cost.require_cost(schedule, plan.families, first=False)
    chain = Chain(plan, _scanned)
    if plan.exact:
        return _iterated(chain, schedule, Smoothed.of(plan, parallel.run(plan)), None)
    at = dead_reckoning(plan) if start is None else _start(plan, start)
    chain.begin(at, reckoned=start is None)
    means = newton.step(plan, at.mean) if _is_newton(plan, schedule) else None
    if means is None:
        return _iterated(chain, schedule, chain.solve(), at)
    return _newton(chain, means, schedule, at)


def carefully(
    plan: ChainPlan, schedule: Smoothing, start: Array | None, *, reckoned: bool
) -> tuple[CarefulSmoothed, Status]:
    """Smooth in twice the digits, going forward step by step.

    `start` (T+1, runs, n) are means for the first linearisation. Without them CPDs are first
    linearised at a filter's beliefs, or along dead reckoning if `reckoned`.
    """
    reckoned = reckoned and not plan.exact
    cost.require_cost(schedule, plan.families, first=start is None and not reckoned)
    chain = Chain(plan, _careful)
    if start is None and not reckoned:
        swept, _ = careful.sweep(plan, schedule.first)
        return _iterated(chain, schedule, CarefulSmoothed.of(plan, swept), None)
    at = dead_reckoning(plan) if start is None else _start(plan, start)
    chain.begin(at, reckoned=start is None)
    if schedule.gate is not None:
        careful.sweep(plan, None, gated=schedule.gate)
    return _iterated(chain, schedule, chain.solve(), at)


def _iterated(
    chain: Chain[Either], schedule: Smoothing, solution: Either, first: Point | None
) -> tuple[Either, Status]:
    """Relinearise about each solution until every run has settled or the schedule ends.

    `solution` is that of the first linearisation, made at the point `first`, or by a filter if that
    is None. A linear chain has its answer at once. Means that a step control kept replace those of
    the last solution.
    """
    plan = chain.plan
    controlled = first is not None and isinstance(schedule.damping, LevenbergMarquardt)
    if plan.exact or (schedule.iterations == 1 and not controlled):
        return solution, Status.of([], np.full(plan.runs, plan.exact), plan.lead)
    result = iterate(chain, solution, schedule, np.zeros(plan.runs, dtype=bool), first)
    smoothed = result.solution
    if not np.array_equal(result.mean, smoothed.beliefs.mean):
        smoothed = smoothed.at(plan, result.mean)
    return smoothed, Status.of(result.residuals, result.converged, plan.lead)


def _is_newton(plan: ChainPlan, schedule: Smoothing) -> bool:
    """Whether all iterations may solve normal equations for the means alone.

    They may if no lineariser and no robust noise needs the covariances of a point. The answer is
    False where the schedule has a single iteration, or its step control is Levenberg–Marquardt.
    """
    several = schedule.iterations > 1 and not isinstance(schedule.damping, LevenbergMarquardt)
    if any(sensor.family.expects for sensor in plan.robust):
        return False
    return several and not any(family.needs_cov for family in plan.families)


def _newton(
    chain: Chain[Smoothed], means: Means, schedule: Smoothing, at: Point
) -> tuple[Smoothed, Status]:
    """Iterate means by Gauss–Newton, then find covariances by one pass.

    `means` solve the first linearisation, made at the point `at`. The pass solves the last
    linearisation once more.
    """
    unsettled = np.zeros(chain.plan.runs, dtype=bool)
    result = iterate(_Means(chain), means, schedule, unsettled, at)
    readings = result.solution.readings
    assert readings is not None
    ahead = parallel.filtered(chain.plan, readings.reference, readings=readings)
    status = Status.of(result.residuals, result.converged, chain.plan.lead)
    return Smoothed.of(chain.plan, ahead), status


def _compiled(
    plan: ChainPlan, schedule: Smoothing, first: Smoothed | Point
) -> tuple[Smoothed, Status] | None:
    """Smooth by Gauss–Newton steps in machine code.

    `first` is the solution of a first linearisation, or the point at which to make it. At the end
    the last linearisation is also solved by a sweep forward and back, whose result is returned.
    None where machine code does not know a part of the plan, where its equations have no solution,
    and where the last step and the sweep differ in a mean by more than 10⁻⁷ standard deviations, or
    in a standard deviation by more than 3·10⁻⁹ of it. `plan.account` then notes the reason.
    """
    from pgm.beliefs.moments.smoothers.compiled_newton import Equations, Newton, agree

    active, at = np.ones(plan.runs, dtype=bool), None
    try:
        equations = Equations(plan)
        newton = Newton(equations, equations.table.whole, plan.account)
        if isinstance(first, Smoothed):
            solution = newton.start(first.means, first.beliefs.cov)
        else:
            at = first
            newton.linearise(at, active)
            solution = newton.solve()
        result = iterate(newton, solution, schedule, ~active, at)
    except Uncompiled:
        return None  # sweeps may know the plan
    last = result.solution
    found = swept(plan, last.means, None)
    std = deviation(found.beliefs.cov)
    judge_at(plan, newton.at, std)
    if agree(last, found.beliefs, std):
        return found, Status.of(result.residuals, result.converged, plan.lead)
    plan.account.leave("Gauss–Newton steps, since normal equations have too few digits")
    return None


def _by_machine(plan: ChainPlan) -> Chain[Smoothed] | None:
    """The chain as machine code linearises it, or None, of which the account says why."""
    try:
        return Chain(plan, swept, machine=Linearised(plan))
    except Uncompiled as error:
        plan.account.leave(str(error))
        return None


def swept(plan: ChainPlan, reference: Array, anchor: Anchor | None) -> Smoothed:
    """A solver: smooth step by step, in float64.

    `reference` is not used.
    """
    return Smoothed.of(plan, forward.stored(plan, anchor))


def _scanned(plan: ChainPlan, reference: Array, anchor: Anchor | None) -> Smoothed:
    """A solver: smooth by a parallel scan, in float64.

    Slices are counted from `reference`.
    """
    return Smoothed.of(plan, parallel.filtered(plan, reference, anchor))


def _careful(plan: ChainPlan, reference: Array, anchor: Anchor | None) -> CarefulSmoothed:
    """A solver: smooth step by step, in pairs of float64.

    `reference` is not used.
    """
    return CarefulSmoothed.of(plan, careful.sweep(plan, None, anchor)[0])


def covariances(plan: ChainPlan, reference: Array, *, careful: bool) -> tuple[Array, Array]:
    """The smoothed covariances of slices (T+1, runs, ...) and of pairs (T, runs, ...).

    They are of the plan as it is linearised; with `careful`, by a pass in twice the digits.
    """
    if careful:
        found = _careful(plan, reference, None)
        return found.beliefs.cov, found.pairs()
    swept_ = swept(plan, reference, None)
    reverse = swept_.reversed_of(plan)
    return swept_.beliefs.cov, backward.pairs(swept_.beliefs, reverse, slice(None)).cov


def _is_long(plan: ChainPlan) -> bool:
    """Whether a scan is faster than a sweep: 64 steps or more, of at most 200 numbers each.

    The numbers are the components of the slices of all runs.
    """
    return plan.steps >= _MANY_STEPS and plan.runs * plan.layout.slice_size <= _FEW_NUMBERS


def _in_rounds(plan: ChainPlan, reference: Array, anchor: Anchor | None) -> Smoothed:
    """A solver: smooth by a parallel scan, or step by step where a scan does not serve.

    A scan does not serve where measurements have singular or correlated noise, and where a step has
    no element of the scan, since a covariance is indefinite or not finite. Slices are counted from
    `reference`.
    """
    readings = Readings.of(plan, reference)
    if readings.stacks:
        return swept(plan, reference, anchor)
    try:
        with np.errstate(all="ignore"):  # elements that are not finite are refused
            ahead = parallel.filtered(plan, reference, anchor, readings)
    except NumericalError:
        return swept(plan, reference, anchor)
    return Smoothed.of(plan, ahead)


@dataclass(eq=False)
class Chain(Generic[Either]):
    """A chain as a problem for `iterate`: linearised at any point, and solved.

    `at` (T+1, runs, n) are the means of the slices at which the plan was linearised last, which
    `linearise` and `begin` set. `solve` calls the `solver` with `at` as the reference. Where there
    is `machine` code it linearises, and finds costs.
    """

    plan: ChainPlan
    solver: Callable[[ChainPlan, Array, Anchor | None], Either]
    at: Array = field(default_factory=lambda: np.empty(0))
    machine: Linearised | None = None

    def linearise(self, at: Point, active: Mask | None) -> None:
        """Linearise every CPD at a point, and weigh the robust sightings there.

        Runs that are not `active` (runs,) keep their linearisations; None means all.
        """
        self.at, some = at.mean, None if active is None or active.all() else active
        if self.machine is not None:
            if self.machine.linearise(at, some):
                return
            self.machine.rebind()
        relinearise(self.plan, at, some)
        reweigh(self.plan, at, some)

    def begin(self, at: Point, *, reckoned: bool) -> None:
        """Linearise every CPD for the first time, in all runs, at a point.

        With `reckoned` the point is that of dead reckoning, too far from the measurements to weigh
        robust sightings there: all have the weight one.
        """
        if reckoned:
            relinearise(self.plan, at, None)
            self.at = at.mean
        else:
            self.linearise(at, None)

    @property
    def divides(self) -> bool:
        """Whether each run's linearisations depend on its own point alone.

        Graduated losses remember their stage, and points that are drawn anew for each run go by how
        many runs come before it.
        """
        every = self.plan.families
        return not (
            any(sensor.weights.noise.graduated for sensor in self.plan.robust)
            or any(getattr(family.lineariser, "fresh_per_run", False) for family in every)
        )

    def of_runs(self, runs: Integers) -> Chain[Either]:
        """The chain of some runs, which is still to be linearised."""
        plan = self.plan.of(runs)
        machine = None if self.machine is None else Linearised(plan)
        return Chain(plan, self.solver, machine=machine)

    def put_runs(self, runs: Integers, part: Chain[Either]) -> None:
        """Take over how `part`, the chain of these runs, was linearised last."""
        self.plan.put_runs(runs, part.plan)
        self.at = self.at.copy()
        self.at[:, runs] = part.at
        if self.machine is not None:
            self.machine.rebind()

    def settled(self) -> Mask | bool:
        """Whether graduated robust losses have reached the losses of the model, (runs,).

        A graduated loss begins wide, and is sharpened from one linearisation to the next. True for
        all runs where no sensor is robust.
        """
        return settled(self.plan)

    def solve(self, anchor: Anchor | None = None) -> Either:
        """The smoothed chain with the plan's linearisations, and an anchor's measurement, if any.

        There has to be a linearisation, by `linearise` or `begin`.
        """
        return self.solver(self.plan, self.at, anchor)

    def cost(self, at: Point) -> Array:
        """The cost of a trajectory, the means (T+1, runs, n) of `at`, (runs,).

        It is −2 ln p(trajectory, measurements) but for constants. Each CPD adds rᵀ Q⁺ r, with its
        residual r, its noise covariance Q as linearised, and the pseudo-inverse Q⁺. A robust
        measurement adds twice its loss, 2 ρ, instead. With rules that take expectations r is the
        child's mean less the expected function, under the covariances of `at`.
        """
        found = None if self.machine is None else self.machine.cost(at)
        return cost.trajectory(self.plan, at) if found is None else found

    def feasible(self, mean: Array, found: Point) -> Array:
        """The trajectory nearest to `mean` (T+1, runs, n) that satisfies the exact CPDs.

        Exact CPDs are the linear ones of singular noise. Distances are counted in standard
        deviations of `found`, the solution of the chain linearised at `mean`. A run that rounding
        leaves off the exact CPDs gets the means of `found`.
        """
        nearest, obeyed = exact_relations.projected(self.plan, mean, found.std)
        return np.where(obeyed[:, None], nearest, found.mean)


@dataclass(frozen=True, eq=False)
class _Means:
    """A problem for `iterate`: means alone, by the normal equations of the linearised `chain`."""

    chain: Chain[Smoothed]

    def linearise(self, at: Point, active: Mask | None) -> None:
        """Linearise every CPD of the chain at a point, and weigh the robust sightings there.

        Runs that are not `active` (runs,) keep their linearisations; None means all.
        """
        self.chain.linearise(at, active)

    def settled(self) -> Mask | bool:
        """Whether graduated robust losses have reached the losses of the model, (runs,).

        A graduated loss begins wide, and is sharpened from one linearisation to the next. True for
        all runs where no sensor is robust.
        """
        return self.chain.settled()

    def solve(self, anchor: Anchor | None = None) -> Means:
        """The means of the linearised chain, by its normal equations.

        A smoother finds them where rounding leaves the equations without a solution. `anchor` is
        not read, since these steps are not controlled.
        """
        plan, at = self.chain.plan, self.chain.at
        found = newton.step(plan, at)
        if found is not None:
            return found
        # Rounding has left the normal equations without a solution.
        solution = self.chain.solve()
        pair = plan.layout.state_size + plan.layout.slice_size
        return Means(solution.means, solution.point.std**2, Readings.of(plan, at), pair)

    def cost(self, at: Point) -> Array:
        """The cost of a trajectory, the means (T+1, runs, n) of `at`, (runs,).

        It is −2 ln p(trajectory, measurements) but for constants.
        """
        return self.chain.cost(at)

    def feasible(self, mean: Array, found: Point) -> Array:
        """The trajectory nearest to `mean` (T+1, runs, n) that satisfies the exact CPDs.

        Exact CPDs are the linear ones of singular noise. Distances are counted in standard
        deviations of `found`, the solution of the chain linearised at `mean`. A run that rounding
        leaves off the exact CPDs gets the means of `found`.
        """
        return self.chain.feasible(mean, found)


def relinearise(plan: ChainPlan, at: Point, active: Mask | None) -> None:
    """Linearise every CPD at a point, all steps in one call each.

    Measured angles are moved to the branch nearest the sensors' expected values at the point, and
    angles that CPDs predict to that of the point's means. Runs that are not `active` (runs,) keep
    their linearisations; None means all are active.
    """
    everything = slice(None)
    for link, mean, cov, child in cost.linked(plan, at):
        family = link.family
        if not family.exact:
            family.linearise(everything, mean, cov, active)
            family.to_chart(mean, child)
    for sensor in plan.sensors:
        family, parents = sensor.family, sensor.parents
        if not family.step.size:
            continue
        places = family.step - plan.first
        mean = gather(at.mean, places)[..., parents]
        if sensor.grouped:
            counts = np.diff(sensor.bounds)
            for count in np.unique(counts[counts > 0]):
                steps = np.flatnonzero(counts == count)
                linearise_grouped(sensor, steps, at.mean[steps], at.cov[steps], active)
        elif not family.exact:
            cov = at.cov[:1] if not family.needs_cov else gather(at.cov, places)
            cov = np.broadcast_to(cov, (family.step.size, *cov.shape[1:]))
            family.linearise(everything, mean, block(cov, parents, parents), active)
        sensor.move(everything, family.value(everything, mean), active)


def _start(plan: ChainPlan, start: Array) -> Point:
    """A start (T+1, runs, n) as a point of zero covariance, angles of states unwrapped.

    These angles begin within half a turn of the prior's means, and none turns by more than half a
    turn from one step to the next.
    """
    layout = plan.layout
    angles = angle_mask(layout.slice)
    angles[layout.control_places] = False
    if not angles.any():
        return _without_spread(plan, start)
    mean = start.copy()
    prior = mean[0].copy()
    prior[:, layout.state_places] = careful_chain.prior_mean(plan)
    mean[0] = nearest_branch(mean[0], prior, angles)
    mean[..., angles] = np.unwrap(mean[..., angles], axis=0)
    return _without_spread(plan, mean)


def dead_reckoning(plan: ChainPlan) -> Point:
    """The prior's means carried on by the transition's functions, as a point of zero covariance.

    Its means are (T+1, runs, n); angles that functions wrap are unwrapped.
    """
    layout = plan.layout
    front, states = layout.state_size, layout.state_places
    mean = np.zeros((plan.steps + 1, plan.runs, layout.slice_size))
    mean[0][:, states] = careful_chain.prior_mean(plan)
    rows = mean.transpose(0, 2, 1) if plan.batch else mean[:, 0]
    pair = np.empty((front + layout.slice_size, *plan.batch))
    for row in counted(range(plan.steps), "dead reckoning"):
        pair[:front] = rows[row][states]
        for link in plan.transition:
            at, parents = link.family.at(row, row + 1), pair[link.parents]
            if at.function is None:
                pair[link.child] = link.family.line(at, parents, parents).value
            else:
                value = components_first(at.function(components_last(parents, 1)), 1)
                turns = link.turning and turns_far(link, pair, value)
                pair[link.child] = on_chart(link, at, pair, value) if turns else value
        rows[row + 1] = pair[front:]
    return _without_spread(plan, mean)


def _without_spread(plan: ChainPlan, mean: Array) -> Point:
    """A point of linearisation with zero covariances, of means (T+1, runs, n).

    It serves Taylor's rule, which reads means alone.
    """
    size = plan.layout.state_size + plan.layout.slice_size
    return Point(
        mean,
        np.broadcast_to(0.0, (*mean.shape, mean.shape[-1])),
        np.broadcast_to(0.0, (plan.steps, plan.runs, size, size)),
    )
