"""Robust noise of a network's measurements: who may have it, and the weights at a point.

A reading of robust noise counts as a Gaussian of covariance R / w, w being its weight at the means
where the network was linearised last. What the robust log-density has beside that Gaussian's is its
*surplus*, which the reading's factor has in its scale.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable

import numpy as np

from pgm.beliefs.gaussian.beliefs import TreePoint
from pgm.beliefs.gaussian.model import Model
from pgm.clustergraph import ClusterGraph
from pgm.cpds import CPD, ConditionalGaussian
from pgm.display import titled
from pgm.errors import ModelError
from pgm.kernels.arrays import Array, Mask
from pgm.linearisation.weights import shown
from pgm.posteriors.weights import Weights
from pgm.schedules.schedule import Calibration, Schedule
from pgm.variables import Variable


def require_weighable(
    graph: ClusterGraph,
    cpds: Iterable[CPD],
    observed: Collection[Variable],
    schedule: Schedule | None,
) -> None:
    """Refuse, by a ModelError, robust noise that iterations on a tree cannot weigh.

    That is noise of what was not `observed`, on a graph with loops, and under a schedule that
    linearises once: weights are found at the solution before.
    """
    for cpd in cpds:
        if not isinstance(cpd, ConditionalGaussian) or cpd.noise is None:
            continue
        what = f"{cpd!r} has robust noise, {cpd.noise!r}"
        if cpd.child not in observed:
            raise ModelError(
                f"{what}, and its child has no evidence: Gaussian beliefs weigh residuals of what "
                "was measured; leave noise= out, or give evidence; of a dynamic network "
                "belief=pgm.Particles(...) and pgm.Grid(...) take robust noise of motions",
                variable=cpd.child,
                cpd=cpd,
            )
        if not isinstance(schedule, Calibration | None) or not graph.is_tree:
            raise ModelError(
                f"{what}, whose weights messages round {titled(graph)} do not find: compile a "
                "junction tree, pgm.compile(network), and give "
                "schedule=pgm.Calibration(iterations=50)",
                variable=cpd.child,
                cpd=cpd,
            )
        if schedule is None or schedule.iterations == 1:
            raise ModelError(
                f"{what}, whose weights are found by iterations, each at the solution before: give "
                "schedule=pgm.Calibration(iterations=50)",
                variable=cpd.child,
                cpd=cpd,
            )


def reweigh(model: Model, at: TreePoint, active: Mask, *, sharp: bool = False) -> None:
    """Weigh all robust readings at a point, where the model was linearised, in the active runs.

    Their noise in the model becomes R / w, plus the covariance of the linearisation's error. The
    runs that `active` (runs,) does not mark keep their weights and noise. If `sharp`, graduated
    losses are at once those of the user's model.
    """
    for g, weights in enumerate(model.weights):
        if weights is None:
            continue
        if sharp:
            weights.stage = np.full(model.runs, np.inf)
        family = model.families[g]
        error = None if family.taylor else family.noise - family.own_noise
        weights.take(_squares(model, g, at, error), active)
        noise = weights.scaled(family.own_noise)
        if error is not None:
            noise = noise + error
        family.keep_errors()
        family.noise[...] = np.where(active[:, None, None], noise, family.noise)


def _squares(model: Model, g: int, at: TreePoint, error: Array | None) -> Array:
    """The squares νᵀR⁻¹ν of the residuals ν of group g by its linearisation, (CPDs, runs).

    By Taylor's rule ν is the residual of the point's means; with a lineariser that takes
    expectations the squares are expected under its beliefs, and `error` (CPDs, runs, d, d) is the
    covariance of the approximation error, None for zero.
    """
    family, reading, weights = model.families[g], model.moved[g], model.weights[g]
    assert reading is not None
    assert weights is not None
    mean, cov = at.of_parents(model.layout, g)
    residual = reading - family.value(slice(None), mean)
    if not family.expects:
        return weights.squares(residual)
    return weights.squares(residual, family.matrix, cov, error)


def settled(model: Model) -> Mask | bool:
    """Whether graduated losses have reached the losses of the user's model, (runs,); True for all.

    A graduated loss begins wide, and is sharpened from one linearisation to the next.
    """
    found: Mask | bool = True
    for weights in model.weights:
        if weights is not None:
            found = found & weights.staged
    return found


def weights_shown(model: Model) -> Weights:
    """The weight of each reading, (*runs): 1 of Gaussian noise, NaN where nothing was measured."""
    found: dict[Variable, Array] = {}
    every = zip(model.layout.groups, model.families, model.weights, model.taken, strict=True)
    for group, family, weights, taken in every:
        if group.observed:
            if not np.isfinite(family.own_noise).all():
                taken = None  # of a flat prior, which says nothing of what was measured
            shape = len(group.cpds), model.runs
            weight = np.ones(shape) if weights is None else weights.weight
            rows = np.broadcast_to(shown(weight, taken), shape)
            each = zip(group.cpds, rows, strict=True)
            found |= {cpd.child: row.reshape(model.lead).copy() for cpd, row in each}
    return Weights(found)
