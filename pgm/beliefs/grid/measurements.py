r"""The beliefs of a grid before each step's measurements, and without each of these.

Cells are c, the predicted belief of a step α⁻(c), and the message of later measurements β(c). A
reading z_k of the step has, given all others,

.. math:: p(z_k \mid z_j, j \ne k) \propto \sum_c p(z_k \mid c) \, α^-(c) \, β(c)
          \prod_{j \ne k} p(z_j \mid c)

with a product over the other readings of the step. Nothing is divided by the reading's own density,
which may be zero where the others put the state. Predicted beliefs are made again from the filtered
ones, (runs, T + 1, *cells), and messages are of all cells of the lattice.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import numpy.typing as npt

from pgm.beliefs.grid.cloud import CellClouds
from pgm.beliefs.grid.lattice import Lattice
from pgm.beliefs.grid.residuals import Residuals, exponents
from pgm.beliefs.grid.sensors import likelihood
from pgm.beliefs.grid.slices import GridModel, GridSlices
from pgm.beliefs.points.measurements import left_out
from pgm.beliefs.points.model import ParticleModel
from pgm.beliefs.points.point_mixture import PointMixture
from pgm.compile import DynamicGraph
from pgm.errors import NumericalError
from pgm.evidence import BoundEvidence
from pgm.kernels.arrays import Array
from pgm.progress import counted
from pgm.variables import Variable

Values = npt.NDArray[Any]


def predicted(
    lattice: Lattice, graph: DynamicGraph, bound: BoundEvidence, filtered: Values
) -> Values:
    """The predicted beliefs of all steps, of sum one, from the filtered ones."""
    model, found = GridModel(lattice, graph.model, bound), np.empty(filtered.shape, filtered.dtype)
    for run in counted(range(bound.runs), "runs"):
        slices = GridSlices(model, run)
        for step in range(bound.steps + 1):
            before = filtered[run, step - 1].astype(np.float64) if step else None
            belief = slices.prior() if before is None else slices.forward(step, before)
            found[run, step] = belief / belief.sum()
    return found


def without_each(
    lattice: Lattice, graph: DynamicGraph, bound: BoundEvidence, ahead: Values
) -> dict[Variable, PointMixture]:
    """By sensor, the beliefs of its readings in the order of the evidence, each left out.

    `ahead` are the predicted beliefs. A NumericalError refuses readings that contradict each other
    by more than float64 has numbers for.
    """
    model = GridModel(lattice, graph.model, bound)
    rows = [len(sensor.reading.step) for sensor in model.sensors]
    found = [np.empty((bound.runs, count, *lattice.shape), ahead.dtype) for count in rows]
    for run in counted(range(bound.runs), "runs"):
        for place, row, belief in _of_run(model, run, ahead[run]):
            found[place][run, row] = belief
    points = ParticleModel(graph.model, bound, np.float64)
    return {
        sensor.reading.cpd.child: left_out(points, sensor.reading, CellClouds(lattice, values))
        for sensor, values in zip(model.sensors, found, strict=True)
    }


def _of_run(model: GridModel, run: int, ahead: Values) -> Iterator[tuple[int, int, Array]]:
    """The place of a sensor, a row of its reading, and the belief (*cells) without that reading."""
    lattice, whole = model.lattice, model.lattice.whole
    message: Array = np.ones(lattice.shape)
    for step in range(model.bound.steps, -1, -1):
        if step < model.bound.steps:
            weights = likelihood(model.sensors, step + 1, run, whole).values
            message = message if weights is None else message * weights
            made = model.motion.at(step + 1, run, whole)
            message = lattice.put(made.backward(lattice.cut(message, made.target)), whole)
            message /= message.max()
        joint = ahead[step] * message
        read = [(k, row) for k, sensor in enumerate(model.sensors) for row in sensor.rows(step)]
        terms = [model.sensors[k].terms(row, run, whole)[0] for k, row in read]
        for place, (k, row) in enumerate(read):
            others = [term for own in terms[:place] + terms[place + 1 :] for term in own]
            yield k, row, _times(model, joint, others, k, step)


def _times(model: GridModel, joint: Array, terms: list[Residuals], k: int, step: int) -> Array:
    """A belief (*cells) times the density of other readings, of sum one."""
    if terms:
        levels = np.where(joint > 0.0, exponents(terms, joint.shape), -np.inf)
        joint = joint * np.exp(levels - np.where(np.isfinite(levels.max()), levels.max(), 0.0))
    total = joint.sum()
    if not total > 0.0:
        variable = model.sensors[k].reading.cpd.child
        raise NumericalError(
            f"left_out[{variable!r}]: the other readings are so far from each other that float64 "
            f"has no probability of a cell at step {step} given these; look for a mistaken one, or "
            "smooth again without this one, NaN in its place",
            variable=variable,
            step=step,
        )
    found: Array = joint / total
    return found
