"""Draws of all variables of a mixed network: the discrete ones, then what they choose.

The configuration of a part is drawn with the tables. Given it, the part is a Gaussian network,
whose runs are configurations and the user's runs.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from pgm.kernels.arrays import Array, Integers, ranks
from pgm.resources import require_memory
from pgm.variables import Discrete, Variable

if TYPE_CHECKING:
    from pgm.beliefs.mixed.outcome import MixedOutcome
    from pgm.beliefs.mixed.weighing import Weighed


def draws(outcome: MixedOutcome, count: int, rng: np.random.Generator) -> dict[Variable, Any]:
    """So many draws of each hidden variable, (count, runs, d) or (count, runs) of states."""
    runs = outcome._runs
    tables = outcome._tables.sample(count, rng)
    found: dict[Variable, Any] = {}
    for variable in outcome._hidden:
        if isinstance(variable, Discrete):
            found[variable] = _by_run(tables[variable], count, runs)
    for part, choice in zip(outcome._parts, outcome._choices, strict=True):
        if part.beliefs:
            number = np.zeros((count, runs), dtype=np.intp)
            if choice is not None:
                number = _by_run(tables[choice], count, runs)
            found |= _of_part(part, number, rng)
    return {v: found[v] for v in outcome._hidden}


def _by_run(states: Integers, count: int, runs: int) -> Integers:
    return np.broadcast_to(states.reshape(count, -1), (count, runs))


def _of_part(part: Weighed, number: Integers, rng: np.random.Generator) -> dict[Variable, Array]:
    """Draws of a part's continuous variables, in the configurations of some numbers (count, runs).

    Of each configuration and run there are as many draws as the pair that has the most needs.
    """
    found = {v: np.empty((*number.shape, v.dimension)) for v in part.part.hidden}
    for which, own, belief in part.beliefs:
        place = np.full(len(part.configurations), -1, dtype=np.intp)
        place[which] = np.arange(which.size)
        here = place[number[:, own]]
        draw, run = np.nonzero(here >= 0)
        if not draw.size:
            continue
        pair = here[draw, run] * own.size + run  # the belief's run
        rank = ranks(pair)
        most = int(rank.max()) + 1
        size = sum(v.dimension for v in found)
        require_memory(
            2 * most * which.size * own.size * size,
            f"draws of {which.size:,} configurations in {own.size:,} runs",
            "draw fewer at a time",
        )
        for variable, values in belief.sample(most, rng).items():
            flat = values.reshape(most, -1, variable.dimension)
            alone = flat.shape[1] == 1
            found[variable][draw, own[run]] = flat[rank, 0 if alone else pair]
    return found
