"""Running a schedule on a cluster graph of a Gaussian network."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TypeVar

import numpy as np

from pgm.clustergraph import ClusterGraph
from pgm.cpds import AffineCPD
from pgm.errors import EvidenceError, NumericalError
from pgm.evidence import Evidence
from pgm.evidence.arrays import as_rows, require_finite
from pgm.evidence.continuous import BoundValues, bind_values
from pgm.inference.gaussian import careful
from pgm.inference.gaussian.beliefs import Beliefs, relinearise
from pgm.inference.gaussian.buffer import Buffer
from pgm.inference.gaussian.certificate import SAFE_DIGITS, kept_digits
from pgm.inference.gaussian.layout import Layout, barren, known_parents
from pgm.inference.gaussian.messages import RowMessages
from pgm.inference.gaussian.model import Model
from pgm.inference.gaussian.posterior import GaussianPosterior
from pgm.inference.gaussian.tree import Calibrated, TreePlan, calibrate
from pgm.inference.limits import require_runs, require_size
from pgm.inference.loopy import run_loopy
from pgm.inference.schedule import Calibration, Loopy, Schedule
from pgm.inference.start import Start, over_runs, require_hidden
from pgm.inference.status import Status
from pgm.kernels import moments
from pgm.kernels.arrays import Array, quiet
from pgm.linearisers import Lineariser
from pgm.variables import Variable


def run(
    graph: ClusterGraph,
    evidence: Evidence,
    schedule: Schedule | None,
    lineariser: Lineariser,
    start: Start | None,
) -> GaussianPosterior:
    """Send the messages of a schedule; see `pgm.infer`."""
    network = graph.network
    absent = barren(network, evidence)
    cpds = [cpd for cpd in network.cpds if cpd.child not in absent]
    inputs = set(network.inputs)
    needed = (v for cpd in cpds for v in known_parents(cpd, inputs))
    bound = bind_values(network.cpds, evidence, network.lead, needed)
    plan = graph.derived(_plan, frozenset(bound.values), absent)
    linear = all(isinstance(cpd, AffineCPD) for cpd in cpds)
    squares = [size * size for size in plan.places.sizes]
    require_size(graph, squares, "covariances")
    require_runs(sum(squares), 1 if linear else bound.runs, "the covariances of all clusters")
    given = None if start is None else _start(plan.layout, bound, start)
    if isinstance(schedule, Loopy):
        with quiet():
            model = Model.make(plan.layout, bound, lineariser, given)
            messages = RowMessages.make(plan.rounds, plan.places, model, schedule.damping)
            status = run_loopy(messages, schedule, model.lead)
            found = GaussianPosterior.loopy(plan, messages, status)
            digits = kept_digits(messages.buffer, found._beliefs, found._log_evidence)
        if digits >= SAFE_DIGITS or not status.converged.all():
            return found
        return replace(found, status=status.with_digits(np.full(bound.lead, digits)))
    calibration = schedule if isinstance(schedule, Calibration) else Calibration()
    failure: NumericalError | None = None
    with quiet():
        try:
            found, digits = _in_floats(plan, bound, lineariser, given, calibration)
            if digits >= SAFE_DIGITS:
                return found
        except NumericalError as error:
            failure = error
        if careful.work(plan.layout, bound.runs, linear) <= careful.MOST_WORK:
            return _in_digits(plan, bound, lineariser, given, calibration)
    if failure is not None:
        raise failure
    return replace(found, status=found.status.with_digits(np.full(bound.lead, digits)))


def _plan(
    graph: ClusterGraph, observed: frozenset[Variable], absent: frozenset[Variable]
) -> TreePlan:
    return TreePlan(Layout(graph, observed, absent))


def _in_floats(
    plan: TreePlan,
    bound: BoundValues,
    lineariser: Lineariser,
    start: Array | None,
    schedule: Calibration,
) -> tuple[GaussianPosterior, float]:
    """The posterior of a tree, and the digits of its means that float64 leaves at least."""
    model = Model.make(plan.layout, bound, lineariser, start)
    buffer = Buffer.make(plan.rounds, model)
    done, status = _calibrate(lambda: calibrate(plan, buffer), buffer.refresh, model, schedule)
    return GaussianPosterior.tree(plan, buffer, done, status), kept_digits(
        buffer, done.beliefs, done.log_evidence
    )


def _in_digits(
    plan: TreePlan,
    bound: BoundValues,
    lineariser: Lineariser,
    start: Array | None,
    schedule: Calibration,
) -> GaussianPosterior:
    """The same in as many digits as it takes."""
    model = Model.make(plan.layout, bound, lineariser, start, careful.predictive)
    done, status = _calibrate(lambda: careful.solve(plan, model), None, model, schedule)
    return GaussianPosterior.careful(
        plan, model, done, status.with_digits(done.digits.reshape(model.lead))
    )


Solved = TypeVar("Solved", Calibrated, careful.Solution)


def _calibrate(
    solve: Callable[[], Solved],
    refresh: Callable[[], None] | None,
    model: Model,
    schedule: Calibration,
) -> tuple[Solved, Status]:
    """Solve, linearise at the beliefs, and solve again, until the means stay."""
    done = solve()
    residuals: list[Array] = []
    converged = np.full(model.runs, model.exact)
    while len(residuals) + 1 < schedule.iterations and not converged.all():
        before, _ = done.beliefs.components()
        relinearise(done.beliefs, model, ~converged)
        if refresh is not None:
            refresh()
        done = solve()
        residuals.append(_move(before, done.beliefs))
        converged = converged | (residuals[-1] <= schedule.tolerance)
    return done, Status.of(residuals, converged, model.lead)


def _move(before: Array, beliefs: Beliefs) -> Array:
    """The move of each run's means, (runs,), in standard deviations."""
    mean, std = beliefs.components()
    return moments.marginal_error(mean[None], before[None], std[None])


def _start(layout: Layout, bound: BoundValues, start: Start) -> Array:
    """Means of all hidden components, (runs, size); NaN of a child without one or children."""
    require_hidden(start, layout.places)
    mean = np.full((bound.runs, layout.size), np.nan)
    parents = {v for group in layout.groups for cpd in group.cpds for v in cpd.given}
    for variable in layout.hidden:
        if variable not in start:
            if variable not in parents:
                continue
            raise EvidenceError(
                f"start lacks {variable!r}; it takes means of all hidden parents",
                variable=variable,
            )
        row = as_rows(variable, start[variable], None)
        row = require_finite(variable, row[..., None, :])[..., 0, :]
        mean[:, layout.places[variable]] = over_runs(variable, row, bound.lead, 1)
    return mean
