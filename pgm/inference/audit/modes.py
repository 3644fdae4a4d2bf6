"""Other modes of a posterior: fixed points that smoothers reach from other starts.

Smoothers (of a network without time: calibrations) are started from C points in each run. The
audit draws from the Gaussian answer q and, *defensively*, from a density with wider tails. Each of
up to K modes found gets a share of the defensive draws; the rest of these follow q but for an
*excursion*, some slices at which they leave it. A slice is a step of a chain, or all variables of a
network without time. n is the number of the components of all slices together.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from pgm.beliefs.moments.trajectories.proposal import Path
from pgm.errors import NumericalError
from pgm.kernels.angles import difference
from pgm.kernels.arrays import Array, Integers, Mask

# The largest number of modes that are drawn from, beside the answer's.
MOST = 8
# Fixed points are two modes if some component differs by more standard deviations.
APART = 1.0
# Nats of log-evidence below the best fixed point from which on one has no mass that counts.
NEGLIGIBLE = 10.0
# The part of defensive draws that other modes get, and the part of these that all get alike.
SHARE, EVEN = 0.5, 0.2


@dataclass(frozen=True, eq=False)
class Modes:
    """Gaussians at other modes than the answer's, from which a part of defensive draws comes.

    paths : sequence of Path
        K Gaussian laws of all variables, one for each mode, each of all runs.
    shares : ndarray
        (K, runs): the probability that a defensive draw is from the law; zero in runs that do not
        have the mode.
    missed : ndarray
        (runs,): the part of the fixed points' evidence that belongs to modes not drawn from; NaN
        where no smoother arrived, not even from the answer itself, or there was nowhere to start.
    reason : str
        Why it is NaN.
    """

    paths: Sequence[Path]
    shares: Array
    missed: Array
    reason: str = "no smoother arrived at one"

    @classmethod
    def none(cls, runs: int) -> Modes:
        """The `Modes` of runs that have no mode but the answer's."""
        return cls((), np.zeros((0, runs)), np.zeros(runs))

    @classmethod
    def unknown(cls, runs: int) -> Modes:
        """The `Modes` of runs in which the search has failed: none to draw from, `missed` NaN."""
        return cls((), np.zeros((0, runs)), np.full(runs, np.nan))

    def unsearched(self, reason: str) -> Modes:
        """The modes that were found, where others were not looked for, for the reason given."""
        return replace(self, missed=np.full(len(self.missed), np.nan), reason=reason)

    @classmethod
    def made(cls, laws: Iterable[tuple[Callable[[], Path], Array]], missed: Array) -> Modes:
        """The modes whose laws can be made and drawn from.

        laws: For each mode, a function that makes its law, and its share of the defensive draws in
            each run, (runs,).
        missed: The part of all modes' evidence that belongs to modes left out already, (runs,).

        A law that cannot be made, or has no density, is left out. Its share, as a part of the
        shares of all modes together, is added to `missed`.
        """
        paths, shares = [], []
        for make, share in laws:
            try:
                path = make()
            except NumericalError:
                path = None
            if path is None or not path.regular:
                missed = missed + share / SHARE
                continue
            paths.append(path)
            shares.append(share)
        return cls(paths, np.array(shares).reshape(len(paths), len(missed)), missed)

    def drawn(self, count: int, rng: np.random.Generator) -> Integers:
        """Draw which mode each of S = `count` defensive draws is from, (runs, S).

        It is a number from 0 to K − 1, or K for a draw that follows q but for an excursion.
        """
        runs = self.shares.shape[1]
        if not self.paths:
            return np.zeros((runs, count), dtype=np.intp)
        chance, below = rng.random((runs, count)), np.cumsum(self.shares, axis=0)
        return np.asarray((chance >= below[..., None]).sum(axis=0))


