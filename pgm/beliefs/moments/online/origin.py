"""Where a belief of an online filter comes from: whose it is, and what its last update took in.

From these the innovations are found when they are asked for, by making the update again.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cached_property
from typing import TYPE_CHECKING, Any

from pgm.variables import Variable

if TYPE_CHECKING:
    from pgm.beliefs.moments.online.beliefs import MomentBelief
    from pgm.beliefs.moments.online.moment_steps import MomentSteps

# The belief before an update, and its readings.
Pair = tuple["MomentBelief", Mapping[Variable, Any]]


class Origin:
    """The filter's `steps` that made a belief, and the belief and readings of its last update.

    `pair` makes these two. It is None of a prediction, and where a sliding window has both.
    """

    def __init__(self, steps: MomentSteps, pair: Callable[[], Pair] | None = None) -> None:
        self.steps, self._pair = steps, pair

    @cached_property
    def pair(self) -> Pair | None:
        """The belief before the update, and its readings; None as of `Origin`."""
        return None if self._pair is None else self._pair()

    def __getstate__(self) -> dict[str, Any]:
        return {"steps": self.steps, "pair": self.pair}
