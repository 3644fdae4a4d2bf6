"""Likelihoods of the measurements of all steps at once, about a reference, in information form.

A *slice* is the vector of all hidden variables of a step, of n components. The *reference* is a
trajectory (T+1, runs, n) near the beliefs, for T steps; slices are counted from it, x being the
slice less the reference, so that large coordinates cost no digits.

A linearised measurement of d components is z = H x + b + e with noise e ~ N(0, R); b is what is
expected at the reference. It is *whitened* by L⁻¹, L being the lower root of R = L Lᵀ:
v = L⁻¹(z − b) has the model v = W x + L⁻¹e, with W = L⁻¹H and L⁻¹e ~ N(0, I). All measurements of a
step together are the likelihood exp(−½ xᵀK x + hᵀx) with K = Σ WᵀW and h = Σ Wᵀv. The residual of a
measurement at a point x is r = z − H x − b. Arrays of measurements have M rows, sorted by step.

A measurement with robust noise counts as a Gaussian of covariance R / w, w being its weight. Its
*surplus* is the robust log-density less that of this Gaussian.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from pgm.beliefs.moments.steps.plan import ChainPlan
from pgm.beliefs.moments.steps.sensor import Sensor
from pgm.beliefs.moments.steps.vector import Stack, stacks
from pgm.kernels import moments, roots, solving
from pgm.kernels.arrays import (
    LOG_2PI,
    Array,
    Index,
    Integers,
    apply,
    independent,
    inner,
    multiply,
    room,
    transpose,
)
from pgm.kernels.elements import Belief, Likelihood, condition
from pgm.kernels.prefixes import gather
from pgm.kernels.segment_maps import Moments
from pgm.schedules.iteration import Anchor


@dataclass(frozen=True, eq=False)
class Readings:
    """The plan's linearised measurements as likelihoods of x − reference, (T+1, runs, n).

    The measurements of sensors of regular noise are `_whitened`, one `Whitened` a sensor, and add
    up to the `likelihood` of each step, K (T+1, runs, n, n) and h (T+1, runs, n). The other sensors
    have singular noise in some row, or correlated errors between the measurements of a step. Their
    measurements are in the `stacks`: one `Stack` has those of several steps, the ones of each step
    as one vector. `_robust` are all sensors of robust noise, however their measurements are kept.
    """

    reference: Array
    likelihood: Likelihood
    stacks: list[Stack]
    _whitened: list[Whitened]
    _robust: list[Sensor]

    @classmethod
    def of(cls, plan: ChainPlan, reference: Array) -> Readings:
        """Whiten and add up the measurements of all steps, as the plan is linearised at present.

        They are taken about `reference` (T+1, runs, n).
        """
        size, shape = plan.layout.slice_size, (plan.steps + 1, plan.runs)
        sensors = [sensor for sensor in plan.sensors if sensor.family.step.size]
        whitened = [Whitened.of(sensor, reference) for sensor in sensors]
        regular = [each for each in whitened if each is not None]
        rest = [s for s, white in zip(sensors, whitened, strict=True) if white is None]
        if len(regular) == 1 and _is_all(regular[0].sensor.parents, size):
            likelihood = regular[0].likelihood()
        else:
            likelihood = Likelihood(room(shape, (size, size)), room(shape, (size,)))
            likelihood.K[...], likelihood.h[...] = 0.0, 0.0
            for each in regular:
                said, places = each.likelihood(), each.sensor.parents
                rows = places if isinstance(places, slice) else places[:, None]
                likelihood.K[..., rows, places] += said.K
                likelihood.h[..., places] += said.h
        return cls(reference, likelihood, stacks(plan, rest, reference), regular, plan.robust)

    def held(self, anchor: Anchor | None) -> Likelihood:
        """The likelihood of each step times that of an anchor; `likelihood` itself if that is None.

        An anchor is an artificial measurement of all components of the slices, by which a step
        control holds a solution near a point. It says that a slice is the anchor's `mean`
        (T+1, runs, n) but for an error, with the variance std² / λ in each component; `std` is
        (T+1, runs, n), and λ is the anchor's `weight` (runs,). Components of zero `std`, and runs
        of zero weight, are not measured.
        """
        if anchor is None:
            return self.likelihood
        weight = anchor.weight[:, None]
        held = (anchor.std > 0.0) & (weight > 0.0)
        precision = np.where(held, weight / np.where(held, anchor.std, 1.0) ** 2, 0.0)
        h = self.likelihood.h + precision * (anchor.mean - self.reference)
        added = self.likelihood.K + precision[..., None] * np.eye(h.shape[-1])
        return Likelihood(added, h)

    def log_density(self, known: Array, predicted: Moments) -> Array:
        """A part of ln p of each step's measurements given earlier ones, (T+1, runs).

        This part is the sum of three:

        - ln N(r; 0, R) of each whitened measurement, r being its residual at the mean given the
          measurements up to its step, and R its noise covariance;
        - the surplus of each robust measurement;
        - the log-density of the `stacks` under the prediction of their step.

        The other part, `Known.evidence`, comes with the beliefs when they are conditioned on the
        whitened measurements. `known` (T+1, runs, n) are the means after the measurements of each
        step, and `predicted` the moments before them, both counted from the reference. The plan has
        to be linearised as it was when these readings were made.
        """
        total = np.zeros(known.shape[:2])
        for each in self._whitened:
            total += each.log_density(self.reference + known)
        for sensor in self._robust:
            total += _surplus(sensor)
        for steps, matrix, residual, noise, missing in self.stacks:
            left = residual - apply(matrix, predicted.mean[steps])
            cov = moments.predict(predicted.cov[steps], matrix, noise)
            total[steps] += moments.log_density(left, cov) + 0.5 * LOG_2PI * missing
        return total


class Known(NamedTuple):
    """Moments (..., n), (..., n, n) of x − reference given the measurements of a step.

    `evidence` (...) is the log-density of these measurements under the belief before them, less the
    term ln N(r; 0, R) of each measurement, r being its residual at `mean` and R its noise
    covariance.
    """

    mean: Array
    cov: Array
    evidence: Array


def know(before: Belief, likelihood: Likelihood) -> Known:
    """Condition beliefs `before` = N(m, P), (..., n) and (..., n, n), on whitened measurements.

    The measurements v = W x + noise, d numbers in all, are given by their `likelihood`, of K = WᵀW
    and h = Wᵀv. Let m′ be the mean given them, and P† the pseudo-inverse of P. Their log-density is

        ln N(v; W m, I + W P Wᵀ) = −½ d ln 2π − ½ |v − W m′|² + evidence,
        evidence = −½ (m′ − m)ᵀP†(m′ − m) − ½ ln |I + P WᵀW|.

    No term is above zero, so that nothing cancels.
    """
    after = condition(before, likelihood)
    evidence = -0.5 * (inner(after.moved, after.moved) + solving.log_determinant(after.U))
    return Known(after.mean, multiply(transpose(after.X), after.X), evidence)


def _is_all(places: Index, size: int) -> bool:
    """Whether an index takes all `size` components of a vector, in their order."""
    return isinstance(places, slice) and places == slice(0, size)


# Measurements, times runs, that are worked on at once: what stays near the processor.
_CHUNK = 8192


@dataclass(frozen=True, eq=False)
class Whitened:
    """A sensor's measurements about a reference, in units of their noise: v = W x + noise N(0, I).

    `white` (M or 1, runs or 1, d, d) is L⁻¹ and `scale` (M or 1, runs or 1) is ln N(0; 0, R), for
    each noise covariance R = L Lᵀ. Missing components of a measurement do not count in its scale.
    The first axis has length one where all measurements have the same noise, the second one where
    all runs have.
    """

    sensor: Sensor
    reference: Array
    white: Array
    scale: Array

    @classmethod
    def of(cls, sensor: Sensor, reference: Array) -> Whitened | None:
        """The whitened measurements of a sensor about the reference (T+1, runs, n).

        None if some R is singular or indefinite, or errors of the measurements of a step are
        correlated.
        """
        if sensor.exact or sensor.cross:
            return None
        noise, taken = shortened(sensor.family.noise), sensor.taken
        size: int | Integers = noise.shape[-1]
        if taken is not None and (taken.any(axis=-1) != taken.all(axis=-1)).any():
            noise, size = independent(noise, taken), taken.sum(axis=-1)
        lower = roots.root(noise)
        if not roots.is_proper(lower) or roots.determined(lower).any():
            return None
        white = solving.solve_lower(lower, np.broadcast_to(np.eye(noise.shape[-1]), noise.shape))
        return cls(
            sensor, reference, white, -0.5 * (solving.log_determinant(lower) + size * LOG_2PI)
        )

    def likelihood(self) -> Likelihood:
        """The likelihood of each step's measurements over the parents less their reference.

        Its arrays are K (T+1, runs, m, m) and h (T+1, runs, m), for parents of m components.
        """

        def said(rows: slice, counts: Integers) -> tuple[Array, Array]:
            """K = Σ HᵀR⁻¹H and h = Σ HᵀR⁻¹r over each step's measurements, (steps, runs, ...).

            `rows` are the measurements of some consecutive steps, and `counts` (steps,) tells how
            many each of these has; r is the residual at the reference.
            """
            matrix = self.sensor.family.matrix[rows]
            if self.sensor.taken is not None:
                matrix = np.where(self.sensor.taken[rows][..., None], matrix, 0.0)
            matrix = multiply(self._white(rows), matrix)
            residual = self._residual(rows, self.reference)
            alike = counts.size > 0 and bool((counts == counts[0]).all())
            if alike:
                # The measurements of a step as one: their sum is that of the product.
                matrix, residual = (_one_a_step(part, counts.size) for part in (matrix, residual))
            back = transpose(matrix)
            parts = multiply(back, matrix), apply(back, residual)
            return parts if alike else (_added(parts[0], counts), _added(parts[1], counts))

        precision, h = _by_step(self.sensor, said)
        return Likelihood(precision, h)

    def log_density(self, mean: Array) -> Array:
        """Sums Σ ln N(r; 0, R) over each step's measurements, (T+1, runs).

        The residuals r are at the slices' means `mean` (T+1, runs, n), which are not counted from
        the reference; missing components do not count.
        """
        taken = self.sensor.taken

        def density(rows: slice, counts: Integers) -> tuple[Array]:
            """Σ ln N(r; 0, R) over each step's measurements, (steps, runs).

            `rows` are the measurements of some consecutive steps, and `counts` (steps,) tells how
            many each of these has; their residuals r are at the slices' means.
            """
            left = self._residual(rows, mean)
            scale = self.scale if len(self.scale) == 1 else self.scale[rows]
            if taken is not None:
                scale = np.where(taken[rows].any(axis=-1), scale, 0.0)
            return (_added(scale - 0.5 * inner(left, left), counts),)

        return _by_step(self.sensor, density)[0]

    def _white(self, rows: slice) -> Array:
        """The whitening matrices L⁻¹ of some rows, (rows or 1, runs or 1, d, d).

        The first axis has length one where one matrix serves for all rows.
        """
        return self.white if len(self.white) == 1 else self.white[rows]

    def _residual(self, rows: slice, mean: Array) -> Array:
        """Whitened residuals L⁻¹r of some rows, (rows, runs, d); zero where missing.

        r is at the mean of the row's slice, in `mean` (T+1, runs, n), which is not counted from the
        reference.
        """
        sensor, family = self.sensor, self.sensor.family
        at = gather(mean, family.step[rows])[..., sensor.parents]
        left = sensor.moved[rows] - family.offset[rows] - apply(family.matrix[rows], at)
        if sensor.taken is not None:
            left = np.where(sensor.taken[rows], left, 0.0)
        return apply(self._white(rows), left)


def _surplus(sensor: Sensor) -> Array:
    """The sum of the surplus of each step's measurements by a robust sensor, (T+1, runs)."""
    each = sensor.weights.surplus()
    return _by_step(sensor, lambda rows, counts: (_added(each[rows], counts),))[0]


