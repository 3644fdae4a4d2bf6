"""Draws of the trajectories of a chain, with their log-densities.

Draws are from the Gaussian answer q, the smoothed joint, or *defensive*, from a density with wider
tails: these leave q for an *excursion* of some steps, or are from Gaussians at other modes.

A component is *free* if it has noise given its parents; any other component is a function of its
parents and the free ones. Where a sensor without noise was read, or the posterior has no density,
densities are *relative*: each CPD's density is divided by that of the linearised CPD.

A slice has the states and hidden controls of a step. The *pair* is the vector of the states of the
step before, then the slice. A CPD's `Link` tells where its hidden parents and its child stand: for
a CPD of the prior in the vector of states, for one of the transition in the pair. Its `Term` gives
its density at draws. A `Conditional` is an affine Gaussian: a matrix, an offset and a covariance.

S is the number of draws of a run, T the last step, n the number of the components of a slice, and z
stands for all measurements.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pgm.beliefs.moments.outcomes.outcome import ChainOutcome
from pgm.beliefs.moments.passes import backward
from pgm.beliefs.moments.passes.backward import Beliefs, Reverse
from pgm.beliefs.moments.steps.plan import ChainPlan
from pgm.beliefs.moments.trajectories.density import has_exact
from pgm.beliefs.moments.trajectories.model import ChainModel
from pgm.beliefs.moments.trajectories.proposal import Path
from pgm.errors import NumericalError
from pgm.factors.scope import positions
from pgm.inference.audit import chain_modes
from pgm.inference.audit.corrected import Sums
from pgm.inference.audit.draws import Draws, Strand
from pgm.inference.audit.excursions import PREDICTED, Excursions
from pgm.inference.audit.modes import MOST, Modes
from pgm.kernels.arrays import Array, Mask, block
from pgm.kernels.moments import Conditional
from pgm.posteriors.belief_kind import SMOOTHED


@dataclass(frozen=True, eq=False)
class ChainDraws:
    """Trajectories from q or from the defensive density, drawn forward in time.

    model : ChainModel
        The densities of the linearised chain with its evidence.
    answer : Path
        The law q of the smoothed trajectories.
    modes : Modes
        Gaussians at other modes, for defensive draws.
    reference : ndarray
        (runs,): added to all log-densities: ln p(z) of the linearised model where they are
        `relative`, else zero.
    relative : bool
        Whether densities are relative.
    beliefs : Beliefs
        The smoothed moments of all slices: means (T+1, runs, n), covariances (T+1, runs, n, n).
    judged : ndarray
        (T+1,): for each step, whether the posterior's belief at it is given all measurements.
    onward : Conditional
        (T, runs, ...): each slice given the states before and all measurements.
    """

    model: ChainModel
    answer: Path
    modes: Modes
    reference: Array
    relative: bool
    beliefs: Beliefs
    judged: Mask
    onward: Conditional

    @classmethod
    def make(cls, posterior: ChainOutcome) -> ChainDraws:
        """Prepare to draw from the smoothed joint of a posterior's last linearisation.

        A NumericalError is raised for a nonlinear sensor that was read and has singular noise, and
        for indefinite covariances. Where densities are relative, it is also raised for robust
        noise, for nonlinear CPDs with singular noise, and for a *grouped* sensor, whose sightings
        of a step are linearised together.
        """
        plan = posterior._plan
        exact = has_exact(s.family for s in plan.sensors if s.family.step.size)
        reverse = posterior._reverse
        smoothed = posterior.kind == SMOOTHED
        beliefs = posterior._beliefs if smoothed else backward.sweep(posterior._forward, reverse)
        steps = range(plan.steps + 1)
        judged = np.array([posterior.kind.last(k, plan.steps) == plan.steps for k in steps])
        draws = cls._make(plan, beliefs, reverse, None, judged)
        if not exact and draws.answer.regular:
            return draws
        # The draws' support is the linearised model's: weights are relative to its densities, with
        # its own means, which step control may have held back.
        _refuse_grouped(plan)
        forward = posterior._forward
        reverse = Reverse.make(plan, forward)
        beliefs = backward.sweep(forward, reverse)
        return cls._make(plan, beliefs, reverse, forward.log_density.sum(axis=0), judged)

    @classmethod
    def _make(
        cls,
        plan: ChainPlan,
        beliefs: Beliefs,
        reverse: Reverse,
        reference: Array | None,
        judged: Mask,
    ) -> ChainDraws:
        """Prepare to draw from the Gaussian of smoothed moments, and look for other modes.

        beliefs: The smoothed moments of all slices.
        reverse: In `states`, (T, runs, ...), the conditionals of the states at a step given the
            slice after them and the measurements up to the step.
        reference: (runs,): ln p(z) of the linearised model; None unless densities are relative.
        judged: (T+1,): for each step, whether the posterior's belief at it is given all
            measurements.
        """
        relative = reference is not None
        model = ChainModel.make(plan, relative=relative)
        law = model.law
        answer = law.path(beliefs, reverse.states)
        modes = Modes.none(plan.runs)
        if relative or answer.regular:
            most = 0 if relative else MOST
            modes = chain_modes.find(plan, beliefs, reverse.states, law.path, most)
        return cls(
            model,
            answer,
            modes,
            np.zeros(plan.runs) if reference is None else reference,
            relative,
            beliefs,
            judged,
            law.onward(beliefs, reverse.states),
        )

    @property
    def plan(self) -> ChainPlan:
        """The linearised chain with its evidence."""
        return self.model.plan

    @property
    def width(self) -> int:
        """The number of floats that one slice of a draw of one run occupies while it is made."""
        return self.model.width

    @property
    def length(self) -> int:
        """The number of floats of a whole draw of one run, of all steps."""
        layout = self.plan.layout
        return (self.plan.steps + 1) * (layout.state_size + layout.slice_size)

    def sums(self) -> list[Sums]:
        """Sums over draws, still empty, by which the moments of beliefs are estimated.

        There is one `Sums` for each hidden variable, one for all states of a step together, and one
        for the pair. That for the pair is left out unless the posterior's beliefs at two successive
        steps are both given all measurements.
        """
        layout, judged = self.plan.layout, self.judged
        mean, cov = self.beliefs.mean, self.beliefs.cov
        front = layout.state_size
        alone = [(variable,) for variable in layout.slice]
        sums = []
        for scope in dict.fromkeys([*alone, layout.states]):
            first = 0 if set(scope) <= set(layout.states) else 1
            places = np.arange(layout.slice_size)[positions(layout.slice, scope)]
            sums.append(
                Sums(
                    scope,
                    front + places,
                    first,
                    mean[first:][..., places],
                    block(cov[first:], places, places),
                    judged[first:],
                    timed=True,
                )
            )
        known = judged[1:] & judged[:-1]
        if known.any():
            pairs = self.model.law.pairs(self.beliefs, self.onward)
            sums.append(Sums(layout.pair, slice(None), 1, pairs.mean, pairs.cov, known, timed=True))
        return sums

    def draw(self, count: int, rng: np.random.Generator, *, defensive: bool) -> Draws:
        """Draw S = `count` trajectories for each run, from q or, if `defensive`, defensive ones.

        Returns their values, and their log-densities by the model, by q and by the defensive
        density. Where a function of the model is NaN or infinite at a defensive draw, the model's
        log-density is NaN; at a draw from q, a LinearisationError is raised.
        """
        shape = self.plan.runs, count
        strand = Strand(
            self.answer, self.modes, self.excursions, shape, rng, defensive, self.relative
        )
        found = self.model.draw(strand, shape, strict=not defensive)
        return strand.drawn(self.reference[:, None] + found.log_density, found.values)

    @property
    def excursions(self) -> Excursions:
        """The law of the excursions: at which steps defensive draws leave q, and what they follow.

        On an excursion a draw follows q's conditionals with wider tails, or, unless densities are
        relative, the model's own CPDs.
        """
        return Excursions(self.plan.steps + 1, 0.0 if self.relative else PREDICTED)


def _refuse_grouped(plan: ChainPlan) -> None:
    """Raise a NumericalError for a grouped sensor, which relative densities do not allow.

    A grouped sensor's sightings of a step are linearised together. Their approximation errors are
    correlated, and no product of linearised densities of one sighting each has this correlation.
    """
    for sensor in plan.sensors:
        if sensor.cross:
            raise NumericalError(
                f"{sensor.family.cpd!r} is grouped: the approximation errors of a step's sightings "
                "are correlated, which is not audited beside a sensor without noise or a "
                "covariance too near to singular; leave grouped=True out, or give the exact sensor "
                "some noise",
                variable=sensor.variable,
                cpd=sensor.family.cpd,
            )
