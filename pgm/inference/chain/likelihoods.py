"""Likelihoods of the measurements of all steps at once, about a reference, in information form.

A *slice* is the vector of all hidden variables of a step, of n components. The *reference* is a
trajectory (T+1, runs, n) near the beliefs, for T steps; slices are counted from it, x being the
slice less the reference, so that large coordinates cost no digits. A linearised measurement
z = H x + b + n, n ~ N(0, R), of d components is *whitened* by L⁻¹, L being the lower root of
R = L Lᵀ: v = W x + n, n ~ N(0, I), with W = L⁻¹H. The measurements of a step together are the
likelihood exp(−½ xᵀK x + hᵀx) with K = Σ WᵀW and h = Σ Wᵀv. Arrays of measurements have M rows,
sorted by step.

A measurement with robust noise counts as a Gaussian of covariance R / w, w being its weight. Its
*surplus* is the robust log-density less that of this Gaussian.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from pgm.inference.chain.plan import ChainPlan
from pgm.inference.chain.sensor import Sensor
from pgm.inference.chain.vector import Stack, stacks
from pgm.inference.iteration import Anchor
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
    sandwich,
    transpose,
)
from pgm.kernels.elements import Belief, Likelihood, condition
from pgm.kernels.prefixes import gather
from pgm.kernels.segment_maps import Moments


@dataclass(frozen=True, eq=False)
class Readings:
    """The plan's linearised measurements as likelihoods of x − reference, (T+1, runs, n).

    The measurements of sensors of regular noise are `_whitened`, and add up to the `likelihood` of
    each step. The `stacks` have the measurements of the other sensors: those with singular noise in
    some row, or with correlated errors between the measurements of a step. `_robust` are the
    sensors of robust noise.
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
        """The likelihood times that of an anchor, x = anchor.mean + n, n ~ N(0, diag(std² / λ)).

        An anchor is a measurement of all components, by which a step control holds a solution near
        a point; `std` (T+1, runs, n) and λ, the `weight` (runs,), are the anchor's. Components are
        not held where `std` or λ is zero. The result is `likelihood` itself for an anchor of None.
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

        The other part is found with the beliefs, when they are conditioned on the whitened
        measurements. This part is the sum of ln N(z − h(x⁺); 0, R) over these measurements z, x⁺
        being the mean given the measurements up to their step; of the surplus of the robust ones;
        and of the log-densities of the `stacks` under the predictions. `known` (T+1, runs, n) are
        the x⁺, and `predicted` the moments before a step's measurements, both counted from the
        reference. The plan has to be linearised as it was when these readings were made.
        """
        total = np.zeros(known.shape[:2])
        for each in self._whitened:
            total += each.log_density(self.reference + known)
        for sensor in self._robust:
            total += _surplus(sensor)
        for steps, matrix, residual, noise, missing in self.stacks:
            left = residual - apply(matrix, predicted.mean[steps])
            cov = sandwich(matrix, predicted.cov[steps]) + noise
            total[steps] += moments.log_density(left, cov) + 0.5 * LOG_2PI * missing
        return total


class Known(NamedTuple):
    """Moments (..., n), (..., n, n) of x − reference given the measurements of a step.

    `evidence` (...) is the log-density of these measurements under the belief before them, less the
    term ln N(z − h(x⁺); 0, R) of each measurement z, x⁺ being the mean.
    """

    mean: Array
    cov: Array
    evidence: Array


def know(before: Belief, likelihood: Likelihood) -> Known:
    """Condition beliefs N(x⁻, P), (..., n) and (..., n, n), on whitened measurements v = W x + n.

    The measurements are given by their `likelihood`, of K = WᵀW and h = Wᵀv. With x⁺ the mean given
    them and P⁺ the pseudo-inverse of P, the log-density ln N(v; W x⁻, I + W P Wᵀ) is, but for −½ d
    ln 2π, −½ |v − W x⁺|² − ½ (x⁺ − x⁻)ᵀP⁺(x⁺ − x⁻) − ½ ln |I + P WᵀW|: no term is above zero, so
    that nothing cancels. The result's `evidence` is the sum of the last two terms.
    """
    after = condition(before, likelihood)
    evidence = -0.5 * (inner(after.moved, after.moved) + solving.log_determinant(after.U))
    return Known(after.mean, multiply(transpose(after.X), after.X), evidence)


def _is_all(places: Index, size: int) -> bool:
    """Whether an index takes all of a vector, in its order."""
    return isinstance(places, slice) and places == slice(0, size)


# Measurements, times runs, that are worked on at once: what stays near the processor.
_CHUNK = 8192


@dataclass(frozen=True, eq=False)
class Whitened:
    """A sensor's measurements about a reference, in units of their noise: v = W x + n, n ~ N(0, I).

    `white` (M or 1, runs or 1, d, d) is L⁻¹ and `scale` (M or 1, runs or 1) is ln N(0; 0, L Lᵀ) of
    each noise L Lᵀ. Missing components of a measurement do not count in its scale.
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
            """HᵀR⁻¹H and HᵀR⁻¹ν of each step, summed over its measurements: (steps, runs, ...).

            `rows` are the measurements of some consecutive steps, and `counts` (steps,) tells how
            many each of these has; ν is z less its expected value at the reference.
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
        """Sums Σ ln N(z − h(x); 0, R) of each step's measurements, (T+1, runs).

        x is the slice's mean, `mean` (T+1, runs, n), not counted from the reference; missing
        components do not count.
        """
        taken = self.sensor.taken

        def density(rows: slice, counts: Integers) -> tuple[Array]:
            """Σ ln N(z − h(x); 0, R) of each step, (steps, runs), x being the slice's mean.

            `rows` are the measurements of some consecutive steps, and `counts` (steps,) tells how
            many each of these has.
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
        """Whitened residuals L⁻¹ (z − H x − b) of some rows, (rows, runs, d); zero where missing.

        x is the mean of the row's slice, of `mean` (T+1, runs, n).
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
    """The k rows of each step as one: (steps k, runs, d, ...) becomes (steps, runs, k d, ...)."""
    rows, runs, *shape = parts.shape
    count = rows // steps
    memory = parts.transpose(*range(2, parts.ndim), 0, 1).reshape(*shape, steps, count, runs)
    memory = np.moveaxis(memory, -2, 0).reshape(count * shape[0], *shape[1:], steps, runs)
    return np.moveaxis(memory, (-2, -1), (0, 1))
