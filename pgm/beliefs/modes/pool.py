r"""Draws of all hidden variables from mixtures of modes, in several rounds, weighed together.

In round t values x are drawn from

.. math:: r_t(x) = (1 - ε) \sum_k a_k s_k(x) + ε d(x)

with the K modes' Gaussians made wider, Student's t of five degrees of freedom and 1.1 times their
deviations, :math:`s_k`, and a *defensive* density d: the model's own CPDs of hidden variables, with
noise of Student's t. Beyond ten components s is the Gaussian itself, since the ratio of both
densities varies the more the more components there are. All draws of all rounds are weighed by the
mixture of all rounds, r, each by its part of the draws (Veach & Guibas, Optimally combining
sampling techniques, 1995): y = p(x, z)/r(x), the exact density of the model as it was declared.

S is the number of draws of a run in all rounds. Arrays of slices have the steps first.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from math import log
from typing import NamedTuple

import numpy as np

from pgm.beliefs.modes.laws import Laws, Target, without_density
from pgm.beliefs.moments.trajectories.density import Afresh
from pgm.beliefs.moments.trajectories.model import BLOCK
from pgm.beliefs.moments.trajectories.proposal import Path
from pgm.beliefs.moments.trajectories.student import log_ratio, stretch
from pgm.errors import NumericalError
from pgm.kernels.angles import nearest_branch
from pgm.kernels.arrays import Array, Integers, inner
from pgm.kernels.semirings import log_sum

# The components up to which draws have Student's t; the part of draws that is defensive, and that
# beyond; how much wider than a mode's its draws are.
FEW, DEFENSIVE, RARELY, WIDER = 10, 0.15, 0.05, 1.1
# The part of a mode's share that all modes have alike, so that none is starved.
EVEN = 0.2
# Draws are so many times that, so that blocks of them are equal.
BLOCKS = 20


class Heights(NamedTuple):
    """The densities of draws under the Gaussians of laws.

    squared: Their squared distances from the means, in deviations, (K, runs, S).
    level: The log-densities at the means, (K, runs).
    size: The number of components that have noise, (runs,).
    """

    squared: Array
    level: Array
    size: Integers

    @property
    def gaussian(self) -> Array:
        """The Gaussians' log-densities, (K, runs, S)."""
        return self.level[..., None] - 0.5 * self.squared

    @property
    def proposed(self) -> Array:
        """The log-densities of the laws as draws have them, (K, runs, S)."""
        few = self.size <= FEW
        if not few.any():
            return self.gaussian
        wide = self.squared / WIDER**2
        size = self.size[:, None]
        level = self.level[..., None] - size * log(WIDER) - 0.5 * wide
        student = level + log_ratio(np.minimum(size, FEW), wide)
        return np.where(few[:, None], student, self.gaussian)


@dataclass(frozen=True, eq=False)
class Round:
    """A round of draws: the laws that they are from, the laws' paths, and the number of draws."""

    laws: Laws
    paths: list[Path]
    count: int

    @cached_property
    def shares(self) -> Array:
        """The part of draws that are of each mode, (K, runs), if none is defensive."""
        return even(self.laws.weights)


def even(weights: Array) -> Array:
    """The weights of modes, (K, runs), made more alike, so that none is starved of draws."""
    alive = weights > 0.0
    found: Array = (1.0 - EVEN) * weights + EVEN * alive / alive.sum(axis=0)
    return found


