"""The Gaussian law of a chain's trajectories, by which they are drawn forward in time.

A slice has the states and hidden controls of a step. The *pair* is the vector of the states of the
step before, then the slice. T is the last step, n the number of the components of a slice, and z
stands for all measurements.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pgm.beliefs.moments.passes.backward import Beliefs
from pgm.beliefs.moments.steps.plan import ChainPlan
from pgm.beliefs.moments.trajectories.density import Links, Term
from pgm.beliefs.moments.trajectories.proposal import Path, Proposal
from pgm.compile import SliceLayout
from pgm.kernels import moments
from pgm.kernels.arrays import Array, Mask, block, transpose
from pgm.kernels.dense import Stack
from pgm.kernels.moments import Conditional
from pgm.kernels.step import crossed


@dataclass(frozen=True, eq=False)
class ChainLaw:
    """Makes, from smoothed moments, Gaussian laws of trajectories.

    layout: Where variables stand in the vectors of states, slices and pairs.
    prior, transition: Pairs of a CPD's `Link` and its `Term`.
    """

    layout: SliceLayout
    prior: Links
    transition: Links

    @classmethod
    def make(cls, plan: ChainPlan, *, relative: bool, near: bool = True) -> ChainLaw:
        """The law of a chain; `relative` and `near` are as of its CPDs' `Term`."""
        prior, transition = (
            [(link, Term.make(link.family, relative=relative, near=near)) for link in links]
            for links in (plan.prior, plan.transition)
        )
        return cls(plan.layout, prior, transition)

    @property
    def turned(self) -> Mask:
        """The components of a slice that are angles and the values of functions, (n,).

        Of draws that are not `near`, as of `Term`, they are on the branch of the function's value.
        """
        found = np.zeros(self.layout.slice_size, dtype=bool)
        start = self.layout.state_size
        for link, term in self.transition:
            if not term.family.exact:
                place = slice(link.child.start - start, link.child.stop - start)
                found[place] = term.family.cpd.child.angle_mask
        return found

    def onward(self, beliefs: Beliefs, states: Conditional) -> Conditional:
        """The conditionals p(slice at t + 1 | states at t, z), (T, runs, ...), z all measurements.

        Bayes' rule makes them of `states`, the conditionals p(states at t | slice at t + 1,
        measurements up to t), (T, runs, ...), and `beliefs`, the smoothed moments of all slices.
        """
        mean, cov, places = beliefs.mean, beliefs.cov, self.layout.state_places
        before = block(cov[:-1], places, places)
        return moments.reverse(
            mean[1:], cov[1:], states.matrix, states.cov, mean[:-1][..., places], before
        )

    def pairs(self, beliefs: Beliefs, onward: Conditional) -> Beliefs:
        """The moments of the pairs of steps 1 to T, (T, runs, ...).

        `onward` has each slice given the states before; `beliefs` are the moments of all slices.
        """
        mean, places = beliefs.mean, self.layout.state_places
        before = block(beliefs.cov[:-1], places, places)
        parts = Stack(before, True), Stack(onward.matrix), Stack(onward.cov)
        cross, slices = (each.array for each in crossed(*parts))
        means = np.concatenate([mean[:-1][..., places], mean[1:]], axis=-1)
        return Beliefs(means, np.block([[before, transpose(cross)], [cross, slices]]))

    def path(self, beliefs: Beliefs, states: Conditional) -> Path:
        """The law of trajectories: the states at step 0, then each slice given the states before.

        `beliefs` are the smoothed moments of all slices, `states` the conditionals p(states at t |
        slice at t + 1, measurements up to t), (T, runs, ...).
        """
        places = self.layout.state_places
        mean, cov = beliefs.mean[:1][..., places], block(beliefs.cov[:1], places, places)
        return self.path_of(mean, cov, self.onward(beliefs, states))

    def path_of(self, mean: Array, cov: Array, onward: Conditional) -> Path:
        """The law whose states at step 0 have a mean and covariance, (1, runs, ...).

        `onward` has each slice given the states before, (T, runs, ...).
        """
        start = Conditional(np.zeros((1, *cov.shape[1:-1], 0)), mean, cov)
        free = _free(self.transition, onward.offset.shape, self.layout.state_size)
        return Path(
            Proposal.make(start, _free(self.prior, mean.shape, 0)),
            Proposal.make(onward, free),
        )


def _free(links: Links, shape: tuple[int, ...], start: int) -> Mask:
    """The mask of components that have noise given their parents, in the `shape` given.

    links: The CPDs of the prior, or those of the transition.
    shape: For the prior (1, runs, components of the states); for the transition (T, runs, n), with
        a row for each step from 1 on.
    start: The place at which the components begin in the vector of the links: 0 for the prior; for
        the transition, whose pair has the states before first, their number of components.
    """
    free = np.zeros(shape, dtype=bool)
    for link, term in links:
        free[..., link.child.start - start : link.child.stop - start] = term.free()
    return free
