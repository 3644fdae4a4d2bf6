"""The posterior of a static Gaussian network, by calibrating a tree or by rounds of messages.

A tree is solved, linearised at its beliefs, and solved again until its means stay. Small trees for
which float64 keeps too few digits are solved in decimals. `bound` is the evidence by variable, with
the axes of runs flattened to one.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple, Protocol

import numpy as np

from pgm.beliefs.gaussian import careful
from pgm.beliefs.gaussian.beliefs import Beliefs, Calibrated, TreePoint, relinearise
from pgm.beliefs.gaussian.certificate import are_few, cause, kept_digits
from pgm.beliefs.gaussian.layout import Layout, barren, knowing
from pgm.beliefs.gaussian.messages import RowMessages
from pgm.beliefs.gaussian.model import Model
from pgm.beliefs.gaussian.outcome import GaussianOutcome
from pgm.beliefs.gaussian.rounds import Rounds
from pgm.beliefs.gaussian.row_buffer import Buffer
from pgm.beliefs.gaussian.solving import TreeSolver
from pgm.beliefs.gaussian.tree import TreePlan
from pgm.clustergraph import ClusterGraph
from pgm.cpds import AffineCPD
from pgm.errors import EvidenceError, NumericalError
from pgm.evidence import Evidence
from pgm.evidence.rows import as_rows, require_finite
from pgm.evidence.static import BoundValues, Roles, bind_values, complete_rows
from pgm.kernels import last_place, moments
from pgm.kernels.arrays import Array, Mask, quiet
from pgm.kernels.settling import TOLERANCE
from pgm.linearisers import Lineariser
from pgm.posteriors.status import ENOUGH_DIGITS, LAST_PLACE, Status
from pgm.schedules.argument_checks import require_gaussian, require_plain
from pgm.schedules.iteration import Anchor, iterate
from pgm.schedules.limits import require_runs, require_size
from pgm.schedules.loopy import run_loopy
from pgm.schedules.schedule import Calibration, Loopy, Schedule, Smoothing
from pgm.schedules.starting_points import Start, over_runs, require_hidden
from pgm.tracing import Judge, judged
from pgm.variables import Variable


def run(
    graph: ClusterGraph,
    evidence: Evidence,
    schedule: Schedule | None,
    lineariser: Lineariser,
    start: Start | None,
) -> GaussianOutcome:
    """The posterior of a Gaussian network given evidence, by the messages of a schedule.

    Without a schedule the graph, a tree, is calibrated. `start` has the means of hidden variables
    at which nonlinear CPDs are linearised first; if it is None, they are linearised at the prior's
    moments. The posterior's status tells of convergence and of correct digits; fewer than six
    digits give a `PrecisionWarning`.
    """
    network = graph.network
    linear = graph.derived(_linear)
    absent = barren(graph, evidence)
    needed = (v for cpd, known in knowing(graph) if cpd.child not in absent for v in known)
    roles = graph.derived(_roles)
    bound = bind_values(network.cpds, evidence, network.lead, needed, roles)
    plan = graph.derived(_plan, frozenset(bound.values), absent)
    if absent and not linear:
        linear = all(isinstance(c, AffineCPD) for c in network.cpds if c.child not in absent)
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
    found.status._warn()
    return found


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
    loopy = isinstance(schedule, Loopy)
    try:
        model = Model.make(plan.layout, bound, lineariser, at, judge=judge)
        again = again and not model.flat  # decimals need a joint of all variables
        if isinstance(schedule, Loopy):
            found = _sent(plan, Buffer.make(plan.rounds, model), schedule)
        else:
            solver = TreeSolver(plan, model)
            done, status = _iterated(model, solver, schedule)
            status = status.with_compilation(solver.compilation)
            found = GaussianOutcome(graph, status, plan, model, done)
        digits = kept_digits(model, found._done)
        few = are_few(digits, found._done)
        enough = not few or (loopy and not found.status.converged.all())
        if not (few and again):
            lost = None if enough else np.full(bound.runs, 10.0**-digits)
            status = _told(found.status, model, found._done.beliefs, lost)
            return replace(found, status=status)
    except NumericalError:
        if not again:
            raise
    model = Model.make(plan.layout, bound, lineariser, at, careful.predictive, judge=judge)
    done, status = _iterated(model, _InDigits(plan, model), schedule)
    assert done.digits is not None
    status = _told(status, model, done.beliefs, 10.0**-done.digits)
    return GaussianOutcome(graph, status, plan, model, done)


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
    require_plain(cpds)
    return all(isinstance(cpd, AffineCPD) for cpd in cpds)


def _roles(graph: ClusterGraph) -> Roles:
    return Roles.of(graph.network.cpds)


def _plan(
    graph: ClusterGraph, observed: frozenset[Variable], absent: frozenset[Variable]
) -> TreePlan:
    """The plan of a graph's messages, for evidence of the `observed` variables.

    The `absent` variables, whose CPDs lack evidence that they need, are left out. The plan is kept
    with the graph.
    """
    return TreePlan(Layout(graph, observed, absent))


def _sent(plan: TreePlan, buffer: Buffer[Rounds], schedule: Loopy) -> GaussianOutcome:
    """The posterior by rounds of messages, on a graph that may have loops.

    Rounds are sent until no message changes by more than the schedule's tolerance, or its
    iterations are used up. `buffer` is that of the model, and still holds only zeros.
    """
    graph, model = plan.layout.graph, buffer.model
    messages = RowMessages.make(buffer, plan.cluster_places, schedule.damping)
    status = run_loopy(messages, schedule, model.lead)
    return GaussianOutcome(graph, status, plan, model, messages.calibrated(), messages)


@dataclass(frozen=True, eq=False)
class _Tree:
    """A tree that is solved and linearised in turns: a `Problem` of `pgm.schedules.iteration`.

    `solver` solves it with the CPDs of `model` as they are linearised now; it may be told that a
    solution is one `to_move` by, not to be given. Other problems have
    robust losses too, or anchors, which are measurements of all means added to hold a solution near
    a point; a tree has neither.
    """

    model: Model
    solver: Solver
    to_move: bool

    def linearise(self, at: TreePoint, active: Mask) -> None:
        """Linearise each nonlinear CPD anew at its cluster's belief in `at`, for the active runs.

        `active` (runs,) marks these runs.
        """
        relinearise(at.beliefs, self.model, active)

    def settled(self) -> bool:
        """Whether a run may converge: True, since no robust loss has to settle first."""
        return True

    def solve(self, anchor: Anchor | None = None) -> Calibrated:
        """Calibrate the tree with the CPDs as they are linearised now; `anchor` is ignored."""
        return self.solver.solve(to_move=self.to_move)


def _iterated(model: Model, solver: Solver, schedule: Schedule | None) -> tuple[Calibrated, Status]:
    """Solve, linearise at the beliefs, and solve again, until the means stay.

    They stay when no mean moves by more than the schedule's tolerance, in standard deviations. A
    schedule of k iterations solves at most k times, the first included. Any schedule but a
    `Calibration`, and None, counts as `Calibration()`. `solver` solves the tree with the CPDs as
    they are linearised now. Returns the last solution and the status of convergence.
    """
    asked = schedule if isinstance(schedule, Calibration) else Calibration()
    exact = np.full(model.runs, model.exact)
    if model.exact or asked.iterations == 1:
        return solver.solve(), Status.of([], exact, model.lead)
    tree = _Tree(model, solver, True)
    limits = Smoothing(asked.iterations, asked.tolerance)
    found = iterate(tree, tree.solve(), limits, exact)
    done, residuals, converged = solver.solve(), found.residuals, found.converged
    # The means of a solution that was one to move by may be wrong where it lost digits.
    off = moments.moved(done.means, found.solution.means, done.point.std)
    left = asked.iterations - 1 - len(residuals)
    if (off > max(asked.tolerance, TOLERANCE)).any() and left > 0:
        limits = Smoothing(left + 1, asked.tolerance)
        again = iterate(_Tree(model, solver, False), done, limits, exact)
        done, converged = again.solution, again.converged
        residuals = [*residuals, *again.residuals]
    return done, Status.of(residuals, converged, model.lead)


class Solver(Protocol):
    """A way to solve a tree as its CPDs are linearised now."""

    def solve(self, *, to_move: bool = False) -> Calibrated:
        """The beliefs; if it is one `to_move` by, maybe to fewer digits."""


class _InDigits(NamedTuple):
    """The solver in as many decimals as a network's numbers need."""

    plan: TreePlan
    model: Model

    def solve(self, *, to_move: bool = False) -> Calibrated:
        """The beliefs of the linearised network; all decimals are there if it is one to move by."""
        return _in_digits(self.plan, self.model)


def _in_digits(plan: TreePlan, model: Model) -> Calibrated:
    """The beliefs of the linearised network, in as many decimals as its numbers need."""
    found = careful.solve(plan, model)
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
