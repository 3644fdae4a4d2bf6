"""Rules that draw their points: Monte Carlo and quasi-Monte Carlo, keyed by seed, CPD and step.

Philox counts, so that each key has its own stretch of one stream wherever a call starts: one call
for many steps gives what many calls give.
"""

from __future__ import annotations

import zlib
from abc import abstractmethod
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from pgm.arguments import public
from pgm.boundary import is_whole
from pgm.errors import LinearisationError
from pgm.kernels.arrays import Array, Integers
from pgm.linearisers.points import Points
from pgm.linearisers.regression import StatisticalRegression
from pgm.resources import require_memory

Words = npt.NDArray[np.uint64]

# Of a coordinate, as of a uniform number: all that a float below one can hold.
_BITS = 53


def uniform(seed: int, name: str, step: int | Integers, size: int, fresh: bool) -> Array:
    """Uniform numbers in [0, 1), (*axes of step, size).

    Equal steps have equal numbers unless `fresh`.
    """
    key = [int(seed), zlib.crc32(name.encode())]
    stretch = -(-size // 4)  # Philox makes four numbers a count

    def draw(counter: int, rows: int) -> Array:
        bits = np.random.Philox(key=key, counter=counter)
        numbers: Array = np.random.Generator(bits).random((rows, 4 * stretch))
        return numbers[:, :size]

    where = np.asarray(step)
    steps, inverse, counts = np.unique(where, return_inverse=True, return_counts=True)
    if not fresh:
        first = int(steps[0])
        drawn = draw(first * stretch, int(steps[-1]) - first + 1)
        return np.asarray(drawn[(steps - first)[inverse.reshape(where.shape)]])
    # Streams of steps lie 2⁶⁴ counts apart, all of them beyond those that runs share. Runs are the
    # last axis and are served one after another, so that more of them change none before.
    streams = [draw((int(s) + 1) << 64, int(n)) for s, n in zip(steps, counts, strict=True)]
    numbers = np.empty((where.size, size))
    by_step = np.argsort(inverse.reshape(where.shape).T, axis=None, kind="stable")
    numbers[by_step] = np.concatenate(streams)
    return np.moveaxis(numbers.reshape(*where.shape[::-1], size), -1, 0).T


def normal(uniforms: Array) -> Array:
    """The standard normal quantile of numbers in [0, 1)."""
    from scipy.special import ndtri  # here, since it is half of the time that importing pgm takes

    quantile: Array = ndtri(np.maximum(uniforms, 2.0**-54))  # zero is none of N(0, 1)
    return quantile


def scrambled_net(uniforms: Array, samples: int, dimension: int) -> Array:
    """Scrambled Sobol points in [0, 1)ⁿ, (..., N, n).

    Each coordinate's binary digits are multiplied by a random lower triangular matrix with ones on
    its diagonal, then shifted by random digits, of `scrambling_size` uniforms. Every point is
    uniform, and the points together keep the balance of the net (Matoušek, On the L2-discrepancy
    for anchored boxes, 1998).
    """
    net = _sobol(samples, dimension)
    words = (uniforms * 2.0**_BITS).astype(np.uint64)
    words = words.reshape(*words.shape[:-1], 1, -1, dimension)
    points: Words = np.bitwise_xor(net, words[..., 0, :])
    for digit in range(words.shape[-2] - 1):
        place = np.uint64(_BITS - 1 - digit)
        below = words[..., digit + 1, :] >> np.uint64(digit + 1)
        points ^= ((net >> place) & np.uint64(1)) * below
    return np.asarray(points * 2.0**-_BITS, dtype=np.float64)


def scrambling_size(samples: int, dimension: int) -> int:
    """The number of uniform draws for a scrambling: a shift, and a matrix column for each digit."""
    return (1 + _digits(samples)) * dimension


def _digits(samples: int) -> int:
    return (int(samples) - 1).bit_length()


@lru_cache(maxsize=16)
def _sobol(samples: int, dimension: int) -> Words:
    from scipy.stats.qmc import Sobol  # here, since scipy.stats is slow to import

    net = Sobol(dimension, scramble=False).random_base2(_digits(samples))[:samples]
    return np.asarray(net * 2.0**_BITS).astype(np.uint64)


@dataclass(frozen=True)
class SampledRule(StatisticalRegression):
    """Random points for N(0, I) with equal weights, keyed by seed, CPD and step.

    At least 2n + 2 of them; a subclass gives `_sample`.
    """

    samples: int
    seed: int = 0

    def __post_init__(self) -> None:
        for what, value, least in (("samples", self.samples, 1), ("seed", self.seed, 0)):
            if not is_whole(value) or not least <= value < 2**63:
                raise LinearisationError(
                    f"{type(self).__name__}({what}={value!r}): {what} must be a whole number from "
                    f"{least} to 2⁶³ − 1"
                )

    def _check_switches(self, *names: str) -> None:
        for name in names:
            if not isinstance(value := getattr(self, name), bool | np.bool_):
                raise LinearisationError(
                    f"{type(self).__name__}({name}={value!r}): {name} is True or False"
                )

    @property
    def drawn(self) -> bool:
        """Yes; as of `StatisticalRegression`."""
        return True

    def is_semidefinite(self, dimension: int) -> bool:
        """Whether the moments are the sample's own: its weights are positive."""
        return not self.prior_moments

    def _require_memory(self, dimension: int, name: str, step: int | Integers | None) -> None:
        count = 1
        if isinstance(step, np.ndarray) and step.size:
            count = step.size if self.fresh_per_run else int(step.max() - step.min()) + 1
        require_memory(
            self.samples * dimension * count,
            f"{type(self).__name__}(samples={self.samples}): the points for the CPD of {name}"
            + (f" at {count} steps" if count > 1 else ""),
            "ask for fewer",
            error=LinearisationError,
        )

    @abstractmethod
    def _sample(self, dimension: int, name: str, step: int | Integers) -> Array:
        """The points, (*axes of step, N, n)."""

    def cancellation(self, dimension: int) -> float:
        """One: the weights are equal, and values are rounded as any; as of `StatisticalRegression`.

        Parameters
        ----------
        dimension : int
            Number of components, n.

        Returns
        -------
        float
        """
        return 1.0

    def points(self, dimension: int, name: str, step: int | Integers | None) -> Points:
        """The sample, (*axes of step, N, n); as of `StatisticalRegression`."""
        if self.samples < 2 * dimension + 2:
            raise LinearisationError(
                f"{type(self).__name__}(samples={self.samples}) is too few for the {dimension} "
                f"hidden components of the CPD of {name}: ask for {2 * dimension + 2} or more"
            )
        self._require_memory(dimension, name, step)
        weights = np.full(self.samples, 1.0 / self.samples)
        sample = self._sample(dimension, name, 0 if step is None else step)
        return Points(sample, weights, weights, False)


@public
@dataclass(frozen=True)
class MonteCarlo(SampledRule):
    """Random points, weights 1/N, regressed with the sample's own mean and covariance.

    Points are drawn once per seed, CPD and step and shared by all runs: a batch equals its single
    runs, and one call for many steps equals many calls.

    Parameters
    ----------
    samples : int
        N, at least 2n + 2: with n + 1 the line passes through every point, and nothing is left
        to tell how wrong it is.
    seed : int
        A whole number, not negative.
    prior_moments : bool
        Take μ and P from the belief instead of the sample: F = Σ_xyᵀ P⁻¹, b = μ_y − F μ, Σ_n =
        Σ_yy − F P Fᵀ. The line is then not exact even for a linear function, and Σ_n often is
        indefinite, though F P Fᵀ + Σ_n never is.
    fresh_per_run : bool
        Draw other points for each run, the same at each linearisation of a step. A batch then
        does not equal its single runs, but its first runs equal a smaller batch.
    antithetic : bool
        Draw pairs ±s, N even. What is odd about μ then leaves no error in the mean, and what is
        even none in F; but the mean of the even part sees N/2 points.

    Raises
    ------
    LinearisationError
        If an argument is not what it should be: when made; if N is below 2n + 2, or more than
        memory holds: when used.

    Examples
    --------
    >>> from pgm.examples import square, y
    >>> graph = pgm.compile(square)
    >>> pgm.infer(graph, {}, lineariser=pgm.MonteCarlo(1000, seed=1))[y].mean.round(2)
    array([10.])
    """

    prior_moments: bool = False
    fresh_per_run: bool = False
    antithetic: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        self._check_switches("prior_moments", "fresh_per_run", "antithetic")
        if self.antithetic and self.samples % 2:
            raise LinearisationError(
                f"MonteCarlo(samples={self.samples}, antithetic=True): antithetic points come in "
                "pairs; ask for an even number"
            )

    def _sample(self, dimension: int, name: str, step: int | Integers) -> Array:
        count = self.samples // 2 if self.antithetic else self.samples
        drawn = uniform(self.seed, name, step, count * dimension, self.fresh_per_run)
        half = normal(drawn).reshape(*drawn.shape[:-1], count, dimension)
        return np.concatenate([half, -half], axis=-2) if self.antithetic else half


@public
@dataclass(frozen=True)
class QuasiMonteCarlo(SampledRule):
    """Scrambled Sobol points through the normal quantile, regressed as a Monte Carlo sample.

    The points fill space evenly, so that for smooth functions of few components errors fall about
    as 1/N, where those of random points fall as 1/√N. Each seed, CPD and step has a scrambling of
    its own, shared by all runs: a batch equals its single runs, and one call for many steps equals
    many calls.

    Parameters
    ----------
    samples : int
        N, at least 2n + 2, best a power of two, which the balance of the points needs.
    seed : int
        A whole number, not negative.
    fresh_per_run : bool
        Scramble anew for each run, as `MonteCarlo` draws anew.

    Raises
    ------
    LinearisationError
        If an argument is not what it should be: when made; if N is below 2n + 2, or more than
        memory holds: when used.

    References
    ----------
    Owen, Scrambled net variance for integrals of smooth functions, 1997.

    Examples
    --------
    >>> from pgm.examples import square, y
    >>> graph = pgm.compile(square)
    >>> pgm.infer(graph, {}, lineariser=pgm.QuasiMonteCarlo(1024))[y].mean.round(2)
    array([10.])
    """

    fresh_per_run: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        self._check_switches("fresh_per_run")

    def _sample(self, dimension: int, name: str, step: int | Integers) -> Array:
        size = scrambling_size(self.samples, dimension)
        drawn = uniform(self.seed, name, step, size, self.fresh_per_run)
        return normal(scrambled_net(drawn, self.samples, dimension))
