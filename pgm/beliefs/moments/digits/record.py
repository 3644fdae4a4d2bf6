"""Passes of machine code in twice the digits, whose steps are rows of arrays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from pgm.beliefs.moments.digits.adjoint_belief import Back, Later, Smooth
from pgm.beliefs.moments.digits.careful_belief import (
    Belief,
    Component,
    Move,
    Solved,
    rounded_belief,
    solved,
)
from pgm.beliefs.moments.digits.careful_pass import Step
from pgm.beliefs.moments.digits.careful_update import CarefulUpdate
from pgm.beliefs.moments.digits.laid_out import mapped, piled
from pgm.beliefs.moments.steps.diffuse import Diffuse
from pgm.beliefs.moments.steps.plan import ChainPlan
from pgm.kernels.arrays import Array, Integers
from pgm.kernels.extended import Twofold


@dataclass(frozen=True, eq=False)
class Record(Sequence[Step]):
    """The steps of a forward pass, each made of its rows when it is asked for.

    `plan` is what was swept. `every` has the transitions (T or 1, runs or 1, ...), `predicted` and
    `known` the beliefs before and after measurements (T+1, runs, ...), and `information` and
    `unknown` what is known of δ after them. `mean`, `spread` and `log_density` are as of
    `CarefulUpdate`; `components` are those of all steps (K, runs, ...), and rows bounds[t] to
    bounds[t + 1] are of step t.
    """

    plan: ChainPlan
    every: Move
    predicted: Belief
    known: Belief
    information: Twofold
    unknown: Solved
    mean: Array
    spread: Diffuse
    log_density: Array
    components: Component
    bounds: Integers

    def __len__(self) -> int:
        return len(self.mean)

    def __getitem__(self, step: Any) -> Any:
        """The step of this number."""
        step, move = range(len(self))[step], None
        if step:
            move = self.every.at(step - 1 if len(self.every.matrix.hi) > 1 else 0)
        first, last = self.bounds[step : step + 2].tolist()
        parts = self.known, self.unknown, self.information, self.spread
        known, unknown, information, spread = (row(part, step) for part in parts)
        taken = CarefulUpdate(
            self.mean[step],
            spread,
            self.log_density[step],
            known,
            [row(self.components, k) for k in range(first, last)],
            information,
            unknown,
        )
        return Step(move, row(self.predicted, step), taken)


@dataclass(frozen=True, eq=False)
class Slices(Sequence[Smooth]):
    """The smoothed slices at consecutive steps from `first` on, each made when it is asked for.

    The arrays are (steps, runs, ...): of beliefs, of the shares of their variances that may be
    rounding, of the messages to the predicted beliefs, and of the gains of Bayes' rule where it was
    used, which `lost` (steps, runs) marks by one.
    """

    first: int
    belief: Belief
    parts: Array
    here: Later
    gain: Twofold
    lost: Array

    @classmethod
    def of(cls, slices: Sequence[Smooth]) -> Slices:
        """The slices of a pass that made one after another."""
        none = Back(Twofold.zeros(slices[0].here.matrix.shape), np.zeros((1, 1, 1), dtype=bool))
        backs = [none if each.back is None else each.back for each in slices]
        runs = len(slices[0].parts)
        lost = [np.broadcast_to(back.lost[:, 0, 0], runs) for back in backs]
        belief, parts, here = piled([(each.belief, each.parts, each.here) for each in slices])
        gain = piled([back.gain for back in backs])
        return cls(slices[0].step, belief, parts, here, gain, np.array(lost, dtype=np.float64))

    def __len__(self) -> int:
        return len(self.parts)

    def __getitem__(self, place: Any) -> Any:
        """The slice at this place."""
        place, back = range(len(self))[place], None
        lost = self.lost[place] != 0.0
        if lost.any():
            back = Back(self.gain[place], lost[:, None, None])
        belief, here = row(self.belief, place), row(self.here, place)
        return Smooth(self.first + place, belief, here, back, self.parts[place])


def row(value: Any, place: int) -> Any:
    """A value at one place of its first axis."""
    return mapped(lambda array: array[place], value)


def at_all_steps(information: Twofold) -> Solved:
    """The estimates of δ (steps, runs, ...) from what is known at each step."""
    found: Solved = _as_runs(solved, information)
    return found


def shown(belief: Belief, unknown: Solved) -> tuple[Array, Diffuse]:
    """Means and covariances (steps, runs, ...) in float64, at the estimates of δ."""
    found: tuple[Array, Diffuse] = _as_runs(rounded_belief, belief, unknown)
    return found


def _as_runs(function: Any, *values: Any) -> Any:
    """A function of values (runs, ...), for values (steps, runs, ...)."""
    first = values[0][0] if isinstance(values[0], tuple) else values[0]
    steps, runs = first.shape[:2]
    found = function(
        *(mapped(lambda part: part.reshape(steps * runs, *part.shape[2:]), v) for v in values)
    )
    return mapped(lambda part: np.reshape(part, (steps, runs, *part.shape[1:])), found)
