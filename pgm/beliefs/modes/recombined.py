r"""Trajectories recombined from draws of each step: a draw may follow any draw of the step before.

Where a chain is ambiguous at many steps, each apart from the others, it has more modes than can be
counted, and few draws of whole trajectories weigh anything. Here S values of the slice x are drawn
at each step t from a density q that covers the belief of that step alone. Forward in time the
weight of a draw is

.. math:: W_t(j) ∝ p(z_t \mid x_j) \sum_i W_{t-1}(i)\, p(x_j \mid x_i) / q_t(x_j),

and the mean of the right side over j is an estimate of the evidence of z at t, given z before.
Backward in time the draw i came before j with a probability ∝ W(i) p(x_j | x_i): so
trajectories are drawn from the posterior, and all weights are smoothed. It costs S² densities a
step.

q has in equal parts the Gaussians of modes at the step; the model's own motion from draws of the
step before, whose density is the sum above; and, in a second pass, kernels about draws of the
first, by their smoothed weights.

References
----------
Neal, Beal & Roweis, Inferring state sequences for non-linear systems with embedded hidden Markov
models, 2003. Klaas, de Freitas & Doucet, Toward practical N² Monte Carlo: the marginal particle
filter, 2005. Godsill, Doucet & West, Monte Carlo smoothing for nonlinear time series, 2004.

Arrays of draws are (runs, S, n), of n components of a slice, m of which are states; at step 0 they
have the states alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from pgm.beliefs.modes.adapted import sums
from pgm.beliefs.modes.laws import Laws, without_density
from pgm.beliefs.modes.pool import WIDER, effective, even
from pgm.beliefs.moments.trajectories.density import Afresh
from pgm.beliefs.moments.trajectories.model import ChainModel, Weighed
from pgm.beliefs.moments.trajectories.student import log_ratio, stretch
from pgm.kernels import normal_density, roots, solving
from pgm.kernels.angles import difference
from pgm.kernels.arrays import LOG_2PI, Array, Integers, Mask, inner
from pgm.kernels.semirings import log_sum


class Pass(NamedTuple):
    """The draws of all steps, and trajectories recombined from them.

    points: By step, (runs, S, n).
    weights: Their smoothed weights, by step, (runs, S), of sum one.
    log_evidence: (runs,); −∞ where at some step no draw has a density.
    trajectories: Draws of the posterior, of equal weights.
    """

    points: list[Array]
    weights: list[Array]
    log_evidence: Array
    trajectories: Weighed

    @property
    def worst(self) -> Array:
        """The smoothed weights of the step at which the fewest draws count, (runs, S)."""
        every = np.stack(self.weights)
        few = (every * every).sum(axis=-1).argmax(axis=0)
        found: Array = every[few, np.arange(every.shape[1])]
        return found


class Cover(NamedTuple):
    """A mixture of C densities of a slice, Student's t about Gaussians.

    shares: (runs, C), of sum one.
    mean: (runs, C, n).
    lower: The roots of covariances, (runs, C or 1, n, n).
    """

    shares: Array
    mean: Array
    lower: Array

    def draw(self, kinds: Integers, rng: np.random.Generator) -> Array:
        """Draws of the components `kinds`, (runs, S, n)."""
        runs, size = np.arange(len(kinds))[:, None], self.mean.shape[-1]
        lower = self.lower[runs, kinds if self.lower.shape[1] > 1 else 0]
        white = rng.standard_normal((*kinds.shape, size))
        stretch(white, np.ones(kinds.shape, dtype=bool), rng)
        found: Array = self.mean[runs, kinds] + (lower @ white[..., None])[..., 0]
        return found

    def parts(self, values: Array, turned: Mask) -> Array:
        """The logarithms of all components' parts of the density at values, (runs, C, S)."""
        size = self.mean.shape[-1]
        off = difference(self.mean[:, :, None], values[:, None], turned)
        white = normal_density.whitened(self.lower, off)[0]
        squared = inner(white, white)
        level = -0.5 * (solving.log_determinant(self.lower) + size * LOG_2PI)[..., None]
        own = level - 0.5 * squared + log_ratio(np.asarray(size), squared)
        with np.errstate(divide="ignore"):  # a mode that a run does not have
            return np.asarray(np.log(self.shares)[..., None] + own)


