"""Tables of a chain as a page shows them: beliefs, messages and potentials at some steps."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from pgm.beliefs.markov.joints import potential
from pgm.kernels.arrays import Array
from pgm.posteriors.belief_kind import FILTERED, SMOOTHED
from pgm.posteriors.shown_slices import Room, ShownSlices, held, sensors_of

if TYPE_CHECKING:
    from pgm.beliefs.markov.outcome import StateOutcome

# Entries of beliefs of all runs together, up to which messages back are made.
_MOST = 20_000_000


class ShownTables(ShownSlices):
    """Tables over the slices of a chain, of the states before a step, and of both together.

    width: The number of entries of a slice's table.
    weight: The log-evidence of the measurements up to each step, (T+1, runs).
    back: The messages back to each step, where they are made.
    """

    reading: ClassVar[str] = "table"

    def __init__(self, outcome: StateOutcome, span: range, room: Room) -> None:
        self.outcome, self.steps = outcome, list(held(span))
        self.plan, self.chain = outcome._plan, outcome._chain
        self.first, self.hidden = self.steps[0], self.plan.slice
        self.sensors = sensors_of(outcome._slices.bound.readings)
        self.width = math.prod(self.plan.shape)
        # Of the states before a step with its slice.
        entries = math.prod(v.size for v in self.plan.states) * self.width
        last = outcome.graph.steps
        density = np.asarray(self.chain.log_density).reshape(last + 1, -1)
        self.weight: Array = np.cumsum(density, axis=0)
        smoothed, fits = outcome.kind == SMOOTHED, self.width * self.weight.size <= _MOST
        self.back = list(outcome.messages_back() if smoothed and fits else ())[::-1]
        self.words = {}
        self.tables = entries * len(self.steps) <= room.numbers and entries <= room.entries
        if not smoothed:
            self.words["back"] = f"not sent: the posterior is {outcome.kind}; smoothing sends it"
        elif not self.back:
            self.words["back"] = "left out: the batch is too large to make it for all runs"
            self.tables = False
        if not self.tables:
            self.words["large"] = f"left out: {entries:,} entries at each step are too many"

    def arrays(self, run: tuple[int, ...]) -> dict[str, Array]:
        """Beliefs, messages ``there`` and ``back``, each with its weight, and potentials."""
        place = int(np.ravel_multi_index(run, self.outcome._lead)) if run else 0
        return self._beliefs(place) | (self._potentials(run, place) if self.tables else {})

    def _of(self, values: Array, axes: int, place: int, width: int = 0) -> Array:
        """The numbers of a run, flat; at step 0, without controls, at the length of the others."""
        own = values[..., place] if values.ndim > axes else values
        found = np.full(max(own.size, width), np.nan)
        found[: own.size] = own.reshape(-1)
        return found

    def _beliefs(self, place: int) -> dict[str, Array]:
        outcome, steps = self.outcome, self.steps
        axes, states = len(self.plan.shape), len(self.plan.states)
        beliefs, filtered = outcome._beliefs, outcome._filtered
        last = [outcome.kind.last(step, outcome.graph.steps) for step in steps]
        found = {
            "belief": np.stack([self._of(beliefs[k], axes, place, self.width) for k in steps]),
            "weight": self.weight[last, place],
            "there": np.stack(
                [self._of(outcome._states(filtered[k]), states, place) for k in steps]
            ),
            "there.weight": self.weight[steps, place],
        }
        if self.back:
            found["back"] = np.stack([self._of(self.back[k][0], states, place) for k in steps])
            found["back.scale"] = np.array([np.reshape(self.back[k][1], -1)[place] for k in steps])
        return found

    def _potentials(self, run: tuple[int, ...], place: int) -> dict[str, Array]:
        """The transitions and likelihood weights of a run.

        Transitions are the same at all steps, mostly, and then take no room.
        """
        chain, steps, kind = self.chain, self.steps, self.outcome.kind
        axes, states = len(self.plan.shape), len(self.plan.states)
        later = [step for step in steps if step]
        moved, weights, scales = [], [], []
        found = {}
        for step in steps:
            transition, own, scale = potential(chain, self.plan, step)
            if step:
                moved.append(self._of(chain.numbers(transition), states + axes, place))
            else:
                found["first"] = self._of(chain.numbers(transition), axes, place, self.width)[None]
            # Weights have one entry for variables that the measurements do not depend on.
            shape = self.plan.shape if step else self.plan.first_shape
            likely = np.ones(shape) if own is None else chain.numbers(own)
            likely = np.broadcast_to(likely, (*shape, *likely.shape[axes:]))
            weights.append(self._of(likely, axes, place, self.width))
            scales.append(np.broadcast_to(scale, self.weight.shape[1])[place])
        found |= {"own.weights": np.stack(weights), "own.scale": np.array(scales)}
        if later:
            found["own"] = np.stack(moved)
            if kind not in (FILTERED, SMOOTHED):
                tables = (self.outcome.belief(step).values[run] for step in later)
                found["pairs"] = np.stack([table.reshape(-1) for table in tables])
        return found
