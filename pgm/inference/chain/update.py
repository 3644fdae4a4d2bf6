"""Readings: stacked as one, taken into a belief, refused where they cannot be."""

from __future__ import annotations

import numpy as np

from pgm.errors import NumericalError
from pgm.inference.chain import grouped
from pgm.inference.chain.plan import Sensor
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

    A missing reading becomes one of unit variance that says nothing.
    """
    parts = [_residual(sensor, rows, mean) for sensor, rows in due]
    runs, width = mean.shape
    if len(parts) == 1 and parts[0][0].shape[0] == 1 and _is_all(due[0][0].parents, width):
        matrix, residual, noise, taken = parts[0]
        if taken is None:
            return matrix[0], residual[0], noise[0], None
    height = sum(residual.shape[0] * residual.shape[2] for _, residual, _, _ in parts)
    matrices = np.zeros((runs, height, width))
    residuals = np.zeros((runs, height))
    noises = np.zeros((runs, height, height))
    missing = np.zeros(runs)
    top = 0
    for (sensor, _), (matrix, residual, noise, taken) in zip(due, parts, strict=True):
        size = residual.shape[2]
        if step in sensor.cross:
            every = slice(top, top + residual.shape[0] * size)
            noises[:, every, every] = sensor.cross[step]
        for k in range(residual.shape[0]):
            rows = slice(top, top + size)
            top += size
            matrices[:, rows, sensor.parents] = matrix[k]
            residuals[:, rows] = residual[k]
            noises[:, rows, rows] = noise[k]
            if taken is not None:
                lost = np.broadcast_to(~taken[k], (runs,))
                matrices[lost, rows] = 0.0
                residuals[lost, rows] = 0.0
                noises[lost, rows, :] = 0.0
                noises[lost, :, rows] = 0.0
                noises[lost, rows, rows] = np.eye(size)
                missing += size * lost
    return matrices, residuals, noises, missing if missing.any() else None


def _residual(sensor: Sensor, rows: slice, mean: Array) -> tuple[Array, Array, Array, Mask | None]:
    matrix, value, noise, taken = sensor.reading(rows)
    predicted = apply(matrix, mean[:, sensor.parents]) + sensor.family.offset[rows]
    residual = np.subtract(value, predicted, out=predicted)  # in memory as beliefs are
    return matrix, residual, noise, taken


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
        matrix, value, _, _ = sensor.reading(rows)
        shift = np.abs(sensor.family.offset[rows])
        size = np.abs(value) + apply(np.abs(matrix), np.abs(mean[:, sensor.parents])) + shift
        parts.append(size.max(axis=(0, 2)))
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
    )


def _step(due: Due) -> int:
    """The step of readings; online it is no place in the plan, which is for one step alone."""
    sensor, rows = due[0]
    return int(sensor.family.step[rows.start])
