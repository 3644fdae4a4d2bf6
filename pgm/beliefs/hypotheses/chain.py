"""The forward pass of a mixed chain: pairs of a Gaussian and a regime, merged into a few Gaussians.

A *component* is one of the K Gaussians that a step's belief is kept as; it belongs to one memory,
the states of the discrete variables that the next slice depends on. A *pair* is a component and one
of the S regimes of the next step: a hypothesis, which is predicted, and takes the measurements in,
as a run of a chain without discrete variables. Arrays have the n components of a slice first, then
hypotheses, then the runs: (n, K, runs) of components, (n, K, S, runs) of pairs. Hypotheses of
log-weight −∞ are dead.

A hypothesis that makes a measurement certain outweighs all that give it a density, whatever that
is, unless these make others certain. So hypotheses have *counts*, of the measured components that
they made certain so far, and those of the highest count alone have a probability. Where none makes
anything certain, as without exact CPDs, all counts are the number 0, and cost nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from pgm.beliefs.hypotheses.cases import Batch, Choices, Given, motions, sensors, starts
from pgm.beliefs.hypotheses.regimes import Regimes
from pgm.beliefs.hypotheses.roles import Roles
from pgm.beliefs.moments.steps.chain import MomentChain, largest
from pgm.beliefs.moments.steps.readings import Moments, Reading
from pgm.beliefs.moments.steps.vector import vector
from pgm.errors import ModelError, NumericalError
from pgm.kernels import merging
from pgm.kernels.arrays import (
    Array,
    Integers,
    Mask,
    apply,
    components_last,
    sandwich,
    symmetric,
    transpose,
)
from pgm.kernels.semirings import log_sum
from pgm.kernels.solving import regression

# Members further apart than this, by their KL divergence, may begin a component each.
APART = 0.05


Counts = Integers | int


class Belief(NamedTuple):
    """The components of a step: log-weights, memories and counts, (K, runs), and moments."""

    logs: Array
    memory: Integers
    counts: Counts
    mean: Array
    cov: Array

    @property
    def shares(self) -> Array:
        """The logarithms of the components' probabilities, (K, runs)."""
        return leading(self.logs, self.counts, 0)


class Pairs(NamedTuple):
    """The pairs of a step: log-weights and counts, (K, S, runs), and moments.

    `choice` is the number of the motion's choice that leads to each, (K, S, runs or 1).
    """

    logs: Array
    counts: Counts
    mean: Array
    cov: Array
    choice: Integers | None = None
    mixed: Mixing | None = None


# What a sweep carries: the pairs of a prediction, and the components that they are merged into.
State = Belief | Pairs


class Mixing(NamedTuple):
    """The components of a step as they were mixed for each regime of the next: (K, S, runs).

    `logs` are the log-weights of the components in each regime; `members` their means, moved to the
    branch of the mixture; `mean` (n, 1, S, runs) and `cov` are those of the mixtures.
    """

    logs: Array
    members: Array
    cov: Array
    mean: Array
    whole: Array


class Seen(NamedTuple):
    """The measurements of a step as what flows back needs them, of pairs (K, S, runs, ...).

    With H, the residual ν and its covariance S they are u = Hᵀ S⁻¹ ν (..., n), U = Hᵀ S⁻¹ H
    (..., n, n), and I − P U, P being the covariance of the prediction.
    """

    vector: Array
    information: Array
    matrix: Array


class Kept(NamedTuple):
    """A step as what flows back needs it; the members' means are on their component's branch."""

    pairs: Pairs
    seen: Seen | None
    owner: Integers
    known: Belief
    members: Array


@dataclass(frozen=True)
class Settings:
    """How many Gaussians are kept, whether they are mixed before a prediction, and for what."""

    count: int
    mix: bool
    back: bool