class Pool:
    """Draws of some runs, of all rounds until now.

    Attributes
    ----------
    target : Target
        The exact density, and where components stand.
    values : ndarray
        The draws by slice, (T+1, runs, S, m + n).
    log_target, log_prior : ndarray
        (runs, S): ln p(x, z), −∞ where a function of the model has no value, and ln d(x).
    rounds : list of Round
        What they were drawn from.
    """

    def __init__(self, target: Target) -> None:
        self.target = target
        self.rounds: list[Round] = []
        self.values: Array = np.zeros(0)
        self.log_target: Array = np.zeros(0)
        self.log_prior: Array = np.zeros(0)
        self._heights: list[Heights] = []

    @property
    def count(self) -> int:
        """S, the number of draws in each run."""
        return sum(each.count for each in self.rounds)

    def of(self, target: Target, runs: Integers) -> Pool:
        """The draws of some runs; `target` is of these."""
        found = Pool(target)
        found.values = self.values[:, runs]
        found.log_target, found.log_prior = self.log_target[runs], self.log_prior[runs]
        for each, own in zip(self.rounds, self._heights, strict=True):
            laws = each.laws.of(runs)
            found.rounds.append(Round(laws, _paths_of(target, laws), each.count))
            found._heights.append(Heights(own.squared[:, runs], own.level[:, runs], own.size[runs]))
        return found

    def draw(self, laws: Laws, count: int, rng: np.random.Generator) -> None:
        """Add a round of draws from laws.

        A NumericalError is raised if a law has no density.
        """
        made = Round(laws, _paths_of(self.target, laws), count)
        if not all(path.regular for path in made.paths):
            raise without_density()
        size = _size(made.paths[0])
        part = _defensive(size)
        ends = np.cumsum((1.0 - part)[:, None] * made.shares.T, axis=1)
        places = (np.arange(count) + 0.5) / count
        kinds = (ends[..., None] <= places).sum(axis=1)
        scale = np.ones((*kinds.shape, 1))
        few = np.broadcast_to((size <= FEW)[:, None], kinds.shape)
        stretch(scale, few, rng)
        scale[few] *= WIDER
        source = _Source(self.target, made, kinds, scale, rng)
        drawn = self.target.draw(source, kinds.shape)
        log_target = np.where(np.isnan(drawn.log_density), -np.inf, drawn.log_density)
        values, prior = drawn.values, source.prior
        if not self.rounds:
            self.values, self.log_target, self.log_prior = values, log_target, prior
        else:
            self._heights = [
                _joined(own, heights_of(self.target, each.laws, values, each.paths))
                for own, each in zip(self._heights, self.rounds, strict=True)
            ]
            self.values = np.concatenate([self.values, values], axis=2)
            self.log_target = np.concatenate([self.log_target, log_target], axis=1)
            self.log_prior = np.concatenate([self.log_prior, prior], axis=1)
        self.rounds.append(made)
        self._heights.append(self.heights(laws, made.paths))

    def heights(self, laws: Laws, paths: list[Path] | None = None) -> Heights:
        """The densities of all draws under laws."""
        return heights_of(self.target, laws, self.values, paths)

    def log_proposal(self, last: bool = False) -> Array:
        """The log-density ln r of the mixture of all rounds, (runs, S), or of the last alone."""
        parts = []
        every = list(zip(self.rounds, self._heights, strict=True))
        for made, heights in every[-1:] if last else every:
            part = _defensive(heights.size)[:, None]
            with np.errstate(divide="ignore"):  # a mode that a run does not have
                modes = log_sum(np.log(made.shares)[..., None] + heights.proposed, 0)
            own = np.logaddexp(np.log1p(-part) + modes, np.log(part) + self.log_prior)
            parts.append(own + (0.0 if last else log(made.count / self.count)))
        return log_sum(np.stack(parts), 0)


def _size(path: Path) -> Integers:
    """The number of components that have noise in a law, (runs,)."""
    parts = path.first.size, *(() if path.later is None else (path.later.size,))
    found: Integers = np.concatenate(parts).sum(axis=0)
    return found


def _defensive(size: Integers) -> Array:
    """The part of draws that is defensive, (runs,), of so many components."""
    return np.where(size <= FEW, DEFENSIVE, RARELY)


class _Source:
    """Draws of a round: each of a mode, or of the model alone.

    kinds : ndarray
        (runs, S): the mode of each draw; K are defensive draws.
    scale : ndarray
        (runs, S, 1): by how much the noise of each draw is stretched.
    prior : ndarray
        (runs, S): ln d.
    """

    def __init__(
        self,
        target: Target,
        made: Round,
        kinds: Integers,
        scale: Array,
        rng: np.random.Generator,
    ) -> None:
        self._target, self._made, self._rng = target, made, rng
        self._kinds, self._scale = kinds, scale
        self.prior = np.zeros(kinds.shape)
        self._index = 0

    def propose(self, given: Array) -> tuple[Array, Afresh]:
        """Draw the next slice given the states before; see `Proposing`."""
        laws, paths = self._made.laws, self._made.paths
        proposal, row = paths[0].at(self._index)
        white = self._scale * proposal.white(row, self._kinds.shape[1], self._rng)
        about = near(self._target, laws, 0, self._index, given[None])[0]
        values = proposal.values(row, about, white)
        for k, path in enumerate(paths[1:], 1):
            own, place = path.at(self._index)
            here = (self._kinds == k)[..., None]
            about = near(self._target, laws, k, self._index, given[None])[0]
            values = np.where(here, own.values(place, about, white), values)
        self._index += 1
        return values, Afresh(self._kinds == len(paths), self._rng)

    def weigh(self, given: Array, values: Array, predicted: Array) -> None:
        """Add the density of slices by the model's own CPDs; see `Proposing`."""
        self.prior += predicted.sum(axis=0)


def near(target: Target, laws: Laws, k: int, index: int, given: Array) -> Array:
    """The states before slices from `index` on, (steps, runs, S, m), on the branch of a mode.

    Its law is linear, and knows no turns of angles.
    """
    if index < 2 or not target.turned.any():
        return given
    mean = laws.mean[k, index - 1 : index - 1 + len(given)][:, :, None, : given.shape[-1]]
    return nearest_branch(given, mean, target.turned[target.states])


def _paths_of(target: Target, laws: Laws) -> list[Path]:
    """The laws of all modes, as they are drawn from."""
    return [target.path(laws, k) for k in range(len(laws.weights))]


