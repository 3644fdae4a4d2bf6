"""A belief estimated from weighted draws beside the answer's, and how far these are apart."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from math import log, sqrt

import numpy as np

from pgm.factors import Gaussian, Table
from pgm.kernels.arrays import Array, Integers, Mask, frozen
from pgm.variables import Variable


@dataclass(frozen=True, eq=False, kw_only=True)
class Compared(ABC):
    """An exact belief, estimated, beside the answer's.

    scope: The variables of the belief.
    steps: The steps of a chain at which it is compared; None in a network without time, whose
        arrays have a single step.
    divergence: KL(the estimated belief ‖ the answer's) in nats, (steps, runs).
    judged: Marks the steps at which the posterior's belief is given all measurements, as q is,
        (steps,).
    """

    scope: tuple[Variable, ...]
    steps: Integers | None
    divergence: Array
    judged: Mask

    @property
    @abstractmethod
    def freedom(self) -> float:
        """The degrees of freedom f: how many free numbers a belief has."""

    @abstractmethod
    def belief(self, lead: tuple[int, ...]) -> Gaussian | Table:
        """The estimated belief, its leading axes the runs, `lead`, then steps if any."""

    def excess(self, draws: Array) -> Array:
        """The largest divergence of a judged belief, less what chance explains, (runs,), in nats.

        Beliefs estimated from N effective draws, `draws` (runs,), are off by about χ²_f / 2N nats,
        where f is `freedom`. With m judged steps, the largest of m such errors is bounded by

            (f/2 + √(f ln m) + ln m) / N

        (Laurent & Massart, 2000, lemma 1). So much is explained by chance.
        """
        freedom, spread = self.freedom, log(max(int(self.judged.sum()), 1))
        chance = (0.5 * freedom + sqrt(freedom * spread) + spread) / draws
        return np.asarray(self._known.max(axis=0, initial=0.0) - chance)

    @property
    def _known(self) -> Array:
        """Divergences (steps, runs) of judged beliefs where they are finite; zero elsewhere."""
        known = self.judged[:, None] & np.isfinite(self.divergence)
        return np.where(known, self.divergence, 0.0)

    def furthest(self, lead: tuple[int, ...]) -> tuple[float, str]:
        """The largest divergence of a judged belief, and this belief's variables and run in words.

        `lead` is the shape of the runs. The words list the variables, and end in " of run 2" if
        there is a `lead`. With no run, or no step, the divergence is zero and the words are empty.
        """
        found = self._known
        if not found.size:
            return 0.0, ""
        step, run = np.unravel_index(int(found.argmax()), found.shape)
        scope = self.scope
        if self.steps is not None:
            scope = tuple(each.at(int(self.steps[step])) for each in scope)
        where = ", ".join(str(k) for k in np.unravel_index(run, lead))
        of = f" of run {where}" if lead else ""
        return float(found[step, run]), f"{', '.join(map(repr, scope))}{of}"

    def divergences(self, lead: tuple[int, ...]) -> Array:
        """The divergence, (*lead, steps), or (*lead) in a network without time."""
        return frozen(self._stacked(self.divergence, lead))

    def _stacked(self, values: Array, lead: tuple[int, ...]) -> Array:
        """Reshape (steps, runs, ...) to (*lead, steps, ...); without time to (*lead, ...)."""
        tail = values.shape[2:]
        if self.steps is None:
            return np.asarray(values[0].reshape((*lead, *tail)))
        return np.asarray(values.swapaxes(0, 1).reshape((*lead, len(values), *tail)))