class HypothesisChain:
    """The forward pass: `start`, `predict` and `take` of a sweep.

    Attributes
    ----------
    kept : list of Kept
        By step, if beliefs are to flow back.
    """

    def __init__(
        self,
        given: Given,
        regimes: Regimes,
        roles: Roles,
        settings: Settings,
    ) -> None:
        self.given, self.regimes, self.settings = given, regimes, settings
        self.angles = np.flatnonzero(np.concatenate([v.angle_mask for v in given.hidden]))
        self.runs = given.bound.runs
        count, back = settings.count, settings.back
        self.size = sum(v.dimension for v in given.hidden)
        self._prior = Choices(regimes, roles.prior)
        self._moving = Choices(regimes, roles.transition, later=True)
        self._seeing = Choices(regimes, roles.observation)
        # Of each memory the choice in each regime; one row where the memory makes no difference.
        of = self._moving.of
        self._by_memory = bool((of != of[:1]).any())
        if settings.mix and self._by_memory:
            raise ModelError(
                "mix=True mixes the Gaussians of all states of the step before, and motions are "
                "chosen by these (.previous): leave mix out"
            )
        copies = 1 if settings.mix else count
        self._motions = motions(
            given, self._moving, roles.inputs, copies, keep=back, mixed=settings.mix
        )
        self._readings = roles.readings
        self._first = sensors(given, self._seeing, roles.readings, 1)
        self._sensors = self._first
        if copies > 1:
            self._sensors = sensors(given, self._seeing, roles.readings, copies)
        self.kept: list[Kept] = []
        self.regime_logs: list[Array] = []

    def start(self) -> State:
        """The pairs of step 0: the prior's Gaussian in each regime."""
        regimes, size = self.regimes, self.size
        mean = np.zeros((size, 1, regimes.size, self.runs))
        cov = np.zeros((size, size, 1, regimes.size, self.runs))
        for which, chain in starts(self.given, self._prior):
            found = chain.start()
            shape = which.size, self.runs
            mean[:, 0, which] = found.mean.reshape(size, *shape)
            cov[:, :, 0, which] = found.cov.reshape(size, size, *shape)
        logs = np.broadcast_to(regimes.prior(), (regimes.size, self.runs))[None]
        return Pairs(logs, 0, mean, cov)

    def predict(self, step: int, belief: State) -> State:
        """The pairs of a step: each component predicted by the motion of each regime."""
        assert isinstance(belief, Belief)
        onward = self.regimes.onward(step)
        if onward.shape[-1] == 1:
            logs = np.moveaxis(onward[belief.memory][..., 0], -1, 1)
        else:
            logs = np.moveaxis(onward[belief.memory, :, np.arange(self.runs)], -1, 1)
        logs = belief.logs[:, None] + logs
        counts = belief.counts
        if isinstance(counts, np.ndarray):
            counts = np.broadcast_to(counts[:, None], logs.shape)
        if self.settings.mix:
            return self._mixed(step, belief, logs, counts)
        count, of = len(belief.logs), self._moving.of
        mean, cov = self._moved(step, belief.mean[:, :, None], belief.cov[:, :, :, None], count)
        if self._moving.count == 1:
            shape = (count, self.regimes.size, self.runs)
            choice = np.zeros((1, self.regimes.size, 1), dtype=np.intp)
            mean = np.broadcast_to(mean, (len(mean), *shape))
            cov = np.broadcast_to(cov, (*cov.shape[:2], *shape))
        elif not self._by_memory:
            choice = of[:1, :, None]
            mean, cov = mean[:, :, of[0]], cov[:, :, :, of[0]]
        else:
            choice = np.moveaxis(of[belief.memory], -1, 1)
            mean = np.take_along_axis(mean, choice[None], axis=2)
            cov = np.take_along_axis(cov, choice[None, None], axis=3)
        return Pairs(logs, counts, mean, cov, choice)

    def _mixed(self, step: int, belief: Belief, logs: Array, counts: Counts) -> Pairs:
        """The pairs of one Gaussian and each regime, mixed of all components beforehand."""
        size, (count, _, runs) = len(belief.mean), logs.shape
        shape = (count, self.regimes.size, runs)
        mean = np.broadcast_to(belief.mean[:, :, None], (size, *shape))
        cov = np.broadcast_to(belief.cov[:, :, :, None], (size, size, *shape))
        owner = np.zeros(shape, dtype=np.intp)
        logs, counts = best_of(logs, counts, owner, 1)
        found = merging.merged(logs, owner, 1, mean, cov, self.angles)
        before = Mixing(logs, found.members, cov, found.mean, found.cov)
        after = self._moved(step, found.mean, found.cov, 1)
        return Pairs(found.logs, counts, *after, self._moving.of[:1, :, None], before)

    def _moved(self, step: int, mean: Array, cov: Array, copies: int) -> tuple[Array, Array]:
        """Moments predicted by each choice of the motion, or mixed ones by that of their regime.

        `mean` is (n, copies, 1, runs), and what is returned has the choices on the axis of length
        one; or (n, 1, regimes, runs), and so is what is returned.
        """
        size, parts = len(mean), self._motions
        found: list[Moments] = []
        for batch in parts:
            chain, local = batch.at(step)
            own = _as_runs(mean, cov, batch.which, copies, chain)
            moved, batch.used = chain.predict(local, own), True
            shape = copies, batch.which.size, self.runs
            found.append(
                Moments(moved.mean.reshape(size, *shape), moved.cov.reshape(size, size, *shape))
            )
        if len(found) == 1:
            return found[0]
        total = sum(batch.which.size for batch in parts)
        whole = np.empty((size, copies, total, self.runs))
        spread = np.empty((size, size, copies, total, self.runs))
        for batch, part in zip(parts, found, strict=True):
            whole[:, :, batch.which], spread[:, :, :, batch.which] = part
        return whole, spread

    def take(self, step: int, pairs: State) -> tuple[State, Array]:
        """The components given the measurements of a step, and their log-density, (runs,)."""
        assert isinstance(pairs, Pairs)
        found = self._taken(step, pairs)
        logs, counts, mean, cov, seen = *pairs[:4], None
        if found is not None:
            mean, cov, seen = found.mean, found.cov, found.seen
            logs, counts = logs + found.density, counts + found.certain
        likelihood = self.regimes.likelihood(step)
        if likelihood is not None:
            logs = logs + likelihood
        total = log_sum(leading(logs, counts, (0, 1)), (0, 1))
        if not (total > -np.inf).all():
            self._refuse(step, total)
        known = pairs._replace(logs=logs - total, counts=counts, mean=mean, cov=cov)
        return self._merged(known, seen), total

    def _taken(self, step: int, pairs: Pairs) -> Taken | None:
        """All pairs with the measurements of a step taken in; None without any."""
        if not self._readings:
            return None
        batches = self._sensors if step else self._first
        every = [(batch.which, self._of_batch(batch, step, pairs)) for batch in batches]
        found = [(which, each) for which, each in every if each is not None]
        if not found:
            return None
        if len(every) == 1:
            return found[0][1]
        shape = pairs.logs.shape
        mean, cov, density = pairs.mean.copy(), pairs.cov.copy(), np.zeros(shape)
        certain = np.zeros(shape, dtype=np.intp)
        seen = _nothing(len(mean), shape) if self.settings.back else None
        for which, each in found:
            mean[:, :, which], cov[:, :, :, which] = each.mean, each.cov
            density[:, which], certain[:, which] = each.density, each.certain
            if seen is not None and each.seen is not None:
                for whole, part in zip(seen, each.seen, strict=True):
                    whole[:, which] = part
        return Taken(mean, cov, density, certain if certain.any() else 0, seen)

    def _merged(self, pairs: Pairs, seen: Seen | None) -> Belief:
        """The pairs given the measurements of a step, merged into components."""
        regimes, (copies, count, runs) = self.regimes, pairs.logs.shape
        members, size = copies * count, len(pairs.mean)
        logs = pairs.logs.reshape(members, runs)
        mean = pairs.mean.reshape(size, members, runs)
        cov = pairs.cov.reshape(size, size, members, runs)
        kind = np.broadcast_to(np.tile(regimes.memory, copies)[:, None], logs.shape)
        most = self.settings.count
        if most == regimes.memories:
            owner, memory = kind, np.broadcast_to(np.arange(most)[:, None], (most, runs))
        else:
            owner, memory = merging.seeded(
                logs, kind, regimes.memories, mean, cov, most, APART, self.angles
            )
        self.regime_logs.append(log_sum(leading(pairs.logs, pairs.counts, (0, 1)), 0))
        counts = pairs.counts
        if isinstance(counts, np.ndarray):
            logs, counts = best_of(logs, counts.reshape(members, runs), owner, most)
            pairs = pairs._replace(logs=logs.reshape(pairs.logs.shape))
        found = merging.merged(logs, owner, most, mean, cov, self.angles)
        known = Belief(found.logs, memory, counts, found.mean, found.cov)
        if self.settings.back:
            self.kept.append(Kept(pairs, seen, owner, known, found.members))
        return known

    def _of_batch(self, batch: Batch, step: int, pairs: Pairs) -> Taken | None:
        """The pairs of a batch's regimes, with the measurements of a step; None without any."""
        chain, local = batch.at(step)
        parts = chain.readings(local)
        if not parts:
            return None
        batch.used = True
        copies, size = len(pairs.logs), len(pairs.mean)
        shape = copies, batch.which.size, self.runs
        own = _as_runs(pairs.mean, pairs.cov, batch.which, copies, chain)
        after, density = chain.take(chain.plan.first + local, own, parts)
        assert chain.certain is not None
        certain = chain.certain.count
        if np.any(certain):
            certain = np.broadcast_to(certain, chain.plan.batch).reshape(shape)
        else:
            certain = 0
        return Taken(
            after.mean.reshape(size, *shape),
            after.cov.reshape(size, size, *shape),
            np.broadcast_to(density, chain.plan.batch).reshape(shape),
            certain,
            _flowing(parts, own, shape) if self.settings.back else None,
        )

    def settled(self) -> tuple[list[Array], Mask]:
        """The largest moves at each relinearisation, (runs,), and whether a run settled."""
        residuals: list[Array] = []
        converged = np.ones(self.runs, dtype=bool)
        for batch in (*self._motions, *self._first, *self._sensors):
            moved, own = batch.settled()
            residuals, converged = largest(residuals, moved), converged & own
        return residuals, converged

    def slopes(self, step: int, choice: Integers, copies: int) -> Array:
        """The F of the motion that led to each pair of a step, (copies, S, runs, n, n).

        `choice` (copies or 1, S, runs or 1) are the numbers of the pairs' choices of a motion.
        """
        size, mixed = self.size, self.settings.mix
        total = self.regimes.size if mixed else self._moving.count
        shape = copies, self.regimes.size, self.runs
        whole = np.empty((copies, total, self.runs, size, size))
        for batch in self._motions:
            own = copies, batch.which.size, self.runs, size, size
            whole[:, batch.which] = batch.slopes(step).reshape(own)
        if mixed:
            return whole
        index = np.broadcast_to(choice, shape)[..., None, None]
        return np.take_along_axis(whole, index, axis=1)

    def _refuse(self, step: int, total: Array) -> None:
        """Raise the NumericalError for measurements that every hypothesis excludes."""
        run = self.given.bound.first_run + int((total == -np.inf).argmax())
        raise NumericalError(
            f"the measurements at step {step}, run {run}, have probability zero, whatever the "
            "discrete variables are: each of their states is impossible, or contradicts an exact "
            "model; let the tables allow more, or give the CPDs of some case noise",
            step=step,
            run=run,
        )


