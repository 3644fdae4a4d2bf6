"""The forward sweep: messages in moment form, from cluster 0 to cluster T."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pgm.errors import NumericalError
from pgm.inference import grouped
from pgm.inference.plan import ChainPlan, Link, Sensor
from pgm.kernels import moments, roots
from pgm.kernels.arrays import LOG_2PI, Array, Index, Mask, apply, block

# A reading this far from what an exact model says, as a part of the numbers' size, contradicts it.
CONTRADICTION = 1e-8


@dataclass(frozen=True, eq=False)
class Forward:
    """What a forward sweep leaves, time first: over the slices, before and after their readings.

    Attributes
    ----------
    predicted_mean, mean : ndarray
        (T+1, runs, slice size); controls at step 0 are zero.
    predicted_cov, cov : ndarray
        (T+1, runs, slice size, slice size).
    log_density : ndarray
        (T+1, runs): of each step's readings given those before.
    """

    predicted_mean: Array
    predicted_cov: Array
    mean: Array
    cov: Array
    log_density: Array

    @classmethod
    def empty(cls, plan: ChainPlan) -> Forward:
        """Room for a sweep."""
        size, shape = plan.layout.slice_size, (plan.steps + 1, plan.runs)
        means, covs = (*shape, size), (*shape, size, size)
        return cls(
            np.zeros(means), np.zeros(covs), np.zeros(means), np.zeros(covs), np.zeros(shape)
        )


def sweep(plan: ChainPlan, *, linearise: bool) -> Forward:
    """Run the forward sweep, linearising each CPD at its incoming belief, or as it is laid out."""
    out = Forward.empty(plan)
    states, last = plan.layout.state_places, plan.steps
    mean, cov = start(plan, linearise=linearise)
    out.predicted_mean[0][:, states] = mean
    put(out.predicted_cov[0], states, cov)
    for step in range(last + 1):
        if step:
            mean = out.mean[step - 1][:, states]
            cov = block(out.cov[step - 1], states, states)
            out.predicted_mean[step], out.predicted_cov[step] = predict(
                plan, step - 1, mean, cov, linearise=linearise
            )
        out.mean[step], out.cov[step], out.log_density[step] = update(
            plan.sensors,
            step,
            out.predicted_mean[step],
            out.predicted_cov[step],
            linearise=linearise,
        )
    return out


def put(cov: Array, places: Index, value: Array) -> None:
    """Write the block of some components."""
    if isinstance(places, slice):
        cov[:, places, places] = value
    else:
        cov[:, places[:, None], places] = value


def start(plan: ChainPlan, *, linearise: bool) -> tuple[Array, Array]:
    """Moments of the states at step 0."""
    size = plan.layout.state_size
    mean, cov = np.zeros((plan.runs, size)), np.zeros((plan.runs, size, size))
    for link in plan.prior:
        _extend(link, 0, 0, mean, cov, linearise)
    return mean, cov


def predict(
    plan: ChainPlan, row: int, mean: Array, cov: Array, *, linearise: bool
) -> tuple[Array, Array]:
    """Moments of the slice from those of the states before it."""
    if plan.layout.single:
        link = plan.transition[0]
        family = link.family
        if linearise and not family.exact:
            family.linearise(row, mean, cov)
        conditional = moments.Conditional(family.matrix[row], family.offset[row], family.noise[row])
        slice_mean, slice_cov = moments.push(mean, cov, conditional)
        _check_predicted(link, row, slice_cov)
        return slice_mean, slice_cov
    front = plan.layout.state_size
    size = front + plan.layout.slice_size
    pair_mean, pair_cov = np.zeros((plan.runs, size)), np.zeros((plan.runs, size, size))
    pair_mean[:, :front] = mean
    pair_cov[:, :front, :front] = cov
    for link in plan.transition:
        _extend(link, row, row + 1, pair_mean, pair_cov, linearise)
    return pair_mean[:, front:], pair_cov[:, front:, front:]


def _extend(link: Link, row: int, step: int, mean: Array, cov: Array, linearise: bool) -> None:
    family, parents = link.family, link.parents
    if linearise and not family.exact:
        family.linearise(row, mean[:, parents], block(cov, parents, parents))
    moments.extend(
        mean,
        cov,
        link.child,
        parents,
        family.matrix[row],
        family.offset[row],
        family.noise[row],
    )
    _check_predicted(link, row, block(cov, link.child, link.child))


def _check_predicted(link: Link, row: int, cov: Array) -> None:
    """Only a lineariser's error can make a prediction indefinite."""
    family = link.family
    if family.approximate and not roots.is_proper(roots.root(cov)):
        step = int(family.step[row])
        raise NumericalError(
            f"{family.cpd!r}: the predicted covariance at step {step} is indefinite with "
            f"{family.lineariser!r}; use a rule with positive weights or more samples",
            variable=family.cpd.child,
            cpd=family.cpd,
            step=step,
        )


