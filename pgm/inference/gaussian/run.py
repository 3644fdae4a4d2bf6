"""Running a schedule on a cluster graph of a Gaussian network."""

from __future__ import annotations

import numpy as np

from pgm.clustergraph import ClusterGraph
from pgm.cpds import AffineCPD
from pgm.errors import EvidenceError
from pgm.evidence import Evidence
from pgm.evidence.arrays import as_rows, require_finite
from pgm.evidence.continuous import BoundValues, bind_values
from pgm.inference.gaussian.beliefs import Beliefs, relinearise
from pgm.inference.gaussian.buffer import Buffer
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
from pgm.kernels.arrays import Array
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
    model = Model.make(plan.layout, bound, lineariser, given)
    if isinstance(schedule, Loopy):
        messages = RowMessages.make(plan.rounds, plan.places, model, schedule.damping)
        status = run_loopy(messages, schedule, model.lead)
        return GaussianPosterior.loopy(plan, messages, status)
    calibration = schedule if isinstance(schedule, Calibration) else Calibration()
    buffer = Buffer.make(plan.rounds, model)
    done, status = _calibrate(plan, buffer, calibration)
    return GaussianPosterior.tree(plan, buffer, done, status)


def _plan(
    graph: ClusterGraph, observed: frozenset[Variable], absent: frozenset[Variable]
) -> TreePlan:
    return TreePlan(Layout(graph, observed, absent))


def _calibrate(plan: TreePlan, buffer: Buffer, schedule: Calibration) -> tuple[Calibrated, Status]:
    """Calibrate, linearise at the beliefs, and calibrate again, until the means stay."""
    model = buffer.model
    done = calibrate(plan, buffer)
    residuals: list[Array] = []
    converged = np.full(model.runs, model.exact)
    while len(residuals) + 1 < schedule.iterations and not converged.all():
        before, _ = done.beliefs.components()
        relinearise(done.beliefs, model, ~converged)
        buffer.refresh()
        done = calibrate(plan, buffer)
        residuals.append(_move(before, done.beliefs))
        converged = converged | (residuals[-1] <= schedule.tolerance)
    return done, Status.of(residuals, converged, model.lead)


def _move(before: Array, beliefs: Beliefs) -> Array:
    """How far the means of each run moved, (runs,), in standard deviations."""
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
