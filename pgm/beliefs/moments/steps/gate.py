r"""Gates: sightings too far from their prediction are left out.

A sighting is one measurement of a sensor, a vector of components. At the predicted belief
N(μ, P) of a step, a sighting z that is linearised as ẑ + H (x − μ) + e, e ~ N(0, R), has the
innovation ν = z − ẑ with covariance S = H P Hᵀ + R. It is rejected where νᵀS⁻¹ν exceeds the χ²
quantile of the gate's probability, with as many degrees of freedom as components were measured
(Bar-Shalom, Li & Kirubarajan, 2001, 5.4). A rejected sighting counts as not measured in that run,
in this pass and in all later ones: it is masked out in the plan's sensors. Directions of which
nothing is known yet, given a flat prior, are not judged, and are no degrees of freedom: see
`diffuse`.

The gates that a user has `Asked` for are one probability for all sensors, or a mapping from gated
sensors' variables to theirs. Arrays of a step have the runs last: `batch` is () for one run, and
(runs,) for several.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from pgm.beliefs.moments.steps.diffuse import Diffuse
from pgm.beliefs.moments.steps.plan import ChainPlan
from pgm.beliefs.moments.steps.readings import Reading
from pgm.beliefs.moments.steps.vector import Measured, masked
from pgm.errors import EvidenceError
from pgm.factors.scope import namesake
from pgm.kernels import gaussian, mahalanobis, step
from pgm.kernels.arrays import Array, Integers, Kind, Mask, within
from pgm.kernels.dense import Stack
from pgm.linearisation.weights import by_sighting, own_blocks
from pgm.networks import DynamicBayesianNetwork
from pgm.posteriors.gate_record import GateRecord
from pgm.schedules.gates import gate_of
from pgm.variables import Variable

Asked = float | Mapping[Variable, float]


def require_sensors(model: DynamicBayesianNetwork, gate: object) -> None:
    """Refuse a gate for a variable that is no sensor of the model, with an EvidenceError."""
    for variable in gate if isinstance(gate, Mapping) else ():
        if variable not in model.sensors:
            raise EvidenceError(
                f"gate= names {variable!r}, which is no sensor of the model; it has "
                f"{list(model.sensors)}{namesake(variable, model.sensors)}",
                variable=variable,
            )


def prepare(plan: ChainPlan, gate: Asked | None) -> None:
    """Give each sensor that has a gate an empty record of decisions, and a mask to be written to.

    The mask, `taken`, marks the measured components that are not rejected. Sensors that have a
    record keep it; None for `gate` does nothing. A gate for a variable that is no sensor is refused
    with an EvidenceError.
    """
    if gate is None:
        return
    require_sensors(plan.layout.model, gate)
    for sensor in plan.sensors:
        own = gate_of(gate, sensor.variable)
        if own is None or sensor.gated is not None:
            continue
        taken: Mask = np.ones((*sensor.shape, sensor.height), dtype=bool)
        if sensor.taken is not None:
            taken &= sensor.taken
        sensor.gated = GateRecord.empty(own, taken.copy())
        sensor.taken = taken


def decide(
    gate: Asked,
    parts: Sequence[Reading],
    seen: Sequence[Measured],
    mean: Array,
    cov: Array,
    diffuse: Diffuse | None = None,
) -> list[Measured]:
    """Gate the measurements of a step; returns their linearisations with rejected ones masked out.

    `parts` are the readings, one for each sensor, and `seen` their linearisations; these and the
    result have the same order. The predicted belief has a mean (n, *batch) and a covariance
    (n, n, *batch); where a flat prior leaves a direction unknown, `diffuse` is the covariance
    instead, with the runs first. Rejected sightings are masked out in the readings and the plan's
    sensors, too, and the decisions recorded.
    """
    return [
        part_seen
        if (own := gate_of(gate, part.sensor.variable)) is None
        else _decided(own, part, part_seen, mean, cov, diffuse)
        for part, part_seen in zip(parts, seen, strict=True)
    ]


def _decided(
    gate: float,
    part: Reading,
    seen: Measured,
    mean: Array,
    cov: Array,
    diffuse: Diffuse | None,
) -> Measured:
    """Gate the sightings of one sensor at a step; `gate` is the probability.

    Returns the linearisation `seen` with rejected sightings masked out. The belief has the mean
    (n, *batch) and the covariance (n, n, *batch), or `diffuse`, runs first, where a flat prior
    leaves a direction unknown. Rejections and squares νᵀS⁻¹ν, (sightings, *batch), are recorded;
    a square is NaN where nothing was measured.
    """
    one_run = mean.ndim == 1 and diffuse is None
    if one_run and seen.taken is None and len(seen.value) == part.sensor.height:
        accepted = _accepted(gate, part, seen, mean, cov)
        if accepted is not None:
            return accepted
    sensor, record, batch = part.sensor, part.sensor.gated, mean.shape[1:]
    rows, height = slice(part.at.first, part.at.last), sensor.height
    count = len(seen.value) // height
    taken = part.taken
    if record is not None:  # which an earlier attempt may have written to
        taken = sensor._flat(record.given[rows])
        taken = None if taken.all() else taken
    given = seen._replace(taken=taken)
    if diffuse is None:
        square, number = squares(given, mean, cov, count)
    else:
        square, number = _diffuse_squares(given, mean, diffuse)
    rejected = square > limits(gate, height)[number]
    square = np.where(number > 0, square, np.nan)
    part.gate, part.gated = gate, (rejected, square)
    if record is not None:
        record.rejected[rows], record.square[rows] = (
            rejected.reshape(count, -1),
            square.reshape(count, -1),
        )
        assert sensor.taken is not None
        sensor.taken[rows] = record.given[rows] & ~record.rejected[rows][..., None]
    if rejected.any():
        there = np.ones((count, height, *batch), dtype=bool)
        if taken is not None:
            there &= taken.reshape(count, height, *(taken.shape[1:] or ()))
        taken = (there & ~rejected[:, None]).reshape(count * height, *batch)
    if rejected.any() or taken is not part.taken:
        part.take(taken)
    part.seen = seen if taken is seen.taken else seen._replace(taken=taken)
    return part.seen


def _accepted(
    gate: float, part: Reading, seen: Measured, mean: Array, cov: Array
) -> Measured | None:
    """Gate one sighting of one run, all of whose components are measured: the usual case.

    An accepted sighting is recorded, and returned as it is. The result is None if the sighting is
    rejected: then `_decided` goes on.
    """
    sensor, record = part.sensor, part.sensor.gated
    if not sensor.whole:
        mean, cov = mean[sensor.parents], within(cov, sensor.parents)
    spread = gaussian.predict(cov, seen.matrix, seen.noise)
    square = mahalanobis.squares(seen.residual(mean), spread)
    if not square <= limits(gate, sensor.height).item(sensor.height):
        return None
    found = np.array([square])
    part.gate, part.gated, part.seen = gate, (_TAKEN, found), seen
    if record is not None:
        row = part.at.first
        record.rejected[row], record.square[row] = False, square
        assert sensor.taken is not None
        sensor.taken[row] = record.given[row]
    return seen


# The mask of rejected sightings where one is accepted.
_TAKEN: Mask = np.zeros(1, dtype=bool)


def squares(seen: Measured, mean: Array, cov: Array, count: int) -> tuple[Array, Integers]:
    """νᵀS⁻¹ν of a sensor's `count` sightings at a step, and their numbers of measured components.

    Both results are (count, *batch). `seen` has the sightings as linearised, their components one
    after another. Components that were not measured do not count, so that νᵀS⁻¹ν is 0 if none was
    measured. The predicted belief over the slice has a mean (n, *batch) and a covariance (n, n,
    *batch).
    """
    sensor, height = seen.sensor, len(seen.value) // count
    matrix, residual, noise, _ = masked(seen, mean)
    if not sensor.whole:
        cov = within(cov, sensor.parents)
    # The sightings are an axis of the batch.
    slopes = np.moveaxis(matrix.reshape(count, height, *matrix.shape[1:]), 0, 2)
    blocks = noise.reshape(count, height, count, height, *noise.shape[2:])
    own = np.einsum("kikj...->ijk...", blocks)
    spread = gaussian.predict(cov[:, :, None], slopes, own)
    shape = count, *mean.shape[1:]
    each = _by_component(np.broadcast_to(residual, (count * height, *shape[1:])), height)
    square = np.asarray(mahalanobis.squares(each, spread))
    number = height if seen.taken is None else _by_component(seen.taken, height).sum(axis=0)
    return square, np.broadcast_to(number, shape)


def _by_component(array: npt.NDArray[Kind], height: int) -> npt.NDArray[Kind]:
    """A stacked array (k d, *batch) of k sightings as (d, k, *batch); `height` is d."""
    return array.reshape(-1, height, *array.shape[1:]).swapaxes(0, 1)


def _diffuse_squares(seen: Measured, mean: Array, belief: Diffuse) -> tuple[Array, Integers]:
    """νᵀS⁻¹ν of each sighting at a diffuse belief, (sightings, *batch), and its degrees of freedom.

    `seen` has the sightings of one sensor at a step as linearised. `mean` (n, *batch) is the
    predicted mean of the slice, and `belief` has its covariance, the runs first. Combinations of a
    sighting's components that depend on an unknown direction do not count.
    """
    sensor, batch = seen.sensor, mean.shape[1:]
    height = sensor.height
    matrix = by_sighting(seen.matrix, height, 1)
    residual = by_sighting(seen.residual(mean[sensor.parents]), height, 0)
    noise = own_blocks(seen.noise, height)
    number: Integers | int = height
    if seen.taken is not None:
        taken = by_sighting(seen.taken, height, 0)
        found = step.seen(taken, Stack.column(residual), Stack(matrix), Stack(noise))
        residual, matrix, noise = found.residual.vector, found.matrix.array, found.noise.array
        number = taken.sum(axis=-1)
    residual, spread, unknown = belief.of(sensor.parents).innovations(matrix, residual, noise)
    square = step.innovation(Stack.column(residual), Stack(spread, True)).square
    count = np.broadcast_to(number - unknown, square.shape)
    return square.reshape(-1, *batch), count.reshape(-1, *batch)


@lru_cache(maxsize=64)
def limits(gate: float, height: int) -> Array:
    """The χ² quantiles of the probability `gate` for 0..height degrees of freedom, (height + 1,).

    The entry for 0 is infinite, so that a sighting without measured components passes.
    """
    limits = np.full(height + 1, np.inf)
    limits[1:] = mahalanobis.square_within(gate, np.arange(1, height + 1))
    return limits
