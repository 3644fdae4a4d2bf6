"""The modes of a chain's posterior as laws of trajectories, which weighed draws adapt.

Laws are Gauss–Markov: all that is adapted of each are the moments of the states at step 0 and of
pairs of states and the slice after them. Arrays are as of `adapted`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pgm.beliefs.modes.laws import Laws, Scoped, without_density
from pgm.beliefs.modes.outcome import Found, rows_of
from pgm.beliefs.moments.outcomes.marginals import Marginals
from pgm.beliefs.moments.outcomes.outcome import ChainOutcome
from pgm.beliefs.moments.passes.backward import Beliefs, Reverse
from pgm.beliefs.moments.passes.joints import joint_moments
from pgm.beliefs.moments.steps.plan import ChainPlan
from pgm.beliefs.moments.trajectories.density import Peak, has_exact
from pgm.beliefs.moments.trajectories.law import ChainLaw
from pgm.beliefs.moments.trajectories.model import ChainModel, Proposing, Weighed
from pgm.beliefs.moments.trajectories.proposal import Path
from pgm.compile import SliceLayout
from pgm.factors import Gaussian
from pgm.factors.scope import angle_mask
from pgm.kernels.arrays import Array, Index, apply, block, sandwich, symmetric, transpose
from pgm.kernels.moments import Conditional
from pgm.kernels.solving import regression
from pgm.posteriors.belief_kind import SMOOTHED
from pgm.posteriors.hidden import require_at_steps
from pgm.variables import Variable


class Trajectories:
    """The trajectories of a chain, as a `Target` of draws; refused where they have no density.

    Attributes
    ----------
    law : ChainLaw
        Of the linearised motion.
    """

    def __init__(self, plan: ChainPlan) -> None:
        read = (s for s in plan.sensors if s.family.step.size)
        if has_exact(s.family for s in read if s.taken is None or s.taken.any()):
            raise without_density()
        self._model = ChainModel.make(plan, relative=False, near=False)
        self.law, layout = self._model.law, plan.layout
        self.before, self.states = layout.state_size, layout.state_places
        self.turned, self.angles = self.law.turned, angle_mask(layout.pair)
        slices = np.arange(layout.slice_size)
        states = slices[self.states]
        self.scopes = [
            Scoped(
                self.before + slices[layout.places[v]],
                np.flatnonzero(np.isin(states, slices[layout.places[v]])),
                0 if v in layout.states else 1,
            )
            for v in layout.slice
        ]

    @property
    def chain(self) -> ChainModel | None:
        """The densities of the chain if all components have noise; see `Target`."""
        every = self.law.prior + self.law.transition
        return self._model if all(term.free().all() for _, term in every) else None

    @property
    def peak(self) -> Peak:
        """The peak of the density."""
        return self._model.peak

    def path(self, laws: Laws, k: int) -> Path:
        """The law of a mode, as it is drawn from."""
        later = _given(
            laws.mean[k], laws.cov[k], slice(self.before, None), slice(None, self.before)
        )
        return self.law.path_of(laws.first[k], laws.spread[k], later)

    def draw(self, source: Proposing, shape: tuple[int, int]) -> Weighed:
        """Trajectories that a source proposes."""
        return self._model.draw(source, shape, strict=False)


def laws_of(layout: SliceLayout, found: Found) -> Laws:
    """The laws of modes that smoothers have found."""
    law, places = ChainLaw(layout, [], []), layout.state_places
    each = []
    for part in found.parts:
        assert isinstance(part.outcome, ChainOutcome)
        beliefs = part.outcome._beliefs
        pairs = law.pairs(beliefs, law.onward(beliefs, part.outcome._reverse.states))
        moments = (
            beliefs.mean[:1][..., places],
            block(beliefs.cov[:1], places, places),
            pairs.mean,
            pairs.cov,
        )
        each.append([own.swapaxes(0, 1) for own in moments])
    runs = found.index.shape[1]
    rows = rows_of(found.parts, runs)[found.index, np.arange(runs)]
    stacked = (np.concatenate(own) for own in zip(*each, strict=True))
    return Laws(found.weights, *(np.moveaxis(own[rows], 1, 2) for own in stacked))


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
