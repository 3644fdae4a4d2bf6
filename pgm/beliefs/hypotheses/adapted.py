"""Modes of one posterior, adapted by weighed draws of their own mixture.

The *law* of a mode is a Gaussian of trajectories: of the states at step 0, then of each slice given
the states before. In each run S trajectories x are drawn from the mixture

    r(x) = Σ_k a_k q_k(x) + ε d(x)

of the K laws q_k and a *defensive* density d, the model's prior and motion alone with noise of
Student's t. They are weighed by p(x, z) / r(x), the exact density of the model as it was declared.
What a mode's share of the weighed draws has for moments at every two successive steps makes its
next law, and its share of the weights its next weight. That is done a few times.

The *pair* of a step is the vector of the m states of the step before, then of the slice's n
components; T is the last step. Arrays have the K modes first, then steps, then the runs.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from pgm.beliefs.moments.outcomes.marginals import Marginals
from pgm.beliefs.moments.outcomes.outcome import ChainOutcome
from pgm.beliefs.moments.passes.backward import Beliefs, Reverse
from pgm.beliefs.moments.passes.joints import joint_moments
from pgm.beliefs.moments.trajectories.density import Afresh, has_exact
from pgm.beliefs.moments.trajectories.law import ChainLaw
from pgm.beliefs.moments.trajectories.model import ChainModel
from pgm.beliefs.moments.trajectories.proposal import Path
from pgm.compile import SliceLayout
from pgm.errors import NumericalError
from pgm.factors import Gaussian
from pgm.factors.scope import angle_mask
from pgm.kernels.angles import difference, nearest_branch
from pgm.kernels.arrays import (
    Array,
    Index,
    Integers,
    Mask,
    apply,
    block,
    quiet,
    sandwich,
    symmetric,
    transpose,
)
from pgm.kernels.moments import Conditional
from pgm.kernels.semirings import log_sum
from pgm.kernels.solving import regression
from pgm.posteriors.belief_kind import SMOOTHED
from pgm.posteriors.hidden import require_at_steps
from pgm.schedules.limits import require_runs
from pgm.variables import Variable

ROUNDS = 3
# The part of the draws that is defensive.
DEFENSIVE = 0.05
# With N effective draws of p components a law moves N / (N + 4 p) of the way to their moments.
_OWN = 4.0


class Laws(NamedTuple):
    """The laws of K modes by their moments.

    weights: (K, runs), of sum one; 0 of a mode that a run does not have.
    first, spread: The means (K, 1, runs, m) and covariances of the states at step 0.
    mean, cov: Those of the pairs at steps 1 to T, (K, T, runs, m + n).
    """

    weights: Array
    first: Array
    spread: Array
    mean: Array
    cov: Array

    def path(self, law: ChainLaw, k: int) -> Path:
        """The law of a mode, as it is drawn from."""
        m = law.layout.state_size
        later = _given(self.mean[k], self.cov[k], slice(m, None), slice(None, m))
        return law.path_of(self.first[k], self.spread[k], later)


class Adapted(NamedTuple):
    """The laws that the last draws adapt, and how many these are worth.

    log_evidence: ln of the mean weight of the last draws, (runs,).
    effective: The effective number of the last draws, (runs,).
    """

    laws: Laws
    log_evidence: Array
    effective: Array


@dataclass(frozen=True, eq=False)
class ModeBeliefs:
    """Beliefs of K modes, by moments of their laws: as an outcome with an axis of modes, then runs.

    beliefs : Beliefs
        Means (T+1, K · runs, n) and covariances of all slices.
    reverse : Reverse
        The laws reversed in time.
    """

    layout: SliceLayout
    lead: tuple[int, ...]
    beliefs: Beliefs
    reverse: Reverse

    @classmethod
    def make(cls, laws: Laws, layout: SliceLayout, lead: tuple[int, ...]) -> ModeBeliefs:
        """The beliefs of laws; `lead` are the axes of runs that users see."""
        m, n, places = layout.state_size, layout.slice_size, layout.state_places
        pairs, whole = (_merged(each) for each in (laws.mean, laws.cov))
        begin, spread = (_merged(each) for each in (laws.first, laws.spread))
        mean = np.zeros((len(pairs) + 1, pairs.shape[1], n))
        cov = np.zeros((*mean.shape, n))
        mean[1:], cov[1:] = pairs[..., m:], whole[..., m:, m:]
        mean[:1, :, places] = begin
        at = np.arange(n)[places]
        cov[:1, :, at[:, None], at] = spread
        states = _given(pairs, whole, slice(None, m), slice(m, None))
        slices = None if m == n else _given(mean, cov, slice(None), places)
        count = len(laws.weights)
        return cls(layout, (count, *lead), Beliefs(mean, cov), Reverse(states, slices))

    def __getitem__(self, variable: Variable) -> Gaussian:
        """The marginals of a variable in each mode, (K, *runs, ...)."""
        return Marginals(self.layout, self.beliefs, self.lead, SMOOTHED)[variable]

    def joint(self, *variables: Variable) -> Gaussian:
        """The joints of variables at steps in each mode, (K, *runs, ...)."""
        require_at_steps(self.layout, variables, len(self.beliefs.mean) - 1)
        mean, cov = joint_moments(self.reverse, self.beliefs, self.layout, variables)
        shape = self.lead
        return Gaussian._make(
            variables, mean.reshape(*shape, -1), cov.reshape(*shape, *cov.shape[1:])
        )


def _merged(values: Array) -> Array:
    """Arrays (K, steps, runs, ...) as (steps, K · runs, ...)."""
    count, steps, runs = values.shape[:3]
    return values.swapaxes(0, 1).reshape(steps, count * runs, *values.shape[3:])


def _given(mean: Array, cov: Array, of: Index, given: Index) -> Conditional:
    """Some components of Gaussians given others, by the moments of both."""
    cross, before = block(cov, of, given), block(cov, given, given)
    matrix = regression(cross, before)
    off = apply(matrix, mean[..., given])
    whole = np.block([[before, transpose(cross)], [cross, block(cov, of, of)]])
    size = cross.shape[-2]
    left = np.concatenate([-matrix, np.broadcast_to(np.eye(size), (*cross.shape[:-1], size))], -1)
    return Conditional(matrix, mean[..., of] - off, symmetric(sandwich(left, whole)))


@quiet()
def adapt(outcomes: list[ChainOutcome], weights: Array, draws: int) -> Adapted:
    """The modes that smoothers have arrived at, adapted by so many draws a run in each round.

    Parameters
    ----------
    outcomes : list of ChainOutcome
        A smoother's outcome for each mode, of all runs.
    weights : ndarray
        (K, runs), of sum one.
    draws : int
        S.

    Raises
    ------
    NumericalError
        If a trajectory has no density: of CPDs without noise beside exact measurements.
    GraphError
        If the draws would not fit in memory.
    """
    plan = outcomes[0]._plan
    read = (s for s in plan.sensors if s.family.step.size)
    exact = has_exact(s.family for s in read if s.taken is None or s.taken.any())
    model = ChainModel.make(plan, relative=False, near=False)
    laws = _of_smoothers(model.law, outcomes, weights)
    if exact or not all(laws.path(model.law, k).regular for k in range(len(weights))):
        raise NumericalError(
            "draws= weighs trajectories by their density, and these have none, as where sensors "
            "without noise were read: leave draws out, or give the exact CPDs some noise"
        )
    size = (plan.steps + 1) * 2 * laws.mean.shape[-1]
    require_runs(draws * size, plan.runs, f"draws={draws:,}, as many trajectories a run,")
    rng = np.random.default_rng(0)
    for _ in range(ROUNDS):
        found = _round(model, laws, draws, rng)
        laws = found.laws
    return found


def _of_smoothers(law: ChainLaw, outcomes: list[ChainOutcome], weights: Array) -> Laws:
    places = law.layout.state_places
    parts = []
    for outcome in outcomes:
        beliefs = outcome._beliefs
        pairs = law.pairs(beliefs, law.onward(beliefs, outcome._reverse.states))
        first = beliefs.mean[:1][..., places], block(beliefs.cov[:1], places, places)
        parts.append((*first, pairs.mean, pairs.cov))
    return Laws(weights, *(np.stack(each) for each in zip(*parts, strict=True)))


class _Source:
    """Draws of the mixture: each of a mode, or of the model alone; and their densities in each.

    kinds : ndarray
        (runs, S): the mode of each draw; K are defensive draws.
    by_mode, defensive : ndarray
        (K, runs, S) and (runs, S): ln q_k and ln d.
    """

    def __init__(
        self, law: ChainLaw, laws: Laws, kinds: Integers, rng: np.random.Generator
    ) -> None:
        self.paths = [laws.path(law, k) for k in range(len(laws.weights))]
        self.kinds, self._rng = kinds, rng
        self._means, self._turned = laws.mean, law.turned if law.turned.any() else None
        self._places = law.layout.state_places
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


def _round(model: ChainModel, laws: Laws, draws: int, rng: np.random.Generator) -> Adapted:
    """One round: S draws of each run, and the laws that their weights make of them."""
    runs = laws.weights.shape[1]
    alive = laws.weights > 0.0
    # A mode has half its weight and half an equal share, so that none is starved.
    shares = (1.0 - DEFENSIVE) * 0.5 * (laws.weights + alive / alive.sum(axis=0))
    ends = np.cumsum(shares, axis=0)
    places = (np.arange(draws) + 0.5) / draws
    kinds = (ends[..., None] <= places).sum(axis=0)
    source = _Source(model.law, laws, kinds, rng)
    drawn = model.draw(source, (runs, draws), strict=False)
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
    angles = angle_mask(model.plan.layout.pair)
    m = model.plan.layout.state_size
    values = np.stack(drawn.values)
    start = values[:1][..., m:][..., model.plan.layout.state_places]
    first = _moments(mass, start, laws.first, laws.spread, angles[:m])
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
