"""Draws of an audit: proposals, defensive excursions from them, and the densities of both."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import lgamma, log, pi
from typing import NamedTuple

import numpy as np

from pgm.errors import NumericalError
from pgm.kernels import moments, normal_density, roots, solving
from pgm.kernels.arrays import LOG_2PI, Array, Integers, Mask, transpose
from pgm.kernels.moments import Conditional


@dataclass(frozen=True, eq=False)
class Proposal:
    """Affine Gaussians, one a row: y = F x + b + L s, s ~ N(0, I), or multivariate Student t.

    They are (rows, runs, ...); L has zero rows for components that are not free; the proposal is
    `regular` if all others vary, so that they have a density.
    """

    matrix: Array
    offset: Array
    lower: Array
    regular: bool

    @classmethod
    def make(cls, conditional: Conditional, free: Mask) -> Proposal:
        """Propose the free components, (rows, runs, n), of conditionals of all."""
        matrix, offset, cov = conditional
        # What an exact measurement determines may have a variance of zero less rounding.
        certain = moments.certain(cov, np.where(free, 0.0, np.inf))
        lower = roots.root(certain)
        if not roots.is_proper(lower):
            raise NumericalError(
                "the posterior's covariances are indefinite or not finite, so that nothing can be "
                "drawn from them; use a lineariser with positive weights, or a prior that says "
                "what is known"
            )
        regular = bool((roots.determined(lower) == ~free).all())
        return cls(matrix, offset, lower, regular)

    @cached_property
    def _fixed(self) -> Mask:
        return roots.determined(self.lower)

    def white(
        self, row: int, count: int, rng: np.random.Generator, away: Mask | None = None
    ) -> Array:
        """White noise s, (runs, S, n), zero where determined; of Student's t where `away`."""
        lower = self.lower[row]
        white = rng.standard_normal((lower.shape[0], count, lower.shape[-1]))
        if away is not None:
            stretch(white, away, rng)
        fixed = self._fixed[row]
        return np.where(fixed[:, None, :], 0.0, white) if fixed.any() else white

    def values(self, row: int, given: Array, white: Array) -> Array:
        """The draws (runs, S, n) given others (runs, S, m), of white noise."""
        return self._mean(row, given) + white @ transpose(self.lower[row])

    def whitened(self, row: int, given: Array, values: Array) -> Array:
        """The white noise (runs, S, n) of draws."""
        off = values - self._mean(row, given)
        if self._inverse is None:
            return normal_density.whitened(self.lower[row], off)[0]
        white: Array = off @ transpose(self._inverse[row])
        return white

    @cached_property
    def _inverse(self) -> Array | None:
        return normal_density.whitener(self.lower)

    @cached_property
    def _constants(self) -> tuple[Integers, Array]:
        """The number of free components, and the constant of the Gaussian's log-density."""
        size = (~self._fixed).sum(axis=-1)
        return size, -0.5 * (solving.log_determinant(self.lower) + size * LOG_2PI)

    def log_density(self, row: int, squared: Array) -> Array:
        """The log-density (runs, S) of draws by the Gaussian, at their |s|²."""
        value: Array = self._constants[1][row][:, None] - 0.5 * squared
        return value

    def log_tails(self, row: int, squared: Array) -> Array:
        """The log-density (runs, S) by Student's t, less that by the Gaussian."""
        return log_ratio(self._constants[0][row][:, None], squared)

    def _mean(self, row: int, given: Array) -> Array:
        mean: Array = given @ transpose(self.matrix[row]) + self.offset[row][:, None, :]
        return mean


# Degrees of freedom: four moments, and still eight times the mass of a Gaussian beyond three
# deviations of a plane.
FREEDOM = 5.0


def stretch(white: Array, where: Mask, rng: np.random.Generator) -> None:
    """Turn Gaussian noise (..., n) into that of a multivariate Student t, in place, where said."""
    white[where] *= np.sqrt(FREEDOM / rng.chisquare(FREEDOM, (int(where.sum()), 1)))


def log_ratio(size: Integers, squared: Array) -> Array:
    """The log-density of Student's t less the Gaussian's, at |s|² of so many components."""
    constant = np.array([_log_constant(k) for k in range(int(size.max(initial=0)) + 1)])[size]
    power = 0.5 * (FREEDOM + size)
    value: Array = constant - power * np.log1p(squared / FREEDOM) + 0.5 * squared
    return value


def _log_constant(size: int) -> float:
    gammas = lgamma(0.5 * (FREEDOM + size)) - lgamma(0.5 * FREEDOM)
    return gammas + 0.5 * size * (LOG_2PI - log(FREEDOM * pi))


# The stages of a draw: before its excursion, on one of two kinds, and after it.
BEFORE, PREDICTION, TAILS, AFTER = range(4)
# The part of excursions that follow the model itself; the others have Student tails.
PREDICTED = 0.75
# The probability that the first slice begins one, where there are more.
AT_FIRST = 0.5
# The probability that a slice is an excursion's last.
END = 0.125


