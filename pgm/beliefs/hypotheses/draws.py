"""Draws of whole trajectories of a mixed chain: a path of hypotheses, then the states given it.

A *path* is a hypothesis at each step: the pair that it predicted, and the member of each stage that
took measurements in. It is drawn from the last step back by the weights of the backward pass, so
that regimes, and those of two successive steps, have the smoothed probabilities. Given the path
the chain is one of Gaussians, as CPDs were linearised: it is filtered on its own, unmerged, and the
trajectory is drawn from its last step back to the first.

Paths are arrays (draws, runs), the moments of draws (draws, runs, n), an axis of n components last.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from pgm.beliefs.hypotheses.back import BackwardChain
from pgm.beliefs.hypotheses.records import Kept
from pgm.kernels import moments, roots
from pgm.kernels.arrays import Array, Integers, apply, components_last
from pgm.kernels.merging import Ratio
from pgm.kernels.moments import Conditional
from pgm.kernels.stochastic import Dense
from pgm.resources import require_memory

# About so many numbers of the Gaussians of paths are kept at a time.
_AT_A_TIME = 2**23


class Hypotheses(NamedTuple):
    """The hypotheses of a step on paths, (draws, runs) each.

    `source` is the component of the step before, `pair` that of the prediction among its pairs,
    which with mixed Gaussians have one source; `regime` is the regime, and `members` those of each
    stage.
    """

    source: Integers
    pair: tuple[Integers, Integers]
    members: Sequence[Integers]

    @property
    def regime(self) -> Integers:
        """The regime of each draw."""
        return self.pair[1]

    def of(self, draws: slice) -> Hypotheses:
        """The hypotheses of some of the draws."""
        first, regime = self.pair
        pair = first[draws], regime[draws]
        return Hypotheses(self.source[draws], pair, [each[draws] for each in self.members])


def draws(backward: BackwardChain, count: int, rng: np.random.Generator) -> tuple[Array, Integers]:
    """So many trajectories of slices, (T + 1, draws, runs, n), and their regimes, without n."""
    chain = backward.chain
    steps, size = chain.given.bound.steps + 1, chain.size
    require_memory(
        count * chain.runs * steps * (size + 2 + 2 * max(len(kept.stages) for kept in chain.kept)),
        f"{count:,} trajectories of {steps:,} steps in {chain.runs:,} runs",
        "draw fewer at a time",
    )
    paths = _paths(backward, count, rng)
    found = np.empty((steps, count, chain.runs, size))
    each = max(1, _AT_A_TIME // (steps * chain.runs * size * (2 * size + 3)))
    for first in range(0, count, each):
        some = slice(first, first + each)
        found[:, some] = _Followed(backward, [own.of(some) for own in paths]).drawn(rng)
    return found, np.stack([own.regime for own in paths])


def _paths(backward: BackwardChain, count: int, rng: np.random.Generator) -> list[Hypotheses]:
    """So many paths of each run, by step."""
    chain, found = backward.chain, list[Hypotheses]()
    component = np.zeros((count, chain.runs), dtype=np.intp)
    for step, flow, opened, two in backward.walk(chain.given.bound.steps):
        if not found:
            none = np.zeros(flow.logs.shape, dtype=np.intp)
            component = _picked(flow.logs, none, 1, component, rng)
        kept, members = chain.kept[step], list[Integers]()
        flows = backward.members(step, opened)
        for stage, each in zip(reversed(kept.stages), flows, strict=True):
            kinds = stage.mean.shape[1]
            members.append(_picked(each.logs, stage.owner, kinds, component, rng))
            component = members[-1] // stage.members.copies
        regime = members[-1] % chain.regimes.size
        pair = component, regime
        if two is not None and kept.pairs.mixed is not None:
            logs = backward.unmixed(step, two).logs
            sources, kinds, runs = logs.shape
            own = np.broadcast_to(
                np.tile(np.arange(kinds), sources)[:, None], (sources * kinds, runs)
            )
            component = _picked(logs.reshape(own.shape), own, kinds, regime, rng) // kinds
        found.append(Hypotheses(component, pair, members[::-1]))
    return found[::-1]


def _picked(
    logs: Array, owner: Integers, kinds: int, kind: Integers, rng: np.random.Generator
) -> Integers:
    """Draws of hypotheses that `owner` gives to a kind, (draws, runs), by their log-weights.

    `logs` and `owner` are (hypotheses, runs); `kind` (draws, runs) is one of so many kinds.
    """
    own = np.where(owner == np.arange(kinds)[:, None, None], logs, -np.inf)
    top = own.max(axis=1, keepdims=True)
    table = np.exp(own - np.where(top > -np.inf, top, 0.0))
    runs = table.shape[-1]
    rows = Dense(np.moveaxis(table, -1, 0).reshape(runs * kinds, -1))
    return rows.draw(np.arange(runs) * kinds + kind, rng)


class _Followed:
    """The Gaussians of paths, filtered forward: the last slice, and each slice given the next.

    `turns` are, by step, by how much the slice was moved to the branch of its component, and
    `sources`, by step from 1 on, what leads from a component before it to the branch of its
    mixture.
    """

    def __init__(self, backward: BackwardChain, paths: Sequence[Hypotheses]) -> None:
        chain = backward.chain
        self.run = np.arange(chain.runs)
        self.back: list[Conditional] = []
        self.turns: list[Array] = []
        self.sources: list[Array] = []
        mean = cov = np.zeros(0)
        for step, path in enumerate(paths):
            kept = chain.kept[step]
            if step:
                mixed, source = kept.pairs.mixed, np.asarray(0.0)
                if mixed is not None:
                    source = self._at(components_last(mixed.turned, 1), path.source, path.regime)
                self.sources.append(source)
                motion = chain.motion(step, kept.pairs, backward.moved(step))
                own = Conditional(*(self._at(part, *path.pair) for part in motion))
                before = mean - source, cov
                mean, cov = moments.push(*before, own)
                self.back.append(moments.reverse(*before, own.matrix, own.cov, mean, cov))
            else:
                mean, cov = (self._at(part, *path.pair) for part in _predicted(kept))
            mean, cov = self._taken(kept, path, mean, cov)
        self.last = mean, cov

    def _at(self, part: Array, *index: Integers) -> Array:
        """An array (hypotheses..., runs, ...) at the hypotheses of paths, (draws, runs, ...)."""
        found: Array = part[(*index, np.broadcast_to(self.run, index[0].shape))]
        return found

    def _taken(self, kept: Kept, path: Hypotheses, mean: Array, cov: Array) -> tuple[Array, Array]:
        """Predicted moments of paths with the measurements of a step taken in, stage by stage."""
        turn = np.zeros(mean.shape)
        before = tuple(part.reshape(-1, *part.shape[2:]) for part in _predicted(kept))
        for stage, own in zip(kept.stages, path.members, strict=True):
            turned = components_last(stage.turned, 1)
            members = stage.members
            later = components_last(members.mean, 1) + turned, components_last(members.cov, 2)
            if len(before[0]) != len(turned):  # each component with each alternative
                before = tuple(np.repeat(part, members.copies, axis=0) for part in before)
            ratio = Ratio.of(later, (before[0], before[1]))
            at = own, np.broadcast_to(self.run, own.shape)
            mean, cov = ratio.at(at).taken(mean, cov)
            mean, turn = mean - turned[at], turn + turned[at]
            before = components_last(stage.mean, 1), components_last(stage.cov, 2)
        self.turns.append(turn)
        return mean, cov

    def drawn(self, rng: np.random.Generator) -> Array:
        """A trajectory of each path, (T + 1, draws, runs, n)."""
        mean, cov = self.last
        found = np.empty((len(self.turns), *mean.shape))

        def off(cov: Array) -> Array:
            return apply(roots.root(cov), rng.standard_normal(cov.shape[:-1]))

        found[-1] = mean + off(cov)
        for step in range(len(self.back) - 1, -1, -1):
            each = self.back[step]
            after = found[step + 1] + self.turns[step + 1]
            own = apply(each.matrix, after) + each.offset + off(each.cov)
            found[step] = own + self.sources[step]
        return found


def _predicted(kept: Kept) -> tuple[Array, Array]:
    """The moments of a step's pairs as they were predicted, (K, S, runs, ...)."""
    return components_last(kept.pairs.mean, 1), components_last(kept.pairs.cov, 2)
