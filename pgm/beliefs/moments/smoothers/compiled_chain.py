"""A chain as a problem for `iterate` whose linearisations and costs machine code finds."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from pgm.beliefs.moments.compiled.points import Linearised
from pgm.beliefs.moments.smoothers.smoother import Chain, Smoothed
from pgm.beliefs.moments.steps import cost
from pgm.kernels.arrays import Array, Mask
from pgm.schedules.iteration import Point


@dataclass(eq=False)
class CompiledChain(Chain[Smoothed]):
    """A chain that is linearised by machine code; what that is not sure of is left to NumPy.

    `known` is the point at which each run was linearised last.
    """

    machine: Linearised = field(kw_only=True)
    known: Point | None = None

    def linearise(self, at: Point, active: Mask | None) -> None:
        """Linearise every CPD at a point, and weigh the robust sightings there.

        Runs that are not `active` (runs,) keep their linearisations; None means all.
        """
        if active is not None and self.known is not None and not active.all():
            at = _where(active, at, self.known)
        self.known, self.at = at, at.mean
        if not self.machine.linearise(at):
            super().linearise(at, None)

    def cost(self, at: Point) -> Array:
        """The cost of a trajectory, the means (T+1, runs, n) of `at`, (runs,)."""
        found = self.machine.cost(at)
        return super().cost(at) if found is None else found + cost.prior(self.plan, at)


def _where(active: Mask, one: Point, other: Point) -> Point:
    """One point in active runs, and another in the others."""
    parts = []
    for a, b in zip(one, other, strict=True):
        lead = active.reshape(-1, *(1,) * (0 if a is None else a.ndim - 2))
        parts.append(None if a is None else np.where(lead, a, b))
    return Point(*parts)