def update(
    sensors: list[Sensor], step: int, mean: Array, cov: Array, *, linearise: bool
) -> tuple[Array, Array, Array]:
    """Moments of the slice given the readings of a step, and the readings' log-density."""
    due = sensors_due(sensors, step)
    if not due:
        return mean, cov, np.zeros(mean.shape[0])
    for sensor, _ in due if linearise else ():
        linearise_sensor(sensor, step, mean, cov)
    matrix, residual, noise, missing = stack(due, step, mean)
    result = moments.update(mean, cov, matrix, residual, noise)
    if not np.isfinite(result.log_density.sum()):
        _refuse_indefinite(due, step)
    if result.left is not None:
        _refuse_contradiction(due, step, mean, result.left)
    log_density = result.log_density
    if missing is not None:
        log_density = log_density + 0.5 * LOG_2PI * missing
    return result.mean, result.cov, log_density


def sensors_due(sensors: list[Sensor], step: int) -> list[tuple[Sensor, slice]]:
    """The sensors that read at a step, with the rows of their readings."""
    return [
        (sensor, sensor.rows(step))
        for sensor in sensors
        if sensor.bounds[step] < sensor.bounds[step + 1]
    ]


def linearise_sensor(sensor: Sensor, step: int, mean: Array, cov: Array) -> None:
    """Linearise each sighting of a step by itself, or all as one where they are grouped."""
    family, parents, rows = sensor.family, sensor.parents, sensor.rows(step)
    count = rows.stop - rows.start
    at = np.broadcast_to(mean[:, parents], (count, *mean[:, parents].shape))
    if sensor.grouped:
        grouped.linearise(sensor, np.array([step]), mean[None], cov[None])
    elif not family.exact:
        spread = block(cov, parents, parents)
        family.linearise(rows, at, np.broadcast_to(spread, (count, *spread.shape)))
    sensor.move(rows, family.value(rows, at))


def stack(
    due: list[tuple[Sensor, slice]], step: int, mean: Array
) -> tuple[Array, Array, Array, Array | None]:
    """One reading of all sightings of a step: H, residual, noise, number of missing components.

    A missing reading becomes one of unit variance that says nothing.
    """
    parts = [_residual(sensor, rows, mean) for sensor, rows in due]
    runs, width = mean.shape
    if len(parts) == 1 and parts[0][0].shape[0] == 1 and due[0][0].parents == slice(0, width):
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
    return matrix, value - predicted, noise, taken


def _refuse_indefinite(due: list[tuple[Sensor, slice]], step: int) -> None:
    names = ", ".join(sensor.variable.name for sensor, _ in due)
    sensor = due[0][0]
    raise NumericalError(
        f"the predictive covariance of {names} at step {step} is indefinite or not finite, with "
        f"{sensor.family.lineariser!r}; use a rule with positive weights or more samples",
        variable=sensor.variable,
        cpd=sensor.family.cpd,
        step=step,
    )


def _refuse_contradiction(
    due: list[tuple[Sensor, slice]], step: int, mean: Array, left: Array
) -> None:
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
    raise NumericalError(
        f"a reading of {sensor.variable!r} at step {step}, run {run}, contradicts an exact model: "
        f"it is {left[run, place]:.3g} from a value that is certain; give the sensor, the motion "
        "or the prior some noise",
        variable=sensor.variable,
        cpd=sensor.family.cpd,
        step=step,
    )
