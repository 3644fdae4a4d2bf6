"""Importance draws in batches of bounded size, and the estimates made from them.

For each run, S draws are made from the Gaussian answer q, and S from a *defensive* density d with
wider tails. A draw has a value of every hidden variable; that of a chain is made slice by slice.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Protocol

import numpy as np

from pgm.inference.audit.compared import Compared
from pgm.inference.audit.corrected import Sums
from pgm.inference.audit.draws import Draws
from pgm.inference.audit.mixture import Mixture, weigh
from pgm.inference.audit.states import StateSums
from pgm.kernels.arrays import quiet
from pgm.progress import counted

# The floats of a batch at the most: of the part of its draws that is made at a time, which is to
# stay in cache, and of its whole draws.
BATCH, ROOM = 2**18, 2**24


class Drawing(Protocol):
    """The source of draws from q and d: `ChainDraws`, `TreeDraws`, or `SwitchingDraws`."""

    @property
    def width(self) -> int:
        """The number of floats that a draw of one run takes while it is made.

        Of a chain, which is drawn slice by slice, it is that of one slice.
        """

    @property
    def length(self) -> int:
        """The number of floats of a whole draw of one run, of all slices."""

    def draw(self, count: int, rng: np.random.Generator, *, defensive: bool) -> Draws:
        """Make `count` draws for each run, from d if `defensive`, else from q.

        Returns their values, and their log-densities by the model, by q and by d.
        """

    def sums(self) -> Sequence[Sums | StateSums]:
        """Sums over draws, still empty, by which the moments of beliefs are estimated.

        There is one `Sums` for each belief that is compared with the Gaussian answer's: that of
        each hidden variable, and of each cluster of several variables.
        """


def estimate(
    drawing: Drawing, runs: int, samples: int, rng: np.random.Generator
) -> tuple[Mixture, list[Compared]]:
    """Make S = `samples` draws from q and S from d for each run, and the estimates from them.

    The first result has the estimates of the evidence and of divergences. The second has, for each
    hidden variable and each cluster of several, the estimated exact moments, and how far the
    Gaussian answer's belief is from them. A NumericalError is raised if in some run all draws, or
    all from q, have density zero.
    """
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
            log_ratio[:, part] = drawn.target - drawn.gaussian
        log_weights[:, part], control[:, part] = logs, share
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
    """Cut the 2S draws of a run, S = `samples`, into batches of at most `size` draws.

    Yields the place of each batch among the draws, and whether it is of draws from d. The S draws
    from q come first.
    """
    for defensive in (False, True):
        for first in range(0, samples, size):
            last = min(first + size, samples)
            yield slice(first + defensive * samples, last + defensive * samples), defensive