def heights_of(
    target: Target, laws: Laws, values: Array, paths: list[Path] | None = None
) -> Heights:
    """The densities of draws (T+1, runs, S, m + n) under laws."""
    before, paths = target.before, paths or _paths_of(target, laws)
    squared = np.zeros((len(paths), *values.shape[1:3]))
    many = max(1, BLOCK // max(1, math.prod(values.shape[1:])))
    level = np.zeros(squared.shape[:2])
    for k, path in enumerate(paths):
        start = values[0][..., before:][..., target.states]
        white = path.first.whitened(0, start[..., :0], start)
        squared[k], level[k] = inner(white, white), path.first.level[0]
        if path.later is None:
            continue
        turned = target.turned if target.turned.any() else None
        for first, last in pairwise([1, *range(2, len(values), many), len(values)]):
            pairs, rows = values[first:last], slice(first - 1, last - 1)
            about = near(target, laws, k, first, pairs[..., :before])
            white = path.later.whitened(rows, about, pairs[..., before:], turned)
            squared[k] += inner(white, white).sum(axis=0)
            level[k] += path.later.level[rows].sum(axis=0)
    return Heights(squared, level, _size(paths[0]))


def _joined(first: Heights, second: Heights) -> Heights:
    """The densities of some draws, then of others."""
    return first._replace(squared=np.concatenate([first.squared, second.squared], axis=2))


class Weighed:
    """The weights of a pool's draws, beside those of a mixture q of laws; y = p/r.

    Attributes
    ----------
    log_weights : ndarray
        ln y, (runs, S).
    gaussian : ndarray
        The log-densities of the laws' Gaussians, (K, runs, S).
    log_mixture : ndarray
        ln q, (runs, S).
    log_evidence, error : ndarray
        (runs,): ln Ẑ, by the mean of y with q/r as control variate, and its standard error.
    """

    def __init__(self, pool: Pool, laws: Laws) -> None:
        self.gaussian = pool.heights(laws).gaussian
        self.log_proposal = pool.log_proposal()
        self.log_weights = pool.log_target - self.log_proposal
        with np.errstate(divide="ignore"):
            self._parts = np.log(laws.weights)[..., None] + self.gaussian
        self.log_mixture = log_sum(self._parts, 0)
        peak = self.log_weights.max(axis=1, keepdims=True)
        if not np.isfinite(peak).all():
            run = int(np.flatnonzero(~np.isfinite(peak))[0])
            raise NumericalError(
                f"run {run}: no draw has a density under the model that float64 can hold; are its "
                "units and noises of a size that fits the data?",
                run=run,
            )
        weights = np.exp(self.log_weights - peak)
        control = np.exp(self.log_mixture - self.log_proposal)
        slope = slope_of(weights, control)
        value = weights.mean(axis=1) - slope * (control.mean(axis=1) - 1.0)
        proper = value > 0.0
        slope = np.where(proper, slope, 0.0)
        value = np.where(proper, value, weights.mean(axis=1))
        self.log_evidence = peak[:, 0] + np.log(value)
        rest = weights - slope[:, None] * control
        self.error = rest.std(axis=1) / value / np.sqrt(rest.shape[1])

    @cached_property
    def weights(self) -> Array:
        """The weights y/Ẑ, (runs, S), of mean one but for chance."""
        found: Array = np.exp(self.log_weights - self.log_evidence[:, None])
        return found

    @cached_property
    def by_mode(self) -> Array:
        """The weights y/Ẑ, each shared among the modes by their densities, (K, runs, S)."""
        found: Array = self.weights * np.exp(self._parts - self.log_mixture)
        return np.where(np.isfinite(found), found, 0.0)

    @cached_property
    def controls(self) -> Array:
        """The Gaussians of the laws over r, (K, runs, S), of mean one but for chance."""
        found: Array = np.exp(self.gaussian - self.log_proposal)
        return found

    @cached_property
    def effective(self) -> Array:
        """The effective number of draws, (Σ y)² / Σ y², (runs,)."""
        return effective(self.weights)


# The slope of a control variate at the most, as a multiple of the mean of what it controls.
_STEEPEST = 2.0


def slope_of(values: Array, control: Array) -> Array:
    """The slope of the regression of positive values on a control, along the last axis.

    A regression through few values may overshoot: it is within twice their mean.
    """
    about = control - control.mean(axis=-1, keepdims=True)
    spread = (about * about).sum(axis=-1)
    some = spread > 0.0
    found = (about * values).sum(axis=-1) / np.where(some, spread, 1.0)
    mean = values.mean(axis=-1)
    return np.where(some, np.clip(found, -_STEEPEST * mean, _STEEPEST * mean), 0.0)


def effective(weights: Array) -> Array:
    """The effective number (Σ w)² / Σ w² of draws of weights w, along the last axis."""
    squares = (weights * weights).sum(axis=-1)
    found: Array = weights.sum(axis=-1) ** 2 / np.where(squares > 0.0, squares, 1.0)
    return found