def leading(logs: Array, counts: Counts, axes: int | tuple[int, ...]) -> Array:
    """The log-weights of the hypotheses of the highest count along axes; −∞ of the others."""
    if not isinstance(counts, np.ndarray):
        return logs
    counts = np.where(logs > -np.inf, counts, -1)
    return np.where(counts == counts.max(axis=axes, keepdims=True), logs, -np.inf)


def best_of(logs: Array, counts: Counts, owner: Integers, count: int) -> tuple[Array, Counts]:
    """The log-weights of the members of the highest count of each component; −∞ of the others.

    And the counts of the components, (count, *batch). `owner` is as of `kernels.merging`.
    """
    if not isinstance(counts, np.ndarray):
        return logs, counts
    counts = np.where(logs > -np.inf, counts, -1)
    own = owner == np.arange(count).reshape(count, *(1,) * owner.ndim)
    most = np.where(own, counts, -1).max(axis=1)
    return np.where(counts == np.take_along_axis(most, owner, axis=0), logs, -np.inf), most


class Taken(NamedTuple):
    """Pairs with the measurements of a step taken in, and the log-density of these.

    `certain` are how many measured components each pair determined, (copies, regimes, runs); 0 if
    none did.
    """

    mean: Array
    cov: Array
    density: Array
    certain: Counts
    seen: Seen | None


