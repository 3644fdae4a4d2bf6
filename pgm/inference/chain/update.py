"""Readings: stacked as one, taken into a belief, refused where they cannot be."""

from __future__ import annotations

import numpy as np

from pgm.errors import NumericalError
from pgm.inference.chain import grouped
from pgm.inference.chain.plan import Seen, Sensor
from pgm.kernels import moments, roots
from pgm.kernels.arrays import LOG_2PI, Array, Index, Mask, apply, block

# A reading this far from what an exact model says, as a part of the numbers' size, contradicts it.
CONTRADICTION = 1e-8
# Below this relative pivot the joint covariance of several readings costs too many digits.
NEARLY_SINGULAR = 1e-6

Due = list[tuple[Sensor, slice]]


def update(due: Due, step: int, mean: Array, cov: Array) -> tuple[Array, Array, Array]:
    """Moments of the slice given the readings of a step, and the readings' log-density."""
    if not due:
        return mean, cov, np.zeros(mean.shape[0])
    result = _absorb(due, step, mean, cov)
    if result is None:
        result = mean, cov, np.zeros(mean.shape[0])
        for each in _singly(due, step):
            absorbed = _absorb(each, step, *result[:2], last=True)
            assert absorbed is not None
            result = absorbed[0], absorbed[1], result[2] + absorbed[2]
    return result


def _absorb(
    due: Due, step: int, mean: Array, cov: Array, *, last: bool = False
) -> tuple[Array, Array, Array] | None:
    """Take all readings in as one; None where their joint covariance is too nearly singular.

    Several sharp readings of what is hardly known are better taken in one by one, which is equal
    but for rounding.
    """
    matrix, residual, noise, missing = stack(due, step, mean)
    exact = any(sensor.exact for sensor, _ in due)
    result = moments.update(mean, cov, matrix, residual, noise, exact=exact)
    if not np.isfinite(result.log_density.sum()):
        refuse_indefinite(due)
    several = len(due) > 1 or due[0][1].stop - due[0][1].start > 1
    if several and not last and roots.smallest_pivot(result.lower) < NEARLY_SINGULAR:
        return None
    if result.left is not None:
        refuse_contradiction(due, mean, result.left)
    log_density = result.log_density
    if missing is not None:
        log_density = log_density + 0.5 * LOG_2PI * missing
    return result.mean, result.cov, log_density


def _singly(due: Due, step: int) -> list[Due]:
    """Exact sightings together, then others one by one, unless their errors are correlated."""
    exact = [(sensor, rows) for sensor, rows in due if sensor.exact]
    rest = [(sensor, rows) for sensor, rows in due if not sensor.exact]
    return [exact][: len(exact)] + [
        [(sensor, each)]
        for sensor, rows in rest
        for each in (
            [rows]
            if step in sensor.cross
            else [slice(k, k + 1) for k in range(rows.start, rows.stop)]
        )
    ]


def _is_all(places: Index, size: int) -> bool:
    return isinstance(places, slice) and places == slice(0, size)


def sensors_due(sensors: list[Sensor], step: int) -> Due:
    """The sensors that read at a step, with the rows of their readings."""
    return [
        (sensor, sensor.rows(step))
        for sensor in sensors
        if sensor.bounds[step] < sensor.bounds[step + 1]
    ]


def linearise_sensor(
    sensor: Sensor, step: int, mean: Array, cov: Array, active: Mask | None = None
) -> None:
    """Linearise each sighting of a step by itself, or all as one where they are grouped."""
    family, parents, rows = sensor.family, sensor.parents, sensor.rows(step)
    count = rows.stop - rows.start
    at, spread = mean[:, parents], block(cov, parents, parents)
    if sensor.grouped:
        grouped.linearise(sensor, np.array([step]), mean[None], cov[None], active)
    elif not family.exact and count == 1:
        family.linearise(rows.start, at, spread, active)
    elif not family.exact:
        every = np.broadcast_to(spread, (count, *spread.shape))
        family.linearise(rows, np.broadcast_to(at, (count, *at.shape)), every, active)
    sensor.move(rows, family.value(rows, at[None]), active)


