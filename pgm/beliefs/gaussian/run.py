"""The posterior of a static Gaussian network, by calibrating a tree or by rounds of messages.

A tree is solved, linearised at its beliefs, and solved again until its means stay. Small trees for
which float64 keeps too few digits are solved in decimals. `bound` is the evidence by variable, with
the axes of runs flattened to one.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np

from pgm.beliefs.gaussian import careful
from pgm.beliefs.gaussian.beliefs import Beliefs, Calibrated
from pgm.beliefs.gaussian.certificate import are_few, cause, kept_digits
from pgm.beliefs.gaussian.iterated import is_controlled, iterated
from pgm.beliefs.gaussian.layout import Layout, barren, knowing, robust
from pgm.beliefs.gaussian.messages import RowMessages
from pgm.beliefs.gaussian.model import Model
from pgm.beliefs.gaussian.outcome import GaussianOutcome
from pgm.beliefs.gaussian.reweighting import require_weighable
from pgm.beliefs.gaussian.rounds import Rounds
from pgm.beliefs.gaussian.row_buffer import Buffer
from pgm.beliefs.gaussian.solving import TreeSolver, may_be_large
from pgm.beliefs.gaussian.tree import TreePlan
from pgm.clustergraph import ClusterGraph
from pgm.cpds import AffineCPD
from pgm.errors import EvidenceError, NumericalError
from pgm.evidence import Evidence
from pgm.evidence.rows import as_rows, require_finite
from pgm.evidence.static import BoundValues, Roles, bind_values, complete_rows
from pgm.kernels import last_place
from pgm.kernels.arrays import Array, quiet
from pgm.linearisers import Lineariser
from pgm.posteriors.status import ENOUGH_DIGITS, LAST_PLACE, Status
from pgm.schedules.argument_checks import require_gaussian
from pgm.schedules.iteration import Anchor
from pgm.schedules.limits import require_runs, require_size
from pgm.schedules.loopy import run_loopy
from pgm.schedules.schedule import Loopy, Schedule
from pgm.schedules.starting_points import Start, over_runs, require_hidden
from pgm.tracing import Judge, judged
from pgm.variables import Variable


def run(
    graph: ClusterGraph,
    evidence: Evidence,
    schedule: Schedule | None,
    lineariser: Lineariser,
    start: Start | None,
    *,
    warn: bool = True,
) -> GaussianOutcome:
    """The posterior of a Gaussian network given evidence, by the messages of a schedule.

    Without a schedule the graph, a tree, is calibrated. `start` has the means of hidden variables
    at which nonlinear CPDs are linearised first; if it is None, they are linearised at the prior's
    moments. The posterior's status tells of convergence and of correct digits; fewer than six
    digits give a `PrecisionWarning`, unless `warn` leaves that to the caller.
    """
    plan, bound, linear = _laid_out(graph, evidence, schedule)
    loopy = isinstance(schedule, Loopy)
    places = plan.cluster_places if loopy else plan.places
    squares = (places.blocks.sizes**2).tolist()
    require_size(graph, squares, "covariances")
    require_runs(sum(squares), 1 if linear else bound.runs, "the covariances of all clusters")
    at = None if start is None else _start(plan.layout, bound, start)
    again = not loopy and careful.work(plan.layout, bound.runs, linear) <= careful.MOST_WORK
    with quiet():
        for judge in judged():
            with judge:
                found = _solved(graph, plan, bound, schedule, lineariser, at, again, judge)
    if warn:
        found.status._warn()
    return found


@quiet()
def linearised(
    graph: ClusterGraph, evidence: Evidence, schedule: Schedule, lineariser: Lineariser
) -> tuple[Model, BoundValues]:
    """A network linearised at its prior, with its evidence; nothing is solved."""
    plan, bound, _ = _laid_out(graph, evidence, schedule)
    return Model.make(plan.layout, bound, lineariser, None), bound


def _laid_out(
    graph: ClusterGraph, evidence: Evidence, schedule: Schedule | None
) -> tuple[TreePlan, BoundValues, bool]:
    """The plan of a network with its evidence, and whether all that is not left out is linear."""
    network = graph.network
    linear = graph.derived(_linear)
    absent = barren(graph, evidence)
    weighed = [cpd for cpd in robust(graph) if cpd.child not in absent]
    require_weighable(graph, weighed, evidence, schedule)
    needed = (v for cpd, known in knowing(graph) if cpd.child not in absent for v in known)
    roles = graph.derived(_roles)
    bound = bind_values(network.cpds, evidence, network.lead, needed, roles)
    if absent and not linear:
        linear = all(isinstance(c, AffineCPD) for c in network.cpds if c.child not in absent)
    linear = linear and not weighed
    anchored = not linear and is_controlled(schedule)
    plan = graph.derived(_plan, frozenset(bound.values), absent, anchored)
    return plan, bound, linear


def _solved(
    graph: ClusterGraph,
    plan: TreePlan,
    bound: BoundValues,
    schedule: Schedule | None,
    lineariser: Lineariser,
    at: Array | None,
    again: bool,
    judge: Judge,
) -> GaussianOutcome:
    """The posterior in float64, or, where float64 fails or keeps too few digits, in decimals.

    `again` says whether the calculation may be repeated in decimals, which small networks allow.
    Otherwise a failure in float64 is raised, and where digits are too few the posterior's status
    has their number, for the caller to warn. `at` are the means of a start for all hidden
    components, (runs, size); None to start from the prior. Where nonlinear functions were traced,
    `judge` compares what the traces gave with the functions, when this call is done.
    """
    make = partial(Model.make, plan.layout, bound, lineariser, at, judge=judge)
    loopy = isinstance(schedule, Loopy)
    try:
        model = make(hidden_noise=not loopy and may_be_large(plan))
        again = again and not model.flat  # decimals need a joint of all variables
        if isinstance(schedule, Loopy):
            found = _sent(plan, Buffer.make(plan.rounds, model), schedule)
        else:
            found = _calibrated(graph, plan, model, make, schedule, started=at is not None)
        digits, few = _digits(found)
        enough = not few or (loopy and not found.status.converged.all())
        if not (few and again):
            lost = None if enough else np.full(bound.runs, 10.0**-digits)
            status = _told(found.status, found._model, found._done.beliefs, lost)
            return replace(found, status=status)
    except NumericalError:
        if not again:
            raise
    model = make(careful.predictive)
    solution = _InDigits(plan, model)
    done, status = iterated(model, solution, schedule, started=at is not None)
    assert done.digits is not None
    status = _told(status, model, done.beliefs, 10.0**-done.digits)
    return GaussianOutcome(graph, status, plan, model, done)


def _digits(found: GaussianOutcome) -> tuple[float, bool]:
    """The digits that a solution in float64 keeps, and whether they are few."""
    digits = kept_digits(found._model, found._done)
    return digits, are_few(digits, found._done)


def _calibrated(
    graph: ClusterGraph,
    plan: TreePlan,
    model: Model,
    make: Callable[..., Model],
    schedule: Schedule | None,
    *,
    started: bool,
) -> GaussianOutcome:
    """The posterior by calibrating a tree, in which hidden noise was integrated out or not.

    It stays in the tree where that keeps more digits: if it is much sharper than all else is known.
    `make` makes the model anew.
    """
    solver = TreeSolver.of(plan, model)
    if solver.plan.noise is not None or model.frame.by_noise:
        with suppress(NumericalError):
            found = _iterated(graph, solver, schedule, started=started)
            if not _digits(found)[1]:
                return found
        solver = TreeSolver(plan, make())
    return _iterated(graph, solver, schedule, started=started)


def _iterated(
    graph: ClusterGraph, solver: TreeSolver, schedule: Schedule | None, *, started: bool
) -> GaussianOutcome:
    done, status = iterated(solver.model, solver, schedule, started=started)
    status = status.with_compilation(solver.compilation)
    return GaussianOutcome(graph, status, solver.plan, solver.model, done)


def _told(status: Status, model: Model, beliefs: Beliefs, lost: Array | None) -> Status:
    """The status with the correct digits of the means, which two errors limit.

    One is the error of the computation, `lost` (runs,), in standard deviations of the means; it is
    None if it leaves enough digits. The other is the rounding of the means of `beliefs` to float64,
    half of the last place. If `lost` is None and the rounding is at most 10⁻⁶ standard deviations
    in each run, the status is returned as it is.
    """
    place = last_place.rounding(*beliefs.components(), model.frame.scale)
    if lost is not None:
        status = status._losing(lost, cause(model))
    elif not (place > 10.0**-ENOUGH_DIGITS).any():
        return status
    return status._losing(np.broadcast_to(place, (model.runs,)), LAST_PLACE)


def _linear(graph: ClusterGraph) -> bool:
    """Whether all CPDs are affine; those that Gaussian beliefs do not take are refused."""
    cpds = graph.network.cpds
    require_gaussian(cpds, "Gaussian beliefs")
    return all(isinstance(cpd, AffineCPD) for cpd in cpds)


def _roles(graph: ClusterGraph) -> Roles:
    return Roles.of(graph.network.cpds)


def _plan(
    graph: ClusterGraph,
    observed: frozenset[Variable],
    absent: frozenset[Variable],
    anchored: bool,
) -> TreePlan:
    """The plan of a graph's messages, for evidence of the `observed` variables.

    The `absent` variables, whose CPDs lack evidence that they need, are left out. If `anchored`, an
    anchor's measurements can be added. The plan is kept with the graph.
    """
    return TreePlan(Layout(graph, observed, absent, anchored))


def _sent(plan: TreePlan, buffer: Buffer[Rounds], schedule: Loopy) -> GaussianOutcome:
    """The posterior by rounds of messages, on a graph that may have loops.

    Rounds are sent until no message changes by more than the schedule's tolerance, or its
    iterations are used up. `buffer` is that of the model, and still holds only zeros.
    """
    graph, model = plan.layout.graph, buffer.model
    messages = RowMessages.make(buffer, plan.cluster_places, schedule.damping)
    status = run_loopy(messages, schedule, model.lead)
    return GaussianOutcome(graph, status, plan, model, messages.calibrated(), messages)


class _InDigits(NamedTuple):
    """The solver in as many decimals as a network's numbers need."""

    plan: TreePlan
    model: Model

    def solve(self, anchor: Anchor | None = None, *, to_move: bool = False) -> Calibrated:
        """The beliefs of the linearised network; all decimals are there if it is one to move by."""
        found = careful.solve(self.plan, self.model, anchor)
        return Calibrated(found.beliefs, found.log_evidence, digits=found.digits)