def _as_runs(mean: Array, cov: Array, which: Integers, copies: int, chain: MomentChain) -> Moments:
    """Some of the moments (n, copies, choices or 1, runs) as the runs of a batch."""
    size, batch = len(mean), chain.plan.batch
    runs = mean.shape[-1]
    if mean.shape[2] == 1:
        shape = copies, which.size, runs
        mean = np.broadcast_to(mean, (size, *shape))
        cov = np.broadcast_to(cov, (size, size, *shape))
    elif mean.shape[2] != which.size:
        mean, cov = mean[:, :, which], cov[:, :, :, which]
    return Moments(mean.reshape(size, *batch), cov.reshape(size, size, *batch))


def _flowing(parts: Sequence[Reading], before: Moments, shape: tuple[int, ...]) -> Seen:
    """What a step's measurements let flow back, by their last linearisation."""
    matrix, residual, noise, _ = vector([part.seen for part in parts], before.mean)
    batch = before.mean.shape[1:]
    h = components_last(np.broadcast_to(matrix, (*matrix.shape[:2], *batch)), 2)
    error = components_last(np.broadcast_to(noise, (*noise.shape[:2], *batch)), 2)
    nu, cov = components_last(residual, 1), components_last(before.cov, 2)
    spread = sandwich(h, cov) + error
    gain = regression(transpose(h), spread)
    size = cov.shape[-1]
    information = symmetric(gain @ h)
    return Seen(
        apply(gain, nu).reshape(*shape, size),
        information.reshape(*shape, size, size),
        (np.eye(size) - cov @ information).reshape(*shape, size, size),
    )


def _nothing(size: int, shape: tuple[int, ...]) -> Seen:
    """No measurements, of pairs of some shape."""
    every = np.tile(np.eye(size), (*shape, 1, 1))
    return Seen(np.zeros((*shape, size)), np.zeros((*shape, size, size)), every)
