"""A forward pass in twice the digits, as it is kept; see `careful`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

from pgm.beliefs.moments.digits.careful_belief import Belief, Move, rounded_belief, solved
from pgm.beliefs.moments.digits.careful_update import CarefulUpdate
from pgm.beliefs.moments.passes.forward import Forward
from pgm.beliefs.moments.steps.diffuse import Diffuse
from pgm.kernels.arrays import Array
from pgm.kernels.extended import Twofold


class Step(NamedTuple):
    """A step of the pass: the transition to it, and its belief before and after measurements.

    `move` is None at the first step; `taken` has the belief and the estimate of δ given the
    measurements up to the step.
    """

    move: Move | None
    predicted: Belief
    taken: CarefulUpdate


@dataclass(frozen=True, eq=False)
class Careful:
    """A forward pass: its `steps` in twice the digits, and `forward`, their moments in float64.

    `error` (runs,) is the largest rounding error of a filtered mean, at any step. An error is
    divided by the standard deviation of its component, or, if larger, by 10⁻⁹ of the largest
    standard deviation that was predicted for the component up to that step.
    """

    forward: Forward
    steps: Sequence[Step]
    error: Array


class Begin(NamedTuple):
    """The belief at the first step of a window, given the measurements up to that step.

    A window is a run of consecutive steps of a longer chain, with a plan of its own
    (`ChainPlan.window`), which then lacks the prior and the measurements of its first step.
    `information` (runs, 1 + q, 1 + q) is Σ [v V]ᵀ[v V] / S over all measurements that the belief
    knows: [v V] is the row of one scalar's innovation, S its variance.
    """

    belief: Belief
    information: Twofold

    @classmethod
    def known(cls, belief: Belief) -> Begin:
        """A belief of which no measurement has told anything of δ yet, if it depends on any."""
        columns = belief.columns
        return cls(belief, Twofold.zeros((len(belief.largest), *columns.shape[-1:] * 2)))

    @property
    def rounded(self) -> tuple[Array, Diffuse]:
        """The mean (runs, n) and the covariance in float64, at the estimate of δ."""
        return rounded_belief(self.belief, solved(self.information))