def _start(layout: Layout, bound: BoundValues, start: Start) -> Array:
    """The means of all hidden components at a start, (runs, size).

    `start` maps hidden variables to means, and needs all that are parents: one that is missing is
    an EvidenceError. The means of other hidden variables that it lacks are NaN.
    """
    require_hidden(start, layout.places)
    mean = np.full((bound.runs, layout.size), np.nan)
    complete = complete_rows(start)
    missing = [variable for variable in layout.hidden if variable not in start]
    if missing:
        parents = {v for group in layout.groups for cpd in group.cpds for v in cpd.given}
        for variable in missing:
            if variable in parents:
                raise EvidenceError(
                    f"start lacks {variable!r}; it takes means of all hidden parents",
                    variable=variable,
                )
    if complete and len(complete) == len(layout.hidden):
        mean[:] = np.concatenate([complete[variable] for variable in layout.hidden], axis=1)
        return mean
    for variable in layout.hidden:
        if variable in complete:
            mean[:, layout.places[variable]] = complete[variable]
            continue
        if variable not in start:
            continue
        row = as_rows(variable, start[variable], None)
        row = require_finite(variable, row[..., None, :])[..., 0, :]
        mean[:, layout.places[variable]] = over_runs(variable, row, bound.lead, 1)
    return mean
