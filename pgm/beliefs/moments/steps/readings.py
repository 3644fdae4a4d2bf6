"""The measurements of a step: linearised at a belief, and taken in.

A *slice* is the vector of all hidden variables of a step, of n components; a *sighting* is one
measurement by a sensor, of which a step may have several. The k sightings of a sensor at a step, of
d components each, are stacked to one vector of D = k d. Components stand first and runs last,
(D, *batch), `batch` being () for one run and (runs,) for several. A *plan* (`ChainPlan`) stores
linearisations. The *branch* of an angle is its value among those that differ by whole turns. An
*exact* sensor is one whose noise is singular.

A sighting of robust noise counts as a Gaussian of covariance R / w, w being its weight. A
*graduated* loss of such noise begins wide, and is sharpened from one weighing to the next until it
is the loss that the user asked for.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import inf, isfinite
from typing import NamedTuple

import numpy as np

from pgm.beliefs.moments.steps import refusals
from pgm.beliefs.moments.steps.plan import ChainPlan
from pgm.beliefs.moments.steps.sensor import Sensor
from pgm.beliefs.moments.steps.vector import Measured, Vector, vector
from pgm.kernels import gaussian
from pgm.kernels.angles import TURN
from pgm.kernels.arrays import (
    LOG_2PI,
    Array,
    Integers,
    Mask,
    block,
    components_first,
    components_last,
    within,
)
from pgm.kernels.gaussian import NEARLY_SINGULAR
from pgm.kernels.roots import NEGLIGIBLE
from pgm.kernels.step import nearest
from pgm.linearisation.failures import require_finite
from pgm.linearisation.rows import At
from pgm.linearisation.weights import Weights, by_sighting, own_blocks, scale
from pgm.linearisers import Line
from pgm.schedules.iteration import Anchor

_HALF_TURN = 0.5 * TURN


class Moments(NamedTuple):
    """Mean (n, *batch) and covariance (n, n, *batch) of a slice."""

    mean: Array
    cov: Array

    @classmethod
    def of(cls, plan: ChainPlan, mean: Array, cov: Array) -> Moments:
        """Moments from arrays with the runs first, (runs, n) and (runs, n, n).

        The plan tells the `batch` that they get: () for one run, (runs,) for several.
        """
        if not plan.batch:
            return cls(mean[0], cov[0])
        return cls(components_first(mean, 1), components_first(cov, 2))

    def held(self, anchor: Anchor, step: int) -> Moments:
        """The belief given also what an anchor measures at a step, in its row `step`.

        An anchor is an artificial measurement of all components of the slices, by which a step
        control holds beliefs near a point.
        """
        mean, cov = anchor.hold(step, *self.by_run)
        if self.mean.ndim == 1:
            return Moments(mean[0], cov[0])
        return Moments(components_first(mean, 1), components_first(cov, 2))

    @property
    def by_run(self) -> tuple[Array, Array]:
        """Mean and covariance with the runs first, (runs, n) and (runs, n, n)."""
        if self.mean.ndim == 1:
            return self.mean[None], self.cov[None]
        return components_last(self.mean, 1), components_last(self.cov, 2)


class Known(NamedTuple):
    """The belief given sightings of a step, and how likely they were, (*batch) each.

    `log_density` is that of the sightings, and `square` νᵀS⁻¹ν of their innovation ν, together.
    """

    moments: Moments
    log_density: Array | float
    square: Array | float


class Certain:
    """How many measured components of a step the belief of each run determines, (*batch).

    It is found where runs are hypotheses: what one makes certain outweighs every density that
    another gives, and one that is contradicted has the log-density −∞, which is no error.
    """

    __slots__ = ("count",)

    count: Integers | int

    def __init__(self) -> None:
        self.count = 0


def update(
    parts: Sequence[Measured], step: int, belief: Moments, certain: Certain | None = None
) -> Known:
    """The belief given linearised sightings of a step.

    `step` is the number that errors name, and `belief` the predicted one. Where the joint
    predictive covariance is nearly singular, as with sharp measurements of a wide belief, exact
    sensors are taken in together and the other sightings one by one, which is equal but for
    rounding. NumericalError where that covariance is indefinite or not finite, or an exact model is
    contradicted; with `certain`, where runs are hypotheses, such a run has the log-density −∞.
    """
    if certain is not None:
        certain.count = 0
    if not parts:
        return Known(belief, 0.0, 0.0)
    first, mean = parts[0], belief.mean
    if mean.ndim == 1 and len(parts) == 1 and first.taken is None and not first.sensor.exact:
        # A regular measurement of one run, the usual case.
        if first.sensor.whole:  # it is the vector already
            matrix, residual, noise = first.matrix, first.residual(mean), first.noise
        else:
            matrix, residual, noise, _ = vector(parts, mean)
        one = gaussian.update_one(mean, belief.cov, matrix, residual, noise)
        if one is not None and isfinite(one[2]):
            return Known(Moments(one[0], one[1]), one[2], one[3])
    several = len(parts) > 1 or len(parts[0].value) > parts[0].sensor.height
    found = _absorb(parts, step, belief, NEARLY_SINGULAR if several else NEGLIGIBLE, certain)
    if found is not None:
        return found
    exact = [seen for seen in parts if seen.sensor.exact]
    rest = [[one] for seen in parts if not seen.sensor.exact for one in seen.each()]
    total: Array | float = 0.0
    square: Array | float = 0.0
    for some in [exact, *rest] if exact else rest:
        then = _absorb(some, step, belief, 0.0, certain)
        assert then is not None
        belief, total, square = then.moments, total + then.log_density, square + then.square
    return Known(belief, total, square)


def _absorb(
    parts: Sequence[Measured],
    step: int,
    belief: Moments,
    least: float,
    certain: Certain | None,
) -> Known | None:
    """The belief given all sightings, as one vector; or None.

    `step` is the number that errors name, and `belief` the predicted one. The predictive
    covariance S of the sightings is nearly singular if some component, given those before it, keeps
    less than `NEARLY_SINGULAR`, 10⁻⁶, of its variance in S. The result is then None if `least` is
    that number. With a smaller `least` it is not None: of several runs, faster formulas are then
    used as long as each component keeps more than `least`, 0 standing for 10⁻¹³. `certain` is as
    of `update`, and what is determined is added to it.
    """
    mean, cov = belief
    exact = any(seen.sensor.exact for seen in parts)
    matrix, residual, noise, missing = vector(parts, mean)
    least_share = least or NEGLIGIBLE
    found = gaussian.update(mean, cov, matrix, residual, noise, exact=exact, least=least_share)
    density = found.log_density
    if certain is None:  # else it is asked for hypotheses that have a probability
        finite = isfinite(density) if isinstance(density, float) else np.isfinite(density.sum())
        if not finite:
            refusals.indefinite(parts, step, ~np.isfinite(density))
    if least == NEARLY_SINGULAR and not found.regular:
        return None
    if found.left is not None:
        if certain is None:
            refusals.contradiction(parts, step, mean, found.left)
        else:
            far = refusals.contradicted(parts, mean, found.left).any(axis=0)
            density = np.where(far, -inf, density) if mean.ndim > 1 else (-inf if far else density)
            certain.count = certain.count + found.certain
    if missing is not None:
        density = density + 0.5 * LOG_2PI * (missing if mean.ndim > 1 else int(missing))
    return Known(Moments(found.mean, found.cov), density, found.square)


class Reading:
    """The sightings of one sensor at a step, to be linearised at any belief.

    `at` is the sensor's CPD with the evidence of these sightings. `values` (D, *batch) are as
    given, with a batch of length one if all runs have the same; `taken` (D, *batch) marks the
    components measured, None for all. With `fixed` the linearisation stored in the plan is used as
    it is: angles stay on their branch, and weights are not found anew. `seen` is the last
    linearisation, `erroneous` whether any has added an approximation error to the noise, and
    `error` (D, D, *batch) the covariance of this error where weights are found. Once a gate has
    decided, `gate` is its probability, and `gated` has the mask of rejected sightings and their
    squares νᵀS⁻¹ν, (k, *batch) each, ν being the innovation and S its covariance; before, `gated`
    is None. `weights` are those of robust noise, None where they are not to be found.
    """

    __slots__ = (
        "at",
        "erroneous",
        "error",
        "fixed",
        "gate",
        "gated",
        "seen",
        "sensor",
        "taken",
        "values",
        "weights",
    )

    seen: Measured
    # Weights of robust noise, where they are to be found.
    weights: Weights | None
    error: Array | None
    taken: Mask | None
    # Which sightings a gate has rejected, and their squared lengths, (k, *batch).
    gated: tuple[Mask, Array] | None
    gate: float

    def __init__(
        self, sensor: Sensor, at: At, values: Array, taken: Mask | None, *, fixed: bool = False
    ) -> None:
        self.sensor, self.at, self.values = sensor, at, values
        self.fixed, self.erroneous, self.gated, self.error = fixed, False, None, None
        self.take(taken)

    def take(self, taken: Mask | None) -> None:
        """Use only the components that `taken` (D, *batch) marks, None for all.

        The weights of robust noise begin again at one, unless the linearisation is fixed.
        """
        sensor, at = self.sensor, self.at
        self.taken, self.weights = taken, None
        if sensor.robust and not self.fixed:
            height, runs = sensor.height, sensor.family.noise.shape[1]
            there = None if taken is None else by_sighting(taken, height, 0)
            own, shape = own_blocks(at.noise, height), (len(at.noise) // height, runs)
            self.weights = Weights.of(sensor.family.cpd, own, there, shape)

    def linearise(
        self, mean: Array, cov: Array, active: Mask | None = None, copy: bool = True
    ) -> Measured:
        """Linearise at a belief over the slice, (n, *batch) and (n, n, *batch).

        The result is also stored as `seen`. Runs that are not `active` (runs,) keep their
        linearisation; None means all are active. Measured angles are moved to the branch nearest
        the expected value. If `copy` is false, the slope H and the value may be arrays that the
        user's function uses again.
        """
        mean, cov = self.below(mean, cov)
        return self.measured(self.sensor.family.line(self.at, mean, cov), mean, copy, active)

    def below(self, mean: Array, cov: Array) -> tuple[Array, Array]:
        """The belief over the sensor's parents, from one over the slice, (n, *batch) and so on."""
        sensor = self.sensor
        if sensor.whole:
            return mean, cov
        return mean[sensor.parents], within(cov, sensor.parents)

    def measured(self, line: Line, mean: Array, copy: bool, active: Mask | None = None) -> Measured:
        """The sightings by a linearisation at a mean of the sensor's parents; see `linearise`.

        `copy` and `active` are as there, and the result is stored as `seen`.
        """
        sensor, at = self.sensor, self.at
        matrix, value, error = line
        if copy:
            matrix, value = matrix.copy(), value.copy()
        noise = at.noise if self.weights is None else self._weighed(self.weights)
        if error is not None:
            noise, self.erroneous = noise + error, True
        if self.weights is not None:
            self._keep_error(error, active)
        reading = self.values
        if not self.fixed:
            reading = _nearest(reading, value, sensor.turning(len(value)))
        seen = Measured(sensor, matrix, value, noise, mean, reading, self.taken, at.offset)
        if active is not None:
            seen = seen.where(active, self.seen)
        self.seen = seen
        return seen

    def _weighed(self, weights: Weights) -> Array:
        """The noise covariance (D, D, *batch) with each sighting's block R replaced by R / w.

        Its rows and columns are scaled by 1/√w, w being the sighting's weight.
        """
        each = scale(weights.weight, self.sensor.height, self.sensor.family.batch)
        found: Array = self.at.noise * each[:, None] * each[None]
        return found

    def _keep_error(self, error: Array | None, active: Mask | None) -> None:
        """Keep the covariance of a linearisation's error, (D, D, *batch), as the new `error`.

        Runs that are not `active` (runs,) keep theirs; None means all are active.
        """
        if active is not None and self.error is not None and error is not None:
            error = np.where(active, error, self.error)
        self.error = error

    def reweigh(self, mean: Array, cov: Array, active: Mask) -> Array:
        """Weigh robust sightings at a belief over the slice; returns how far weights move, (runs,).

        That is the largest change of a weight, infinite while a graduated loss is not yet the one
        asked for, and zero in runs that are not `active` (runs,). `seen` gets the new noise; there
        have to be `weights`. The belief is (n, *batch) and (n, n, *batch).
        """
        weights, sensor, seen = self.weights, self.sensor, self.seen
        assert weights is not None
        mean, cov = self.below(mean, cov)
        height, runs = sensor.height, weights.weight.shape[1]
        if self.taken is not None:  # a gate may have rejected some since
            weights.taken = by_sighting(self.taken, height, 0)
        residual = by_sighting(seen.residual(mean), height, 0)
        if sensor.family.expects:
            error = None if self.error is None else own_blocks(self.error, height)
            matrix = by_sighting(seen.matrix, height, 1)
            spread = components_last(cov.reshape(*cov.shape[:2], runs), 2)[None]
            square = weights.squares(residual, matrix, spread, error)
        else:
            square = weights.squares(residual)
        moved = weights.take(square, active)
        noise = self._weighed(weights)
        self.seen = seen._replace(noise=noise if self.error is None else noise + self.error)
        return moved

    def loss(self, left: Array, cov: Array) -> Array:
        """Twice the sum of the losses ρ(s) of robust sightings, (runs,).

        s = rᵀR⁻¹r is the square of a sighting's residual r; the residuals are `left` (runs, D).
        With a lineariser that takes expectations s is the square expected under a belief over the
        slice, whose covariance is `cov` (runs, n, n); otherwise `cov` is not used.
        """
        weights, height = self.weights, self.sensor.height
        assert weights is not None
        residual = left.reshape(len(left), -1, height).swapaxes(0, 1)
        seen: tuple[Array, ...] = ()
        if self.sensor.family.expects:
            spread = block(cov, self.sensor.parents, self.sensor.parents)[None]
            seen = by_sighting(self.seen.matrix, height, 1), spread
        total: Array = weights.loss(weights.squares(residual, *seen)).sum(axis=0)
        return total

    @property
    def surplus(self) -> Array | float:
        """The robust log-density of all sightings less that of their N(0, R / w), (*batch).

        It is zero for a sensor of Gaussian noise.
        """
        if not self.sensor.robust:
            return 0.0
        if self.weights is None:
            each = self.sensor.weights.surplus(slice(self.at.first, self.at.last))
        else:
            each = self.weights.surplus()
        total: Array = each.sum(axis=0)
        return total if self.sensor.family.batch else total.item()

    def expected(self, mean: Array, cov: Array) -> Array:
        """E[h(x)] at a belief over the slice, by the lineariser, (D, *batch); NaN where h is NaN.

        The belief is (n, *batch) and (n, n, *batch); `seen` stays as it is.
        """
        return self.sensor.family.line(self.at, *self.below(mean, cov)).value

    def require_finite(self) -> None:
        """Refuse a linearisation with values of NaN or infinity, with LinearisationError."""
        function, seen = self.at.function, self.seen
        if function is not None:
            error = seen.noise if self.erroneous else None
            line = Line(seen.matrix, seen.value, error)
            require_finite(self.sensor.family, function, seen.point, line)

    def keep(self) -> None:
        """Store the linearisation of the sightings, their weights and branches in the plan."""
        seen, sensor = self.seen, self.sensor
        if self.at.function is not None:
            weighed = self.erroneous or self.weights is not None
            noise = seen.noise if weighed else None
            sensor.family.keep(self.at, seen.matrix, seen.constant, noise)
        elif self.weights is not None:
            sensor.family.keep_noise(self.at, seen.noise)
        if self.weights is not None:
            sensor.weights.put(slice(self.at.first, self.at.last), self.weights)
        sensor.keep(self.at, seen.reading, seen.noise if self.erroneous else None)