@dataclass(frozen=True, eq=False)
class FixedPoints:
    """The C fixed points that smoothers reached in each run, the first from the answer itself.

    mean, std : ndarray
        (C, runs, n): the means and standard deviations of all components of all slices.
    log_evidence : ndarray
        (C, runs): the log-evidence of the model linearised at the point, Laplace's approximation of
        the logarithm of the mode's mass; −∞ where a smoother has failed.
    angles : ndarray
        (n,): the mask of components that are angles; whole turns are no difference.
    """

    mean: Array
    std: Array
    log_evidence: Array
    angles: Mask

    def apart(self, mean: Array, std: Array) -> Array:
        """How far each fixed point is from another point of its run, (C, runs).

        The other point has the means `mean` and the standard deviations `std`, both (runs, n). The
        distance is the largest difference of a component's means, in units of the root mean square
        of its two standard deviations. Components for which both are zero count for nothing.
        """
        off = np.abs(difference(self.mean, mean, self.angles))
        spread = np.sqrt(0.5 * (self.std**2 + std**2))
        apart = np.where(spread > 0.0, off / np.where(spread > 0.0, spread, 1.0), 0.0)
        return np.asarray(apart.max(axis=-1, initial=0.0))


@dataclass(frozen=True, eq=False)
class Chosen:
    """The distinct modes among fixed points.

    index : ndarray
        (K, runs): which fixed point each mode is; −1 where a run has fewer.
    shares : ndarray
        (K, runs): the probability that a defensive draw is from the mode; zero where a run has
        fewer modes.
    missed : ndarray
        (runs,): the part of all modes' evidence that belongs to modes beyond these K; NaN where no
        smoother arrived.
    """

    index: Integers
    shares: Array
    missed: Array


def choose(points: FixedPoints, mean: Array, std: Array, most: int = MOST) -> Chosen:
    """The likeliest distinct fixed points that are not the answer's mode.

    Points are taken in the order of their evidence. Each has to be further than one standard
    deviation, in some component, from the answer and from those taken before. Points with a
    log-evidence ten nats or more below the best are left out. By Laplace's method, the mass w_k of
    the mode at point k is proportional to the evidence Z_k there. With the masses normalised over
    the K modes that are drawn from, the shares of the defensive draws are 0.5 (0.8 w_k + 0.2/K).

    Parameters
    ----------
    points : FixedPoints
        The fixed points that the smoothers reached.
    mean, std : ndarray
        (runs, n): the answer's means and standard deviations.
    most : int
        The largest number K of modes.
    """
    runs = points.log_evidence.shape[1]
    every = np.arange(runs)
    best = points.log_evidence.max(axis=0, initial=-np.inf)
    level = np.where(np.isfinite(best), best, 0.0)
    weight = np.exp(points.log_evidence - level)
    own = points.apart(mean, std) <= APART
    total = np.where(own, weight, 0.0).max(axis=0)  # the answer's mode, as far as it was found
    open_ = ~own & (points.log_evidence > level - NEGLIGIBLE)
    index: list[Integers] = []
    weights: list[Array] = []
    missed = np.zeros(runs)
    while open_.any():
        next_ = np.where(open_, points.log_evidence, -np.inf).argmax(axis=0)
        there = open_[next_, every]
        mass = np.where(there, weight[next_, every], 0.0)
        if len(index) < most:
            index.append(np.where(there, next_, -1))
            weights.append(mass)
        else:
            missed += mass
        total += mass
        near = points.apart(points.mean[next_, every], points.std[next_, every]) <= APART
        open_ &= ~(near & there)
        open_[next_, every] = False
    total = np.where(total > 0.0, total, 1.0)
    missed = np.where(np.isfinite(best), missed / total, np.nan)
    if not index:
        return Chosen(np.zeros((0, runs), dtype=np.intp), np.zeros((0, runs)), missed)
    found, mass = np.array(index), np.array(weights)
    there = found >= 0
    count, sum_ = np.maximum(there.sum(axis=0), 1), mass.sum(axis=0)
    part = (1.0 - EVEN) * mass / np.where(sum_ > 0.0, sum_, 1.0) + EVEN * there / count
    return Chosen(found, SHARE * part, missed)