@dataclass(frozen=True, eq=False)
class Recombination:
    """The draws of a chain's steps, that are recombined.

    model : ChainModel
        The densities of the chain and its measurements, of draws that are not near each other.
    laws : Laws
        Of the modes.
    """

    model: ChainModel
    laws: Laws

    @property
    def steps(self) -> int:
        """The last step."""
        steps: int = self.laws.mean.shape[1]
        return steps

    def run(self, count: int, kept: int, before: Pass | None, rng: np.random.Generator) -> Pass:
        """A pass of so many draws a step, of which so many trajectories are `kept`.

        `before` is the pass about whose draws kernels stand.
        """
        points: list[Array] = []
        logs: list[Array] = []
        total = np.zeros(self.laws.weights.shape[1])
        for step in range(self.steps + 1):
            last = (self._states(step - 1, points[-1]), logs[-1]) if step else None
            drawn, log_weights = self._drawn(step, count, last, before, rng)
            total += log_sum(log_weights, 1) - np.log(count)
            lost = (log_weights == -np.inf).all(axis=1)[:, None]  # its evidence is 0 from here on
            log_weights = np.where(lost, 0.0, log_weights)
            mass = log_sum(log_weights, 1)
            points.append(drawn)
            logs.append(log_weights - mass[:, None])
        weights, picks = self._back(points, logs, kept, rng)
        source = _Picked([np.take_along_axis(*each, 1) for each in zip(points, picks, strict=True)])
        shape = len(total), kept
        return Pass(points, weights, total, self.model.draw(source, shape, strict=False))

    def _drawn(
        self,
        step: int,
        count: int,
        last: tuple[Array, Array] | None,
        before: Pass | None,
        rng: np.random.Generator,
    ) -> tuple[Array, Array]:
        """The draws of a step, and the logarithms of their weights, whose mean is the evidence.

        `last` are the states and log-weights of the step before.
        """
        covers = [self._modes(step)]
        if before is not None:
            covers.append(self._kernels(step, before))
        runs = len(covers[0].mean)
        groups = np.array_split(np.arange(count), len(covers) + 1)
        parts = [
            cover.draw(_stratified(cover.shares, len(group), rng), rng)
            for cover, group in zip(covers, groups, strict=False)
        ]
        vector = self._afresh(step, len(groups[-1]), last, runs, rng)
        drawn = np.concatenate([*parts, vector], axis=1)
        if last is None:
            own, tails = (each[0] for each in self.model.moved(0, drawn[None], strict=False))
        else:
            states, logs = last
            own, tails = (
                log_sum(logs[..., None] + each, 1) for each in self._pairs(step, states, drawn)
            )
        turned = self._turned(step)
        proposed = [log_sum(cover.parts(drawn, turned), 1) for cover in covers] + [tails]
        sizes = np.log([len(group) / count for group in groups])
        density = log_sum(np.stack([a + b for a, b in zip(proposed, sizes, strict=True)]), 0)
        read = self.model.read(step, self._slices(step, drawn)[None], strict=False)
        found = own - density + read
        return drawn, np.where(np.isnan(found), -np.inf, found)

    def _back(
        self, points: list[Array], logs: list[Array], kept: int, rng: np.random.Generator
    ) -> tuple[list[Array], list[Integers]]:
        """The smoothed weights of draws, (runs, S), and the picks of trajectories, (runs, kept, 1).

        `logs` are the logarithms of the weights that are given the measurements until their step.
        """
        weights = [np.exp(logs[-1])]
        picks = [_stratified(weights[0], kept, rng)]
        for step in range(self.steps, 0, -1):
            pairs, _ = self._pairs(step, self._states(step - 1, points[step - 1]), points[step])
            joint = logs[step - 1][..., None] + pairs
            total = log_sum(joint, 1)[:, None]
            some = total > -np.inf  # else the draw weighs nothing, and is not picked
            before = np.exp(np.where(some, joint, 0.0) - np.where(some, total, 0.0))
            weights.append((before @ weights[-1][..., None])[..., 0])
            ends = np.cumsum(before, axis=1)
            own = np.take_along_axis(ends, picks[-1][:, None], 2)
            level = rng.random((len(own), 1, kept)) * own[:, -1:]
            picks.append((own <= level).sum(axis=1).clip(max=ends.shape[1] - 1))
        return weights[::-1], [each[..., None] for each in picks[::-1]]

    def _pairs(self, step: int, states: Array, drawn: Array) -> tuple[Array, Array]:
        """The log-densities of each draw given each of the states before, (runs, S, S).

        And those with Student's t for the noise.
        """
        runs, before, size = states.shape
        shape = runs, before, drawn.shape[1]
        vector = np.empty((*shape, size + drawn.shape[2]))
        vector[..., :size], vector[..., size:] = states[:, :, None], drawn[:, None]
        flat = vector.reshape(runs, -1, vector.shape[-1])
        self.model.make_children(step, flat, None)  # puts angles on the branch of their parents
        found = self.model.moved(step, flat[None], strict=False)
        own, tails = (np.where(np.isnan(each[0]), -np.inf, each[0]) for each in found)
        return own.reshape(shape), tails.reshape(shape)

    def _afresh(
        self,
        step: int,
        count: int,
        last: tuple[Array, Array] | None,
        runs: int,
        rng: np.random.Generator,
    ) -> Array:
        """Draws of a step by the model's own motion, from states drawn by their weights."""
        states = np.zeros((runs, count, 0))
        if last is not None:
            places = _stratified(np.exp(last[1]), count, rng)
            states = np.take_along_axis(last[0], places[..., None], 1)
        front, layout = states.shape[-1], self.model.plan.layout
        size = layout.slice_size if step else layout.state_size
        vector = np.concatenate([states, np.zeros((runs, count, size))], axis=-1)
        self.model.make_children(step, vector, Afresh(np.ones((runs, count), dtype=bool), rng))
        return vector[..., front:]

    def _marginals(self, step: int) -> tuple[Array, Array]:
        """The means and covariances of a slice in each mode, (K, runs, n) and (K, runs, n, n)."""
        if not step:
            return self.laws.first[:, 0], self.laws.spread[:, 0]
        own = slice(self.model.plan.layout.state_size, None)
        return self.laws.mean[:, step - 1][..., own], self.laws.cov[:, step - 1][..., own, own]

    def _modes(self, step: int) -> Cover:
        """The wider Gaussians of modes at a step."""
        mean, cov = self._marginals(step)
        lower = WIDER * roots.root(cov)
        if roots.determined(lower).any():
            raise without_density()
        return Cover(even(self.laws.weights).T, mean.swapaxes(0, 1), lower.swapaxes(0, 1))

    def _kernels(self, step: int, before: Pass) -> Cover:
        """Kernels about the draws of a pass, as wide as suits the number N of those that count.

        Their covariance is that of draws about the modes that they belong to, with the modes' own
        as one draw more, times N^(−2/(n + 4)) (Scott, Multivariate Density Estimation, 1992).
        """
        drawn, weights, turned = before.points[step], before.weights[step], self._turned(step)
        mean, cov = self._marginals(step)
        parts = self._modes(step).parts(drawn, turned).swapaxes(0, 1)
        shares = weights * np.exp(parts - log_sum(parts, 0))
        within = (self.laws.weights[..., None, None] * cov).sum(axis=0)
        number = effective(weights)[:, None, None]
        for share, centre in zip(shares, mean, strict=True):
            mass = share.sum(axis=1)[:, None, None]
            shift, square = (
                each[0] for each in sums(share * share.shape[1], drawn[None], centre[None], turned)
            )
            outer = shift[..., :, None] * shift[..., None, :]
            within += number * (square - outer / np.where(mass > 0.0, mass, 1.0))
        width = number ** (-2.0 / (drawn.shape[-1] + 4.0)) / (number + 1.0)
        return Cover(weights, drawn, roots.root(width * within)[:, None])

    def _turned(self, step: int) -> Mask:
        """The components of a slice that are known but for whole turns, (n,)."""
        turned = self.model.law.turned
        return turned if step else np.zeros(self.model.plan.layout.state_size, dtype=bool)

    def _states(self, step: int, drawn: Array) -> Array:
        """The states among the components of draws."""
        return drawn[..., self.model.plan.layout.state_places] if step else drawn

    def _slices(self, step: int, drawn: Array) -> Array:
        """Draws as slices, in which at step 0 all but the states are zero."""
        if step:
            return drawn
        layout = self.model.plan.layout
        found = np.zeros((*drawn.shape[:2], layout.slice_size))
        found[..., layout.state_places] = drawn
        return found


class _Picked:
    """The source of trajectories whose slices have been picked, step by step."""

    def __init__(self, slices: Sequence[Array]) -> None:
        self._left = iter(slices)

    def propose(self, given: Array) -> tuple[Array, None]:
        """The next slice; see `Proposing`."""
        return next(self._left), None

    def weigh(self, given: Array, values: Array, predicted: Array) -> None:
        """Nothing is noted; see `Proposing`."""


def _stratified(shares: Array, count: int, rng: np.random.Generator) -> Integers:
    """So many places drawn by shares (runs, C), one in each of as many equal strata, shuffled."""
    ends = np.cumsum(shares, axis=1)
    level = (np.arange(count) + rng.random((len(shares), count))) / count * ends[:, -1:]
    places = [np.searchsorted(own, at, side="right") for own, at in zip(ends, level, strict=True)]
    return rng.permuted(np.minimum(places, shares.shape[1] - 1), axis=1)
