"""The answer by trajectories that are recombined from draws of each step, and its error."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pgm.beliefs.modes.adapted import of_trajectories
from pgm.beliefs.modes.laws import Laws, Target
from pgm.beliefs.modes.pool import effective
from pgm.beliefs.modes.recombined import Recombination
from pgm.inference.vouching.judging import CAUTION, FLOOR, marginal, worst
from pgm.kernels.arrays import Array
from pgm.kernels.pareto import pareto_shape

# The draws of a step in each of two passes, and the trajectories that are recombined from them.
PASSES, KEPT = (256, 512), 1000
# Components of a slice beyond which so few draws do not cover its belief.
MOST = 6
# Numbers of all pairs of draws that are held at once.
ROOM = 2**24


class Recombined(NamedTuple):
    """The mixture of modes with the moments of recombined trajectories, by run.

    within: A bound on the divergence of the worst marginal's moments [nats], (runs,): how far they
        are from those that the first pass gave.
    effective, pareto_k: The effective number of draws, and the shape of the tail of their weights,
        at the step at which the fewest draws count.
    """

    laws: Laws
    log_evidence: Array
    within: Array
    effective: Array
    pareto_k: Array


def per_call(laws: Laws) -> int:
    """The number of runs whose pairs of draws fit into memory."""
    size: int = laws.mean.shape[-1]
    return max(1, ROOM // (PASSES[-1] ** 2 * size))


def recombined(target: Target, laws: Laws, rng: np.random.Generator) -> Recombined | None:
    """The answer by recombined trajectories about modes; None where draws do not cover a step.

    They cover those of a chain of few components a step, each of which has noise.
    """
    if target.chain is None or target.chain.plan.layout.slice_size > MOST:
        return None
    recombination = Recombination(target.chain, laws)
    before = None
    found = []
    for count in PASSES:
        before = recombination.run(count, KEPT, before, rng)
        found.append(of_trajectories(target, laws, before.trajectories.values))
    assert before is not None
    off = apart(target, found[-1], found[0])
    with np.errstate(divide="ignore"):  # draws of no weight
        tail = pareto_shape(np.log(before.worst))
    worth = np.where(np.isfinite(before.log_evidence), effective(before.worst), 0.0)
    return Recombined(found[-1], before.log_evidence, CAUTION * off + FLOOR, worth, tail)


def apart(target: Target, laws: Laws, others: Laws) -> Array:
    """The divergence of the worst marginal's moments from those under other laws, (runs,)."""
    found = np.zeros(laws.weights.shape[1])
    for scope in target.scopes:
        own, other = (marginal(each, scope, target.angles) for each in (laws, others))
        found = np.maximum(found, worst(own, other, target.angles[scope.places]))
    return found
