"""Modes of one posterior, adapted by weighed draws of their own mixture.

The *law* of a mode is a Gaussian of all hidden variables: of the states at step 0, then of each
slice given the states before; a network without time is one slice. In each run S values x are drawn
from the mixture

    r(x) = Σ_k a_k q_k(x) + ε d(x)

of the K laws q_k and a *defensive* density d, the model's own CPDs of hidden variables with noise
of Student's t. They are weighed by p(x, z) / r(x), the exact density of the model as it was
declared. What a mode's share of the weighed draws has for moments at every two successive steps
makes its next law, and its share of the weights its next weight. That is done a few times.

The *pair* of a step is the vector of the m states of the step before, then of the slice's n
components; T is the last step. Arrays have the K modes first, then steps, then the runs.
"""

from __future__ import annotations

import warnings
from typing import NamedTuple, Protocol

import numpy as np

from pgm.beliefs.moments.trajectories.density import Afresh
from pgm.beliefs.moments.trajectories.model import Proposing, Weighed
from pgm.beliefs.moments.trajectories.proposal import Path
from pgm.errors import BeliefWarning, NumericalError, levels_to_user
from pgm.kernels.angles import difference, nearest_branch
from pgm.kernels.arrays import Array, Index, Integers, Mask, quiet, symmetric, transpose
from pgm.kernels.semirings import log_sum
from pgm.schedules.limits import require_runs

ROUNDS = 3
# The part of the draws that is defensive.
DEFENSIVE = 0.05
# Draws of fewer effective ones give a warning.
ENOUGH = 100.0
# With N effective draws of p components a law moves N / (N + 4 p) of the way to their moments.
_OWN = 4.0


class Laws(NamedTuple):
    """The laws of K modes by their moments.

    A network without time is a single slice of states, step 0.

    weights: (K, runs), of sum one; 0 of a mode that a run does not have.
    first, spread: The means (K, 1, runs, m) and covariances of the states at step 0.
    mean, cov: Those of the pairs at steps 1 to T, (K, T, runs, m + n).
    """

    weights: Array
    first: Array
    spread: Array
    mean: Array
    cov: Array


class Target(Protocol):
    """The posterior that draws are weighed by, of variables in slices.

    Attributes
    ----------
    before : int
        m, the number of components of the states before a slice.
    states : slice or ndarray of int
        The places of the states in a slice.
    turned : ndarray of bool
        (n,): the components of a slice that are angles of nonlinear motions.
    angles : ndarray of bool
        (m + n,): the angles of the states before and a slice.
    """

    before: int
    states: Index
    turned: Mask
    angles: Mask

    def path(self, laws: Laws, k: int) -> Path:
        """The law of a mode, as it is drawn from."""

    def draw(self, source: Proposing, shape: tuple[int, int]) -> Weighed:
        """Draws that a source proposes, (runs, S), NaN where a function has no value."""


class Adapted(NamedTuple):
    """The laws that the last draws adapt, and how many these are worth.

    log_evidence: ln of the mean weight of the last draws, (runs,).
    effective: The effective number of the last draws, (runs,).
    """

    laws: Laws
    log_evidence: Array
    effective: Array


@quiet()
def adapt(target: Target, laws: Laws, draws: int) -> Adapted:
    """The laws of modes, adapted by so many draws a run in each round.

    Raises
    ------
    NumericalError
        If a law has no density: of CPDs without noise beside exact measurements.
    GraphError
        If the draws would not fit in memory.
    """
    count, runs = laws.weights.shape
    if not all(target.path(laws, k).regular for k in range(count)):
        raise without_density()
    size = (laws.mean.shape[1] + 1) * (target.before + laws.mean.shape[-1])
    require_runs(draws * size, runs, f"draws={draws:,}, as many of all hidden variables a run,")
    rng = np.random.default_rng(0)
    for _ in range(ROUNDS):
        found = _round(target, laws, draws, rng)
        laws = found.laws
    return found


def without_density() -> NumericalError:
    """The error for a posterior that has no density."""
    return NumericalError(
        "draws= weighs values of all hidden variables by their density, and these have none, as "
        "where sensors without noise were read: leave draws out, or give the exact CPDs some noise"
    )


def warn_of_few(effective: Array, draws: int) -> None:
    """Warn of draws of which too few are effective, (runs,)."""
    least = float(effective.min(initial=ENOUGH))
    if least < ENOUGH:
        warnings.warn(
            f"draws={draws}: those of the last round are worth {least:.0f} equally weighted ones "
            "in the worst run (status.effective), too few to adapt modes by: give more draws, or "
            "fewer variables or steps, or leave draws out",
            BeliefWarning,
            stacklevel=levels_to_user(),
        )


