"""One robot online: a step is laid out once for each kind of input, and then only carried out.

Whatever is out of the ordinary is None here, and left to the general way, which refuses what is
wrong: batches of robots, missing readings, values of odd shapes.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from math import isfinite
from typing import Any, TypeVar

import numpy as np

from pgm.errors import PgmError
from pgm.inference.chain.online_belief import OnlineBelief
from pgm.inference.chain.online_careful import REGULAR
from pgm.inference.chain.online_given import Key, ordinary, places
from pgm.inference.chain.online_steps import Places, Predict, Update
from pgm.inference.chain.plan import ChainPlan
from pgm.inference.kind import FILTERED, PREDICTED
from pgm.inference.status import Status
from pgm.kernels import single
from pgm.kernels.arrays import Array
from pgm.linearisers.single import Special
from pgm.variables import Variable

# Kinds of input that a filter keeps steps for.
_MOST = 64
# Nothing was to iterate, and linearised once.
_DONE, _LINEARISED = (Status(1, np.empty(0), np.array(converged)) for converged in (True, False))
Values = Mapping[Variable, Any]
Step = TypeVar("Step")
Make = Callable[[OnlineBelief, Values], ChainPlan]


class Kept(dict[Key, Step]):
    """Steps that are laid out, by the kind of what is given for them.

    Parameters
    ----------
    make : callable
        Makes a plan, or refuses what is given.
    lay_out : callable
        Makes a step of a plan, and of where the values of each variable stand.
    """

    def __init__(self, make: Make, lay_out: Callable[[ChainPlan, Places], Step]) -> None:
        super().__init__()
        self.make, self.lay_out = make, lay_out

    def add(self, key: Key, belief: OnlineBelief, values: Values) -> Step | None:
        """Lay out a step; None where it is for many robots."""
        plan = self.make(belief, values)
        if plan.lead:
            return None
        if len(self) >= _MOST:
            self.clear()
        step = self[key] = self.lay_out(plan, places(values))
        return step


class Single:
    """The lean steps of an online filter; what they return is None where the general way is due.

    Parameters
    ----------
    ahead, seen : callable
        Make the plan of a prediction, and of an update.
    """

    def __init__(self, ahead: Make, seen: Make) -> None:
        self._predictions: Kept[Predict] = Kept(ahead, Predict)
        self._updates: Kept[Update] = Kept(seen, Update)

    def predict(self, belief: OnlineBelief, inputs: Values) -> OnlineBelief | None:
        """The belief one step later."""
        given = ordinary(inputs)
        if given is None:
            return None
        key, rows = given
        predict = self._predictions.get(key) or self._predictions.add(key, belief, inputs)
        if predict is None:
            return None
        step = belief.step + 1
        try:
            mean, cov = predict.predict((step, rows), belief.mean, belief.cov)
        except (PgmError, Special):
            return None
        if not _finite(mean, cov) or not single.is_regular(cov, cov, REGULAR):
            return None
        return OnlineBelief(
            step, belief.layout, (), mean, cov, belief.log_evidence, _DONE, PREDICTED
        )

    def update(self, belief: OnlineBelief, readings: Values) -> OnlineBelief | None:
        """The belief given readings."""
        given = ordinary(readings)
        if given is None:
            return None
        key, rows = given
        step = belief.step
        if not step:  # there are no controls, and readings of them are refused
            key = *key, 0
        update = self._updates.get(key) or self._updates.add(key, belief, readings)
        if update is None:
            return None
        try:
            found = update.take((step, rows), belief.mean, belief.cov)
        except (PgmError, Special):
            return None
        # What is not finite in a belief or a reading is not in the density either.
        if found is None or not isfinite(found[2]):
            return None
        mean, cov, gained = found
        if not single.is_regular(cov, belief.cov, REGULAR):
            return None
        log_evidence = np.array(belief.log_evidence.item() + gained)
        status = _DONE if update.linear else _LINEARISED
        return OnlineBelief(step, belief.layout, (), mean, cov, log_evidence, status, FILTERED)


def _finite(mean: Array, cov: Array) -> bool:
    """Whether all is finite, which a sum of few numbers tells most quickly."""
    return isfinite(sum(mean.tolist()) + sum(cov.ravel().tolist()))
