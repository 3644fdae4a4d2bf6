"""The particles of all runs at one step, and the blocks in which they are worked on.

A particle's *place* is its index along the last axis of a cloud's arrays. This axis has the
particles of all runs, those of run 0 first.
"""

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
    """Particles that are worked on together: whole runs, or a part of one run.

    first, last: The particles' places are `first` to `last` − 1.
    runs: The numbers of the runs that the particles are of.
    """

    first: int
    last: int
    runs: range

    def __len__(self) -> int:
        return self.last - self.first


@dataclass(frozen=True, eq=False)
class Cloud:
    """The particles of all runs at one step, one run after another.

    states: The components of the slice's variables, (d, particles).
    log_weights: The logarithms of weights that sum to one in each run, (particles,).
    starts: The place at which each run begins, and the end, (runs + 1,).
    ancestors: The place of each particle's ancestor in the cloud of the step before, (particles,).
        None if each ancestor has the same place as its particle, or ancestors are not kept, as at
        step 0 and after an injection.
    averages: The logarithms of the long-term and short-term averages of the measurements'
        likelihood, by which an `Injection` replaces particles, (2, runs); None without an
        `Injection`, or before the first measurements.
    """

    states: npt.NDArray[Any]
    log_weights: Array
    starts: Integers
    ancestors: Integers | None = None
    averages: Array | None = None

    @property
    def runs(self) -> int:
        """How many runs the cloud has particles of."""
        return len(self.starts) - 1

    @cached_property
    def counts(self) -> Integers:
        """The number of particles of each run, (runs,)."""
        return np.diff(self.starts)

    @cached_property
    def weights(self) -> Array:
        """The weights, (particles,), of sum one in each run."""
        found: Array = np.exp(self.log_weights)
        found.flags.writeable = False
        return found

    @cached_property
    def owner(self) -> Integers:
        """The run of each particle, (particles,)."""
        return np.repeat(np.arange(self.runs), self.counts)

    def of(self, run: int) -> slice:
        """The slice of a run's particles in an array over the particles of all runs."""
        return slice(int(self.starts[run]), int(self.starts[run + 1]))

    def summed(self, values: npt.NDArray[Any]) -> Array:
        """The sums of values (..., particles) over the particles of each run, (..., runs)."""
        return np.add.reduceat(values, self.starts[:-1], axis=-1, dtype=np.float64)

    def spread(self, values: npt.NDArray[Any]) -> npt.NDArray[Any]:
        """Values (runs,) repeated for each run's particles, (particles,).

        If there is a single run, its value (1,) is returned as it is, to be broadcast.
        """
        return values if self.runs == 1 else np.repeat(values, self.counts)

    def normalised(self, log_weights: Array) -> tuple[Cloud, Array]:
        """The cloud with other weights, normalised in each run, and the logarithms of their sums.

        log_weights: The logarithms of the weights, (particles,), not yet normalised. The second
            result, (runs,), is the logarithm of their sum in each run.
        """
        log_total = self.log_total(log_weights)
        return self.weighed(log_weights - self.spread(log_total)), log_total

    def log_total(self, log_weights: Array) -> Array:
        """The logarithm of the sum of each run's weights, (runs,), from logarithms (particles,)."""
        largest = np.maximum.reduceat(log_weights, self.starts[:-1])
        about = np.where(np.isneginf(largest), 0.0, largest)
        each = log_weights - self.spread(about)
        with np.errstate(divide="ignore"):  # a sum of zero
            found: Array = about + np.log(self.summed(np.exp(each, out=each)))
        return found

    @cached_property
    def effective(self) -> Array:
        """The effective number of particles, 1 / Σ w², (runs,)."""
        found: Array = 1.0 / self.summed(self.weights * self.weights)
        return found

    def weighed(self, log_weights: Array) -> Cloud:
        """The same particles with other log-weights, (particles,)."""
        return replace(self, log_weights=log_weights)

    def known(self, log_weights: Array, weights: Array, effective: Array) -> Cloud:
        """The same particles with other log-weights, whose weights and effective number are known.

        log_weights, weights: (particles,), normalised.
        effective: (runs,).
        """
        found = self.weighed(log_weights)
        weights.flags.writeable = False
        found.__dict__.update(weights=weights, effective=effective)
        return found

    def blocks(self) -> Iterator[Block]:
        """Blocks of at most 2^14 particles: whole runs together, or parts of a longer one."""
        return blocks(self.starts)

    def run(self, run: int) -> Cloud:
        """The cloud of one run alone, without `averages`.

        Its `ancestors` are still places in the step before's cloud of all runs.
        """
        place = self.of(run)
        ancestors = None if self.ancestors is None else self.ancestors[place]
        starts = np.array([0, place.stop - place.start])
        return Cloud(self.states[:, place], self.log_weights[place], starts, ancestors)


def blocks(starts: Integers) -> Iterator[Block]:
    """Blocks of at most 2^14 particles: whole runs together, or parts of a longer one.

    starts: The place at which each run begins, and the end, (runs + 1,).
    """
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
    """The log-weights (particles,) of equally weighted particles, `counts` (runs,) in each run."""
    return np.repeat(-np.log(counts), counts)