class _Source:
    """Draws of the mixture: each of a mode, or of the model alone; and their densities in each.

    kinds : ndarray
        (runs, S): the mode of each draw; K are defensive draws.
    by_mode, defensive : ndarray
        (K, runs, S) and (runs, S): ln q_k and ln d.
    """

    def __init__(
        self, target: Target, laws: Laws, kinds: Integers, rng: np.random.Generator
    ) -> None:
        self.paths = [target.path(laws, k) for k in range(len(laws.weights))]
        self.kinds, self._rng = kinds, rng
        self._means, self._turned = laws.mean, target.turned if target.turned.any() else None
        self._places = target.states
        self.by_mode = np.zeros((len(self.paths), *kinds.shape))
        self.defensive = np.zeros(kinds.shape)
        self._index = 0

    def propose(self, given: Array) -> tuple[Array, Afresh]:
        """Draw the next slice given the states before; see `Proposing`."""
        proposal, row = self.paths[0].at(self._index)
        white = proposal.white(row, self.kinds.shape[1], self._rng)
        values = proposal.values(row, self._near(0, given), white)
        for k, path in enumerate(self.paths[1:], 1):
            own, place = path.at(self._index)
            here = (self.kinds == k)[..., None]
            values = np.where(here, own.values(place, self._near(k, given), white), values)
        return values, Afresh(self.kinds == len(self.paths), self._rng)

    def _near(self, k: int, given: Array) -> Array:
        """The states before, their angles on the branch of a mode, whose F knows no turns."""
        if self._turned is None or self._index < 2:
            return given
        mean = self._means[k, self._index - 1][:, None, : given.shape[-1]]
        return nearest_branch(given, mean, self._turned[self._places])

    def weigh(self, given: Array, values: Array, predicted: Array) -> None:
        """Add the densities of a slice; see `Proposing`."""
        for k, path in enumerate(self.paths):
            own, place = path.at(self._index)
            turned = self._turned if self._index else None
            white = own.whitened(place, self._near(k, given), values, turned)
            self.by_mode[k] += own.log_density(place, np.einsum("rsi,rsi->rs", white, white))
        self.defensive += predicted
        self._index += 1


def _round(target: Target, laws: Laws, draws: int, rng: np.random.Generator) -> Adapted:
    """One round: S draws of each run, and the laws that their weights make of them."""
    runs = laws.weights.shape[1]
    alive = laws.weights > 0.0
    # A mode has half its weight and half an equal share, so that none is starved.
    shares = (1.0 - DEFENSIVE) * 0.5 * (laws.weights + alive / alive.sum(axis=0))
    ends = np.cumsum(shares, axis=0)
    places = (np.arange(draws) + 0.5) / draws
    kinds = (ends[..., None] <= places).sum(axis=0)
    source = _Source(target, laws, kinds, rng)
    drawn = target.draw(source, (runs, draws))
    with np.errstate(divide="ignore"):  # a mode that a run has not
        parts = np.log(shares)[..., None] + source.by_mode
    modes = log_sum(parts, 0)
    ratio = drawn.log_density - np.logaddexp(modes, np.log(DEFENSIVE) + source.defensive)
    ratio = np.where(np.isnan(ratio) | (modes == -np.inf), -np.inf, ratio)
    total = log_sum(ratio, 1)
    if not (total > -np.inf).all():
        raise NumericalError(
            "no draw of draws= has a density under the model that float64 can hold; are its units "
            "and noises of a size that fits the data?"
        )
    mass = np.exp(parts - modes + ratio - total[:, None])  # by mode, of sum one over all
    mass = np.where(ratio > -np.inf, mass, 0.0)
    m, angles = target.before, target.angles
    values = np.stack(drawn.values)
    start = values[:1][..., m:][..., target.states]
    first = _moments(mass, start, laws.first, laws.spread, angles[m:][target.states])
    later = _moments(mass, values[1:], laws.mean, laws.cov, angles)
    weights = mass.sum(axis=-1)
    whole = np.exp(ratio - total[:, None])
    effective = 1.0 / (whole * whole).sum(axis=-1)
    return Adapted(Laws(weights, *first, *later), total - np.log(draws), effective)


def _moments(
    mass: Array, values: Array, mean: Array, cov: Array, angles: Mask
) -> tuple[Array, Array]:
    """The moments of weighed draws (steps, runs, S, p) in each mode, from what its law had.

    `mass` are the weights by mode, (K, runs, S). With N the effective number of a mode's draws, p
    that of components and λ = N / (N + 4 p), the law moves by λ of the way to the draws' moments.
    """
    found_mean, found_cov = mean.copy(), cov.copy()
    for k, own in enumerate(mass):
        total = own.sum(axis=-1)
        some = total > 0.0
        share = own / np.where(some, total, 1.0)[:, None]
        count = np.where(some, 1.0 / np.maximum((share * share).sum(axis=-1), 1e-300), 0.0)
        part = count / (count + _OWN * values.shape[-1])
        off = difference(values, mean[k][..., None, :], angles)
        shift = (share[:, None, :] @ off)[..., 0, :]
        about = off - shift[..., None, :]
        spread = transpose(about * share[..., None]) @ about
        found_mean[k] += part[:, None] * shift
        found_cov[k] += part[:, None, None] * (symmetric(spread) - cov[k])
    return found_mean, found_cov
