"""Steps of an online filter in twice the digits, where float64 has too few.

A step in float64 leaves all the digits that are promised where its beliefs are regular: no
component is determined to 5·10⁻⁸ of its variance by others, nor suddenly to that by a reading. Then
neither what a transition nor what a reading sums up is much smaller than its parts. Other
steps are made in twice the digits, and the belief is carried in these until it is regular.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pgm.inference.chain import careful, careful_motion
from pgm.inference.chain.certificate import MODERATE, is_ordinary
from pgm.inference.chain.flat import moments, solved
from pgm.inference.chain.plan import ChainPlan
from pgm.inference.chain.reading import Taken, take
from pgm.inference.chain.taking import Belief, variances
from pgm.inference.schedule import Filtering
from pgm.kernels.arrays import Array
from pgm.kernels.twofold import Twofold

# The share of its variance below which a component counts as determined.
REGULAR = 1.0 / MODERATE


class CarefulBelief(NamedTuple):
    """A belief in twice the digits.

    Attributes
    ----------
    belief : Belief
    largest : ndarray
        (runs, n): the largest variances since it is carried so.
    """

    belief: Belief
    largest: Array

    @property
    def error(self) -> Array:
        """The error of the means, (runs,); see `Belief.error`."""
        return self.belief.error(self.largest)

    @property
    def moments(self) -> tuple[Array, Array]:
        """The moments in float64."""
        return moments(self.belief, solved(_nothing(self.belief)))

    @property
    def is_ordinary(self) -> bool:
        """Whether float64 can carry it: covariances, and means beside their deviations."""
        return is_ordinary(*self.moments)

    def over(self, before: tuple[int, ...], after: tuple[int, ...]) -> CarefulBelief:
        """The same for runs on other axes, which those before broadcast to."""
        if before == after:
            return self

        def wide(array: Array) -> Array:
            own = array.shape[1:]
            return np.broadcast_to(array.reshape(*before, *own), (*after, *own)).reshape(-1, *own)

        columns, cov = (Twofold(wide(part.hi), wide(part.lo)) for part in self.belief[:2])
        rounding, drift = map(wide, self.belief[2:])
        return CarefulBelief(Belief(columns, cov, rounding, drift), wide(self.largest))


def first(plan: ChainPlan) -> CarefulBelief:
    """The prior."""
    belief = careful_motion.start(plan, linearise=True)
    return CarefulBelief(belief, variances(belief.cov.hi))


def beginning(mean: Array, cov: Array) -> CarefulBelief:
    """A belief of moments in float64, (runs, n) and (runs, n, n)."""
    return CarefulBelief(Belief.of(mean, cov), variances(cov))


def predict(plan: ChainPlan, step: int, known: CarefulBelief) -> CarefulBelief:
    """The belief one step later, at `step`."""
    move = careful_motion.moving(plan, 1, *known.moments)
    belief = careful_motion.predict(known.belief, move)
    careful.require_proper(plan, step, belief)
    return CarefulBelief(belief, np.maximum(known.largest, variances(belief.cov.hi)))


def update(
    plan: ChainPlan, step: int, known: CarefulBelief, schedule: Filtering
) -> tuple[CarefulBelief, Taken[careful.CarefulUpdate]]:
    """The belief given the readings of its step."""
    nothing = _nothing(known.belief)
    taken = take(
        careful.CarefulReading.of(plan, 0, known.moments, known.belief, nothing, schedule), schedule
    )
    belief = taken.solution.at(taken.mean).belief
    careful.require_proper(plan, step, belief)
    return CarefulBelief(belief, known.largest), taken


def _nothing(belief: Belief) -> Twofold:
    """No information about an unknown δ, which an online filter has not."""
    return Twofold.zeros((len(belief.cov.hi), 1, 1))