def shortened(array: Array) -> Array:
    """An array (steps, runs, ...), each of these two axes cut to length one if it is broadcast.

    Such an axis repeats the same numbers in memory, with a stride of zero.
    """
    for axis in (0, 1):
        if array.strides[axis] == 0 and array.shape[axis] > 1:
            array = array.take([0], axis=axis)
    return array


def _by_step(
    sensor: Sensor, part: Callable[[slice, Integers], tuple[Array, ...]]
) -> tuple[Array, ...]:
    """Arrays (T+1, runs, ...) computed from the measurements by `part`, a chunk of steps at a time.

    `part(rows, counts)` gets the measurement rows of some consecutive steps, as a slice of the M
    axis, and how many of them each of these steps has, (steps,). It returns a tuple of arrays
    (steps, runs, ...), with a row for each of these steps, also for those without measurements.
    The result has the same arrays in the same order, for all steps. A chunk has about `_CHUNK` rows
    times runs; the sensor has at least one measurement.
    """
    bounds = np.asarray(sensor.bounds)
    counts = np.diff(bounds)
    size = max(_CHUNK // sensor.moved.shape[1], 1)
    out: tuple[Array, ...] = ()
    # Steps before all measurements are a chunk of their own: later ones are often all alike.
    first, last = 0, int(np.flatnonzero(counts)[0])
    while first < counts.size:
        if last > first:
            parts = part(slice(int(bounds[first]), int(bounds[last])), counts[first:last])
            if not out:
                out = tuple(room((counts.size, x.shape[1]), x.shape[2:]) for x in parts)
            for whole, each in zip(out, parts, strict=True):
                whole[first:last] = each
        first = last
        last = int(np.searchsorted(bounds, bounds[first] + size, side="right")) - 1
        last = min(max(last, first + 1), counts.size)
    return out


def _added(parts: Array, counts: Integers) -> Array:
    """The sum of each step's rows: `parts` (M, runs, ...) becomes (steps, runs, ...).

    counts[k] rows are of step k.
    """
    memory = np.moveaxis(parts, (0, 1), (-2, -1))
    out = np.zeros((*memory.shape[:-2], counts.size, memory.shape[-1]))
    some = np.flatnonzero(counts)
    starts = np.cumsum(counts) - counts
    out[..., some, :] = np.add.reduceat(memory, starts[some], axis=-2)
    return np.moveaxis(out, (-2, -1), (0, 1))


def _one_a_step(parts: Array, steps: int) -> Array:
    """The k rows of each step as one: (steps · k, runs, d, ...) becomes (steps, runs, k · d, ...).

    `steps` counts the steps, each of which has k rows.
    """
    rows, runs, *shape = parts.shape
    count = rows // steps
    memory = parts.transpose(*range(2, parts.ndim), 0, 1).reshape(*shape, steps, count, runs)
    memory = np.moveaxis(memory, -2, 0).reshape(count * shape[0], *shape[1:], steps, runs)
    return np.moveaxis(memory, (-2, -1), (0, 1))
