"""The particles of all runs at one step, and the streams of random numbers that draw them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from pgm.kernels.arrays import Array, Integers

# Particles that are worked on at a time: their arrays stay in a core's cache.
BLOCK = 2**14


class Block(NamedTuple):
    """Particles that are worked on together: whole runs, or a part of one run."""

    first: int
    last: int
    runs: range

    def __len__(self) -> int:
        return self.last - self.first


@dataclass(frozen=True, eq=False)
class Cloud:
    """The particles of all runs at one step, one run after another.

    states: (d, particles): the components of the slice's variables.
    log_weights: (particles,): normalised in each run.
    starts: (runs + 1,): where each run begins, and the end.
    ancestors: (particles,): the place of each particle's parent, a step before.
    averages: (2, runs): long-term and short-term averages, of an `Injection`.
    """

    states: npt.NDArray[Any]
    log_weights: Array
    starts: Integers
    ancestors: Integers | None = None
    averages: Array | None = None

    @property
    def runs(self) -> int:
        """Number of runs."""
        return len(self.starts) - 1

    @cached_property
    def counts(self) -> Integers:
        """The number of particles of each run."""
        return np.diff(self.starts)

    @cached_property
    def weights(self) -> Array:
        """The weights, (particles,), of sum one in each run."""
        found: Array = np.exp(self.log_weights)
        found.flags.writeable = False
        return found

    @cached_property
    def owner(self) -> Integers:
        """The run of each particle."""
        return np.repeat(np.arange(self.runs), self.counts)

    def of(self, run: int) -> slice:
        """The place of a run's particles."""
        return slice(int(self.starts[run]), int(self.starts[run + 1]))

    def summed(self, values: npt.NDArray[Any]) -> Array:
        """The sums of (..., particles) over the particles of each run, (..., runs)."""
        return np.add.reduceat(values, self.starts[:-1], axis=-1, dtype=np.float64)

    def spread(self, values: npt.NDArray[Any]) -> npt.NDArray[Any]:
        """The values of runs, (runs,), at their particles, to which they broadcast."""
        return values if self.runs == 1 else np.repeat(values, self.counts)

    def normalised(self, log_weights: Array) -> tuple[Cloud, Array]:
        """The cloud with weights that sum to one in each run, and the log of their former sum."""
        largest = np.maximum.reduceat(log_weights, self.starts[:-1])
        each = log_weights - self.spread(largest)
        log_total = largest + np.log(self.summed(np.exp(each, out=each)))
        return self.weighed(log_weights - self.spread(log_total)), log_total

    @cached_property
    def effective(self) -> Array:
        """The effective number of particles, 1 / Σ w², (runs,)."""
        found: Array = 1.0 / self.summed(self.weights * self.weights)
        return found

    def weighed(self, log_weights: Array) -> Cloud:
        """The same particles with new log-weights."""
        return replace(self, log_weights=log_weights)

    def blocks(self) -> Iterator[Block]:
        """The particles by blocks, each run's cut as if it were alone."""
        return blocks(self.starts)

    def run(self, run: int) -> Cloud:
        """The particles of one run."""
        place = self.of(run)
        ancestors = None if self.ancestors is None else self.ancestors[place]
        starts = np.array([0, place.stop - place.start])
        return Cloud(self.states[:, place], self.log_weights[place], starts, ancestors)


def blocks(starts: Integers) -> Iterator[Block]:
    """Blocks of particles, whole runs together or a long one cut."""
    edges = starts.tolist()
    run = 0
    while run + 1 < len(edges):
        end = run + 1
        if edges[end] - edges[run] > BLOCK:
            for first in range(edges[run], edges[end], BLOCK):
                yield Block(first, min(first + BLOCK, edges[end]), range(run, end))
        else:
            while end + 1 < len(edges) and edges[end + 1] - edges[run] <= BLOCK:
                end += 1
            yield Block(edges[run], edges[end], range(run, end))
        run = end


def uniform(counts: Integers) -> Array:
    """The log-weights of particles that all weigh the same in their run."""
    return np.repeat(-np.log(counts), counts)


# The purposes of streams, which are independent of each other.
FORWARD, RESTARTED, BACKWARD, STARTED, INJECTED = range(5)


def stream(seed: int, run: int, step: int, purpose: int = FORWARD) -> np.random.Generator:
    """The generator of a run's draws at a step."""
    key = np.random.SeedSequence(seed, spawn_key=(run, step, purpose))
    return np.random.Generator(np.random.SFC64(key))