@dataclass(frozen=True)
class Excursions:
    """One excursion a draw: slices k to l leave the Gaussian, those around them follow it.

    The first slice begins it with a probability of ½, all others alike; each of its slices is the
    last one with a probability of ⅛. The part `predicted` of them follow the model, the others have
    Student tails. The density of a draw, of all excursions that may have led to it, is summed up
    slice by slice, over the four stages.
    """

    slices: int
    predicted: float = PREDICTED

    def _begin(self, index: int) -> float:
        """The probability that a slice begins the excursion, if none before has."""
        if index == 0 and self.slices > 1:
            return AT_FIRST
        return 1.0 / (self.slices - index)

    def start(self, runs: int, count: int) -> Integers:
        """The stage before the first slice, (runs, S)."""
        return np.full((runs, count), BEFORE)

    def advance(self, index: int, stage: Integers, rng: np.random.Generator) -> Integers:
        """Draw the stages of a slice given those of the slice before, (runs, S)."""
        chance = rng.random(stage.shape)
        begin = self._begin(index)
        kind = np.where(chance < begin * self.predicted, PREDICTION, TAILS)
        begun = np.where(chance < begin, kind, BEFORE)
        return np.where(
            stage == BEFORE, begun, np.where((stage != AFTER) & (chance < END), AFTER, stage)
        )

    def begin(self, shape: tuple[int, int]) -> Density:
        """The density before the first slice."""
        shares = np.zeros((4, *shape))
        shares[BEFORE] = 1.0
        return Density(np.zeros(shape), shares)

    def extend(
        self, index: int, so_far: Density, gaussian: Array, predicted: Array, tails: Array
    ) -> Density:
        """The density of draws up to a slice, given the log-densities of that, (runs, S).

        By the Gaussian, by the model, and with Student tails less the Gaussian's.
        """
        begin, before = self._begin(index), so_far.shares
        scale = np.maximum(np.maximum(predicted, gaussian), gaussian + tails)
        by_gaussian = np.exp(gaussian - scale)
        shares = np.empty_like(before)
        shares[BEFORE] = (1.0 - begin) * before[BEFORE] * by_gaussian
        for kind, part in ((PREDICTION, self.predicted), (TAILS, 1.0 - self.predicted)):
            shares[kind] = (1.0 - END) * before[kind] + begin * part * before[BEFORE]
        shares[PREDICTION] *= np.exp(predicted - scale)
        shares[TAILS] *= np.exp(gaussian + tails - scale)
        shares[AFTER] = before[AFTER] + END * (before[PREDICTION] + before[TAILS])
        shares[AFTER] *= by_gaussian
        return Density(so_far.scale + scale, shares)


class Density(NamedTuple):
    """The density of draws so far: shares of the stages (4, runs, S) times exp(scale), (runs, S).

    A share that is too small for float64 beside another stays so: whatever follows one may follow
    the other.
    """

    scale: Array
    shares: Array

    def log(self) -> Array:
        """The log-density of whole draws, whose excursion has begun."""
        total: Array = self.scale + np.log(self.shares[PREDICTION:].sum(axis=0))
        return total


class Afresh(NamedTuple):
    """Defensive draws that a CPD draws itself, where (runs, S) says so."""

    where: Mask
    rng: np.random.Generator


class Draws(NamedTuple):
    """Log-densities of draws, (runs, S), and their variables by step, (runs, S, n).

    The target is ln p(x, z) of the model, NaN where a function was not finite at a defensive draw;
    the others are by the Gaussian answer and by excursions from it.
    """

    target: Array
    gaussian: Array
    defensive: Array
    values: list[Array]


@dataclass(eq=False)
class Strand:
    """Draws in the making, slice by slice, of the Gaussian answer or defensive ones."""

    excursions: Excursions
    shape: tuple[int, int]
    rng: np.random.Generator
    defensive: bool
    relative: bool

    def __post_init__(self) -> None:
        self.gaussian = np.zeros(self.shape)
        self._density = self.excursions.begin(self.shape)
        self._stage: Integers = self.excursions.start(*self.shape)
        self._white = np.zeros(0)
        self._index = 0

    def propose(self, proposal: Proposal, row: int, given: Array) -> tuple[Array, Afresh | None]:
        """Draw a slice by a row of a proposal, and say which of them the model draws."""
        tails = afresh = None
        if self.defensive:
            self._stage = self.excursions.advance(self._index, self._stage, self.rng)
            tails = self._stage == TAILS
            afresh = Afresh(self._stage == PREDICTION, self.rng)
        self._white = proposal.white(row, self.shape[1], self.rng, tails)
        return proposal.values(row, given, self._white), afresh

    def weigh(
        self, proposal: Proposal, row: int, given: Array, values: Array, predicted: Array
    ) -> None:
        """Take in the densities of a slice, (runs, S, n); `predicted` is that by the model."""
        white = self._white
        away = self._stage == PREDICTION
        if away.any():
            again = proposal.whitened(row, given, values)
            white = np.where(away[..., None], again, white)
        squared = np.einsum("rsi,rsi->rs", white, white)
        gaussian = np.zeros(self.shape)
        if not self.relative:
            gaussian = proposal.log_density(row, squared)
        tails = proposal.log_tails(row, squared)
        self._density = self.excursions.extend(
            self._index, self._density, gaussian, predicted, tails
        )
        self.gaussian += gaussian
        self._index += 1

    def drawn(self, target: Array, values: list[Array]) -> Draws:
        """The draws, once all slices are taken in."""
        return Draws(target, self.gaussian, self._density.log(), values)