def stack(due: Due, step: int, mean: Array) -> tuple[Array, Array, Array, Array | None]:
    """One reading of all sightings of a step: H, residual, noise, number of missing components.

    A missing component becomes one of unit variance that says nothing.
    """
    parts = [sensor.reading(rows) for sensor, rows in due]
    runs, width = mean.shape
    lost = None
    if any(part.taken is not None for part in parts):
        lost = sum((part.missing.sum(axis=0) for part in parts), np.zeros(runs))
    if len(parts) == 1 and parts[0].matrix.shape[0] == 1 and _is_all(due[0][0].parents, width):
        [seen] = parts
        return seen.matrix[0], _residual(due[0][0], seen, mean)[0], seen.noise[0], lost
    height = sum(seen.value.shape[0] * seen.value.shape[2] for seen in parts)
    matrices = np.zeros((runs, height, width))
    residuals = np.zeros((runs, height))
    noises = np.zeros((runs, height, height))
    top = 0
    for (sensor, _), seen in zip(due, parts, strict=True):
        count, _, size = seen.value.shape
        residual, between = _residual(sensor, seen, mean), sensor.between(step)
        if between is not None:
            every = slice(top, top + count * size)
            noises[:, every, every] = between
        for k in range(count):
            rows = slice(top, top + size)
            top += size
            matrices[:, rows, sensor.parents] = seen.matrix[k]
            residuals[:, rows] = residual[k]
            noises[:, rows, rows] = seen.noise[k]
    return matrices, residuals, noises, lost


def _residual(sensor: Sensor, seen: Seen, mean: Array) -> Array:
    predicted = apply(seen.matrix, mean[:, sensor.parents]) + seen.offset
    return np.subtract(seen.value, predicted, out=predicted)  # in memory as beliefs are


def refuse_indefinite(due: Due) -> None:
    """Refuse readings whose predictive covariance is indefinite or not finite."""
    names = ", ".join(sensor.variable.name for sensor, _ in due)
    blamed = [sensor for sensor, _ in due if sensor.family.approximate]
    sensor = blamed[0] if blamed else due[0][0]
    advice = (
        f"with {sensor.family.lineariser!r} it may be: use positive weights or more samples"
        if blamed
        else "are the belief before it and the reading of a size that float64 can hold?"
    )
    step = _step(due)
    raise NumericalError(
        f"the predictive covariance of {names} at step {step} is indefinite or not "
        f"finite; {advice}",
        variable=sensor.variable,
        cpd=sensor.family.cpd,
        step=step,
    )


def refuse_contradiction(due: Due, mean: Array, left: Array) -> None:
    """Refuse a reading that differs from what an exact model has already determined it to be."""
    parts = []
    for sensor, rows in due:
        seen = sensor.reading(rows)
        expected = apply(np.abs(seen.matrix), np.abs(mean[:, sensor.parents]))
        parts.append((np.abs(seen.value) + expected + np.abs(seen.offset)).max(axis=(0, 2)))
    far = left > CONTRADICTION * np.max(parts, axis=0)[:, None]
    if not far.any():
        return
    run, place = (int(axis[0]) for axis in np.nonzero(far))
    heights = [(rows.stop - rows.start) * sensor.moved.shape[2] for sensor, rows in due]
    sensor, rows = due[int(np.searchsorted(np.cumsum(heights), place, side="right"))]
    which, step = sensor.family.first_run + run, _step(due)
    raise NumericalError(
        f"a reading of {sensor.variable!r} at step {step}, run {which}, contradicts an exact "
        f"model: it is {left[run, place]:.3g} from a value that is certain; give the sensor, the "
        "motion or the prior some noise",
        variable=sensor.variable,
        cpd=sensor.family.cpd,
        step=step,
        run=which,
    )


def _step(due: Due) -> int:
    """The step of readings; online it is no place in the plan, which is for one step alone."""
    sensor, rows = due[0]
    return int(sensor.family.step[rows.start])
