"""The backward pass of a mixed chain: components given later evidence, from step to step.

The smoothed belief of a component is divided among the members that were merged into it
(`kernels.merging.split`). What the members have taken in within a step leaves the state as it is,
so the smoothed beliefs of one component's copies are joined to that of the component; and those of
pairs go back through the motion, reversed by Bayes' rule, to the components of the step before.
Arrays are as of the forward pass (`chain`), but hypotheses and runs come first: (K, runs, n) of
components.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from pgm.beliefs.hypotheses.chain import HypothesisChain
from pgm.beliefs.hypotheses.records import Stage
from pgm.beliefs.moments.steps.readings import Moments
from pgm.kernels.arrays import Array, components_last
from pgm.kernels.merging import joined, normalised, split
from pgm.kernels.moments import pushed_with
from pgm.kernels.semirings import log_sum


class Flow(NamedTuple):
    """Hypotheses given all evidence: log-weights (hypotheses, runs), and moments."""

    logs: Array
    mean: Array
    cov: Array


class TwoSlices(NamedTuple):
    """The pairs of a step, each with the slice before it, given all evidence: (K, S, runs).

    With Gaussians that were mixed beforehand there is one of each regime, (1, S, runs). The moments
    are of the earlier slice's components, then the later one's, (..., 2 n).
    """

    logs: Array
    mean: Array
    cov: Array

    @property
    def earlier(self) -> tuple[Array, Array]:
        """The moments of the earlier slice."""
        size = self.mean.shape[-1] // 2
        return self.mean[..., :size], self.cov[..., :size, :size]


class Visited(NamedTuple):
    """A step on the way back: its components, its last members, and its pairs with the step before.

    `two` is None at step 0.
    """

    step: int
    flow: Flow
    opened: Flow
    two: TwoSlices | None


class BackwardChain:
    """The backward pass over a forward pass that was kept."""

    def __init__(self, chain: HypothesisChain) -> None:
        self.chain = chain

    def last(self, step: int) -> Flow:
        """The components of a step whose belief knows no later evidence."""
        known = self.chain.kept[step].known
        return Flow(known.shares, components_last(known.mean, 1), components_last(known.cov, 2))

    def opened(self, step: int, flow: Flow) -> Flow:
        """The members of a step's last stage, by its components."""
        return self._split(self.chain.kept[step].stages[-1], flow)

    def back(self, step: int, later: Flow) -> Flow:
        """A step's components, by the last members of the step after."""
        return self.before(step + 1, self.two(step + 1, later))

    def members(self, step: int, last: Flow) -> list[Flow]:
        """The members of each stage of a step, from the last one back, by the last ones."""
        stages, found = self.chain.kept[step].stages, [last]
        for before, stage in zip(stages[-2::-1], stages[:0:-1], strict=True):
            found.append(self._split(before, self._joined(found[-1], stage.members.copies)))
        return found

    def two(self, step: int, last: Flow) -> TwoSlices:
        """The pairs of a step with the slice before, by the step's last members."""
        kept = self.chain.kept[step]
        last = self.members(step, last)[-1]
        logs = last.logs.reshape(-1, self.chain.regimes.size, self.chain.runs)
        mean = last.mean.reshape(*logs.shape, -1)
        cov = last.cov.reshape(*logs.shape, mean.shape[-1], -1)
        reverse = self.chain.reversed(step, kept.pairs, self.moved(step))
        return TwoSlices(logs, *pushed_with(mean, cov, reverse))

    def moved(self, step: int) -> Moments:
        """The Gaussians predicted to a step: the components before it, or their mixtures."""
        mixed, known = self.chain.kept[step].pairs.mixed, self.chain.kept[step - 1].known
        if mixed is not None:
            return Moments(mixed.mean, mixed.whole)
        return Moments(known.mean[:, :, None], known.cov[:, :, :, None])

    def before(self, step: int, two: TwoSlices) -> Flow:
        """The components of the step before, by a step's pairs with the slice before."""
        return _of_copies(*self.unmixed(step, two))

    def unmixed(self, step: int, two: TwoSlices) -> Flow:
        """The components of the step before in each regime of a step, (K, S, runs)."""
        mixed = self.chain.kept[step].pairs.mixed
        if mixed is None:
            return Flow(two.logs, *two.earlier)
        found = split(
            two.earlier,
            (components_last(mixed.mean, 1), components_last(mixed.whole, 2)),
            np.zeros(mixed.logs.shape, dtype=np.intp),
            mixed.logs,
            (components_last(mixed.members, 1), components_last(mixed.cov, 2)),
        )
        turned = components_last(mixed.turned, 1)
        return Flow(found.logs + two.logs, found.mean + turned, found.cov)

    def regimes(self, step: int, opened: Flow) -> Array:
        """The log-probabilities of regimes, by the members of a step's last stage, (S, runs)."""
        stage = self.chain.kept[step].stages[-1]
        return self.chain.by_regime(opened.logs, stage.members)

    def walk(self, steps: int) -> Iterator[Visited]:
        """All steps from the last one back, given all evidence."""
        flow = self.last(steps)
        for step in range(steps, -1, -1):
            opened = self.opened(step, flow)
            two = self.two(step, opened) if step else None
            yield Visited(step, flow, opened, two)
            if two is not None:
                flow = self.before(step, two)

    def by_memory(self, step: int, two: TwoSlices) -> Array:
        """Ln p(memory before a step, regime at it), (memories, S, runs), by pairs."""
        regimes, logs = self.chain.regimes, self.unmixed(step, two).logs
        found = np.full((regimes.memories, *logs.shape[1:]), -np.inf)
        each = np.arange(logs.shape[-1])
        for own, weights in zip(self.chain.kept[step - 1].known.memory, logs, strict=True):
            found[own, :, each] = np.logaddexp(found[own, :, each], weights.T)
        flat = found.reshape(-1, logs.shape[-1])
        return normalised(flat)[0].reshape(found.shape)

    def _split(self, stage: Stage, flow: Flow) -> Flow:
        """The members of a stage, by its components."""
        members = stage.members
        found = split(
            (flow.mean, flow.cov),
            (components_last(stage.mean, 1), components_last(stage.cov, 2)),
            stage.owner,
            stage.logs,
            (components_last(stage.moved, 1), components_last(members.cov, 2)),
        )
        logs = found.logs + np.take_along_axis(flow.logs, stage.owner, axis=0)
        return Flow(logs, found.mean + components_last(stage.turned, 1), found.cov)

    def _joined(self, flow: Flow, copies: int) -> Flow:
        """Components, by the copies of each."""
        logs = flow.logs.reshape(-1, copies, self.chain.runs)
        size = flow.mean.shape[-1]
        return _of_copies(
            logs, flow.mean.reshape(*logs.shape, size), flow.cov.reshape(*logs.shape, size, size)
        )


def _of_copies(logs: Array, mean: Array, cov: Array) -> Flow:
    """Components by their copies, (components, copies, runs, ...)."""
    total = log_sum(logs, 1)
    shares = np.exp(logs - np.where(total > -np.inf, total, 0.0)[:, None])
    dead = total == -np.inf
    if dead.any():
        shares = np.where(dead[:, None], 1.0 / shares.shape[1], shares)
    return Flow(total, *joined(shares, mean, cov))
