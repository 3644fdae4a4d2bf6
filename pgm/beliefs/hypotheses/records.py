"""The records of a mixed chain's steps: components, pairs, and the stages between them.

Arrays have the n components of a slice first, then hypotheses, then the runs, as of `chain`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from pgm.beliefs.hypotheses.counts import Counts, leading
from pgm.beliefs.moments.steps.readings import Moments
from pgm.kernels.arrays import Array, Integers
from pgm.kernels.merging import Merged
from pgm.kernels.semirings import log_sum, subtrahend


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

    `choice` is the number of the motion's choice that leads to each, (K, S, runs or 1), and `moved`
    are the moments that the choices lead to, (n, K, choices, runs); or, of components that were
    `mixed` before, (n, 1, S, runs).
    """

    logs: Array
    counts: Counts
    mean: Array
    cov: Array
    choice: Integers | None = None
    moved: Moments | None = None
    mixed: Mixing | None = None

    def repeated(self, runs: int) -> Pairs:
        """The pairs of one run, as those of so many."""
        counts = self.counts
        if isinstance(counts, np.ndarray):
            counts = np.repeat(counts, runs, axis=-1)
        logs, mean, cov = (np.repeat(p, runs, axis=-1) for p in (self.logs, self.mean, self.cov))
        return Pairs(logs, counts, mean, cov)


# What a sweep carries: the pairs of a prediction, and the components that they are merged into.
State = Belief | Pairs


class Mixing(NamedTuple):
    """The components of a step as they were mixed for each regime of the next: (K, S, runs).

    `logs` are the log-weights of the components in each regime; `own` their means, and `members`
    these moved to the branch of the mixture; `cov` their covariances; `mean` (n, 1, S, runs) and
    `whole` are the moments of the mixtures. What is the same in all regimes is (K, 1, runs).
    """

    logs: Array
    own: Array
    members: Array
    cov: Array
    mean: Array
    whole: Array

    @property
    def turned(self) -> Array:
        """The whole turns that lead from `members` back to `own`, (n, K, S, runs)."""
        return np.broadcast_to(self.own - self.members, (len(self.own), *self.logs.shape))


class Members(NamedTuple):
    """The hypotheses of a stage, before they are merged: (members, runs), and moments.

    Each is one of so many `copies` of a component before, which vary fastest; of pairs these are
    regimes, and of sightings alternatives. `regime` is the regime of each; `paired` says that they
    are pairs.
    """

    logs: Array
    counts: Counts
    regime: Integers
    mean: Array
    cov: Array
    copies: int
    paired: bool = False

    def scaled(self) -> tuple[Members, Array]:
        """The members with log-weights of sum one, and the logarithm of the sum they had."""
        total = log_sum(leading(self.logs, self.counts, 0), 0)
        return Members(self.logs - subtrahend(total), *self[1:]), total


class Stage(NamedTuple):
    """Members as they were merged into components, for what flows back.

    `owner` is the component of each. The axis of members may be as two in `given`, the members'
    log-weights, of which those of lower counts than others of their component are −∞, and in
    `found`: see there.
    """

    members: Members
    owner: Integers
    given: Array
    found: Merged

    @property
    def logs(self) -> Array:
        """The log-weights that the members were merged by, (members, runs)."""
        return self.given.reshape(self.owner.shape)

    @property
    def mean(self) -> Array:
        """The means of the components, (n, components, runs)."""
        size, *_, runs = self.members.mean.shape
        return self.found.mean.reshape(size, -1, runs)

    @property
    def cov(self) -> Array:
        """The covariances of the components, (n, n, components, runs)."""
        size, *_, runs = self.members.mean.shape
        return self.found.cov.reshape(size, size, -1, runs)

    @property
    def moved(self) -> Array:
        """The means of the members on the branch of their component, (n, members, runs)."""
        return self.found.members.reshape(self.members.mean.shape)

    @property
    def turned(self) -> Array:
        """The whole turns that lead from `moved` back to the members' means, (n, members, runs)."""
        return self.members.mean - self.moved


class Kept(NamedTuple):
    """A step as what flows back needs it.

    The stages, the pairs of the first as they were predicted, and the belief that the step ends
    with.
    """

    stages: Sequence[Stage]
    pairs: Pairs
    known: Belief


class Swept(NamedTuple):
    """A forward pass by step, T+1 in all.

    The log-weights of the K Gaussians, (T+1, K, runs), their means (T+1, K, runs, n) and
    covariances, the log-probabilities of the regimes, (T+1, S, runs), and the log-densities of the
    measurements, (T+1, runs).
    """

    logs: Array
    mean: Array
    cov: Array
    regimes: Array
    density: Array


@dataclass(frozen=True)
class Settings:
    """How many Gaussians are kept, whether they are mixed before a prediction, and for what.

    `pieces` is the number of Gaussians that the prior is cut into, 1 if it is left whole. With
    `prune` the likeliest are kept and others left out, in place of merging.
    """

    count: int
    mix: bool
    back: bool
    pieces: int = 1
    prune: bool = False


@dataclass(frozen=True)
class Asked:
    """How many Gaussians are kept, None for as many as memories; and whether they are mixed.

    `pieces` is the number of Gaussians that the prior is cut into; with `prune` the likeliest are
    kept and others left out, none are merged.
    """

    count: int | None
    mix: bool
    pieces: int = 1
    prune: bool = False
