"""Likelihoods of the readings of all steps at once, about a reference, in information form."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from pgm.inference.chain.iteration import Anchor
from pgm.inference.chain.plan import ChainPlan
from pgm.inference.chain.stacks import Stack, stacks
from pgm.inference.chain.whitened import Whitened
from pgm.kernels import moments, roots
from pgm.kernels.arrays import (
    LOG_2PI,
    Array,
    Index,
    apply,
    inner,
    multiply,
    room,
    sandwich,
    transpose,
)
from pgm.kernels.conditionals import Moments
from pgm.kernels.elements import Belief, Likelihood, condition


@dataclass(frozen=True, eq=False)
class Readings:
    """The readings of a plan as it is linearised, about a reference.

    Attributes
    ----------
    reference : ndarray
        (T+1, runs, n): what all means are deviations from.
    likelihood : Likelihood
        (T+1, runs, ...): what readings with a regular noise say of the slices.
    stacks : list of Stack
        The others: those of singular noise, or with cross terms.
    """

    reference: Array
    likelihood: Likelihood
    stacks: list[Stack]
    _whitened: list[Whitened]

    @classmethod
    def of(cls, plan: ChainPlan, reference: Array) -> Readings:
        """Whiten and add up all readings."""
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
        return cls(reference, likelihood, stacks(plan, rest, reference), regular)

    def held(self, anchor: Anchor | None) -> Likelihood:
        """The likelihood with an anchor's readings of all components."""
        if anchor is None:
            return self.likelihood
        weight = anchor.weight[:, None]
        held = (anchor.std > 0.0) & (weight > 0.0)
        precision = np.where(held, weight / np.where(held, anchor.std, 1.0) ** 2, 0.0)
        h = self.likelihood.h + precision * (anchor.mean - self.reference)
        added = self.likelihood.K + precision[..., None] * np.eye(h.shape[-1])
        return Likelihood(added, h)

    def log_density(self, known: Array, predicted: Moments) -> Array:
        """The log-density of each step's readings, (T+1, runs), but for `Known.evidence`.

        Parameters
        ----------
        known : ndarray
            Deviations of the means after the readings.
        predicted : Moments
            Before them. The plan has to be linearised as it was.
        """
        total = np.zeros(known.shape[:2])
        for each in self._whitened:
            total += each.log_density(self.reference + known)
        for steps, matrix, residual, noise, missing in self.stacks:
            left = residual - apply(matrix, predicted.mean[steps])
            cov = sandwich(matrix, predicted.cov[steps]) + noise
            total[steps] += moments.log_density(left, cov) + 0.5 * LOG_2PI * missing
        return total


class Known(NamedTuple):
    """Beliefs after readings, as deviations, and what the readings have moved them by.

    Attributes
    ----------
    mean, cov : ndarray
        (..., n), (..., n, n).
    evidence : ndarray
        (...): the readings' log-density, but for each one's own part.
    """

    mean: Array
    cov: Array
    evidence: Array


def know(before: Belief, likelihood: Likelihood) -> Known:
    """Take readings into beliefs.

    With x⁺ the mean given the readings, ln N(v; W x⁻, I + W P Wᵀ) is
    −½ |v − W x⁺|² − ½ (x⁺ − x⁻)ᵀP⁺(x⁺ − x⁻) − ½ ln |I + P WᵀW|, which does not subtract.
    """
    after = condition(before, likelihood)
    evidence = -0.5 * (inner(after.moved, after.moved) + roots.log_determinant(after.U))
    return Known(after.mean, multiply(transpose(after.X), after.X), evidence)


def _is_all(places: Index, size: int) -> bool:
    return isinstance(places, slice) and places == slice(0, size)