def _nearest(reading: Array, value: Array, turning: Sequence[int]) -> Array:
    """A measurement, `reading`, its angles moved by whole turns to within half a turn of `value`.

    Both are (D, *batch); `turning` are the places of the angles among the D components.
    """
    moved = reading
    for k in turning:
        if reading.ndim == 1:
            off = reading.item(k) - value.item(k)
            if not _HALF_TURN < abs(off) < inf:
                continue
        else:
            off = reading[k] - value[k]
            if not np.abs(off).max(initial=0.0) > _HALF_TURN:
                continue
        if moved is reading:
            moved = np.empty_like(value)
            moved[...] = reading
        moved[k] = nearest(reading[k], value[k])
    return moved


def stored(plan: ChainPlan, step: int, mean: Array) -> Vector | None:
    """The measurements of a step, with stored linearisations, as one vector, or None without any.

    `mean` (runs, n) is that of the slice, at which residuals are taken; the `Vector` has its runs
    first, too: H (runs, D, n), residual (runs, D), noise (runs, D, D).
    """
    at = components_first(mean, 1) if plan.batch else mean[0]
    nothing = np.zeros((len(at), len(at), *plan.batch))
    due = [(sensor, sensor.at(step, stored=True)) for sensor in plan.sensors]
    parts = [
        Reading(sensor, *each, fixed=True).linearise(at, nothing) for sensor, each in due if each
    ]
    if not parts:
        return None
    matrix, residual, noise, missing = vector(parts, at)
    if not plan.batch:
        lost = None if missing is None else missing[None]
        return Vector(matrix[None], residual[None], noise[None], lost)
    noise = np.broadcast_to(noise, (*noise.shape[:2], *plan.batch))
    matrix = np.broadcast_to(matrix, (*matrix.shape[:2], *plan.batch))
    return Vector(
        components_last(matrix, 2), components_last(residual, 1), components_last(noise, 2), missing
    )
