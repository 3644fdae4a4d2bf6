"""Importance draws in batches of bounded size, and the estimates made from them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Protocol

import numpy as np

from pgm.inference.audit.corrected import Compared, Sums
from pgm.inference.audit.draws import Draws
from pgm.inference.audit.mixture import Mixture, weigh
from pgm.kernels.arrays import quiet
from pgm.progress import counted

# Numbers drawn at once: what stays near the processor, and what whole draws may take.
BATCH, ROOM = 2**18, 2**24


class Drawing(Protocol):
    """The source of draws: a chain, or a tree."""

    @property
    def width(self) -> int:
        """Floats that one draw of one run occupies at a time."""

    @property
    def length(self) -> int:
        """Numbers of a whole draw."""

    def draw(self, count: int, rng: np.random.Generator, *, defensive: bool) -> Draws:
        """Draw a number of new trajectories for each run."""

    def sums(self) -> list[Sums]:
        """Empty sums, one a hidden variable and one a cluster of several."""


def estimate(
    drawing: Drawing, runs: int, samples: int, rng: np.random.Generator
) -> tuple[Mixture, list[Compared]]:
    """Draw so often from the Gaussian, and as often defensively, and sum up, batch by batch."""
    size = max(
        1, min(BATCH // max(drawing.width, 1), ROOM // max(drawing.length, 1)) // max(runs, 1)
    )
    shape = (runs, 2 * samples)
    log_weights, control, log_ratio = np.empty(shape), np.empty(shape), np.empty(shape)
    lost, peak = np.zeros(runs), np.full(runs, -np.inf)
    sums = drawing.sums()
    for part, defensive in counted(list(_parts(samples, size)), "batches of draws"):
        with quiet():  # a residual too large to be squared has no weight
            drawn = drawing.draw(part.stop - part.start, rng, defensive=defensive)
            logs, share = weigh(drawn)
        log_weights[:, part], control[:, part] = logs, share
        log_ratio[:, part] = drawn.target - drawn.gaussian
        lost += np.isnan(drawn.target).sum(axis=-1)
        before, peak = peak, np.maximum(peak, logs.max(axis=-1))
        level = np.where(np.isfinite(peak), peak, 0.0)
        fading = np.exp(np.where(np.isfinite(before), before - level, 0.0))
        pair = np.stack([np.exp(logs - level[:, None]), share])
        for each in sums:
            each.add(drawn.values, pair, fading)
    mixture = Mixture.make(log_weights, control, log_ratio, lost / samples)
    return mixture, [each.compared(mixture) for each in sums]


def _parts(samples: int, size: int) -> Iterator[tuple[slice, bool]]:
    """The places of batches among 2S draws, and whether these are the defensive ones."""
    for defensive in (False, True):
        for first in range(0, samples, size):
            last = min(first + size, samples)
            yield slice(first + defensive * samples, last + defensive * samples), defensive
