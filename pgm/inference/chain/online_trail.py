"""The steps behind the belief of an online filter: how to go back over them by a lag."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any, NamedTuple, NoReturn

import numpy as np

from pgm.errors import NumericalError
from pgm.inference.chain.backward import Reverse
from pgm.inference.chain.certificate import MODERATE
from pgm.inference.chain.moments import MomentChain
from pgm.inference.chain.plan import ChainPlan
from pgm.inference.chain.readings import Moments
from pgm.inference.rows import At
from pgm.inference.schedule import ONCE
from pgm.kernels import moments
from pgm.kernels.arrays import Array
from pgm.kernels.moments import Conditional


class _Ends(NamedTuple):
    """A transition's belief before it, and what it predicts: (2, runs, ...) each."""

    mean: Array
    cov: Array

    @property
    def predicted_mean(self) -> Array:
        """The same."""
        return self.mean

    @property
    def predicted_cov(self) -> Array:
        """The same."""
        return self.cov


class Passed:
    """A transition that was made in float64, and the slice before it given the slice after it.

    Parameters
    ----------
    plan : ChainPlan
        Of one step, as it was linearised.
    before, after : Moments
        The belief before it, and what it predicts.
    """

    def __init__(self, plan: ChainPlan, before: Moments, after: Moments) -> None:
        self._made, self._lead = (plan, before, after), plan.lead

    @cached_property
    def back(self) -> Conditional:
        """The slice before given the slice after, (*lead, ...); found when it is asked for."""
        plan, *ends = self._made
        (mean, cov), (later, spread) = (each.by_run for each in ends)
        both = _Ends(np.stack([mean, later]), np.stack([cov, spread]))
        parts = Reverse.make(plan, both).whole
        return Conditional(*(part[0].reshape(*self._lead, *part.shape[2:]) for part in parts))

    @cached_property
    def variances(self) -> Array:
        """Of the slice before, given the readings up to it, (*lead, n)."""
        cov = self._made[1].by_run[1]
        found: Array = np.einsum("...ii->...i", cov).reshape(*self._lead, cov.shape[-1])
        return found

    def __getstate__(self) -> dict[str, Any]:
        # What they are found from need not travel.
        return {"back": self.back, "variances": self.variances}


def trailing(plan: ChainPlan, ats: Sequence[At]) -> MomentChain:
    """A chain of one step that keeps how its CPDs are linearised at rows, in a plan of its own."""
    own = plan.window(0, 1)
    for link, at in zip(own.transition, ats, strict=True):
        if link.family.noisy and not plan.batch:  # laid out for other rows, maybe
            link.family.noise = link.family.own_noise = at.noise[None, None]
    return MomentChain(own, ONCE)


class Trail(NamedTuple):
    """The transitions behind a belief, as many as the lag has steps.

    Attributes
    ----------
    lag : int
    passed : tuple of Passed or None
        The last of them ends at the belief's step; None where a step took twice the digits.
    rough : bool
        Whether the readings of the belief's step did.
    """

    lag: int
    passed: tuple[Passed | None, ...] = ()
    rough: bool = False

    def on(self, passed: Passed | None) -> Trail:
        """A step later."""
        kept = (*self.passed, None if self.rough else passed)
        return Trail(self.lag, kept[-self.lag :] if self.lag else ())

    def lagged(self, step: int, mean: Array, cov: Array) -> tuple[int, Array, Array]:
        """The first step of the trail, and the moments of its slice from those at the last one."""
        first, before = step - len(self.passed), step
        for passed in reversed(self.passed):
            before -= 1
            if passed is None or (self.rough and before == step - 1):
                self._refuse(first, before, step)
            mean, cov = moments.push(mean, cov, passed.back)
            left = np.einsum("...ii->...i", cov)
            if ((MODERATE * left < passed.variances) & (left != 0.0)).any():
                self._refuse(first, before, step)
        return first, mean, cov

    def _refuse(self, first: int, before: int, step: int) -> NoReturn:
        raise NumericalError(
            f"float64 loses the belief at step {first} given the readings up to step {step}: at "
            f"step {before} or the next, deviations lie too far apart. That at step {step} is "
            "right; the other is found on recorded readings, pgm.smooth(..., lag=...), and by an "
            "online filter with iterations=2, which solves its windows in twice the digits",
            step=first,
        )
