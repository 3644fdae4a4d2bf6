"""The most probable path of a mixed chain's discrete variables, by a beam of paths.

A hypothesis is a path of the discrete variables so far, with the Gaussian of the continuous ones
given it, as a filter linearises it. Each step keeps the likeliest hypotheses and leaves the others
out, where a filter merges them. Where none was left out, and nothing was linearised, the path is
the most probable one; else it is the likeliest of those that were kept to the end.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pgm.beliefs.hypotheses.counts import leading
from pgm.beliefs.hypotheses.forward import chain_of
from pgm.beliefs.hypotheses.records import Asked, Belief, State
from pgm.cpds import AffineCPD
from pgm.cpds.caused import is_mixture
from pgm.errors import GraphError
from pgm.evidence import BoundEvidence
from pgm.kernels.arrays import Array, Integers, Mask
from pgm.linearisers import TAYLOR
from pgm.networks import DynamicBayesianNetwork
from pgm.schedules import sweep
from pgm.schedules.schedule import Filtering
from pgm.variables import Discrete


class Path(NamedTuple):
    """The path of each hidden discrete variable, (runs, T+1), its states by index.

    log_probability: ln p(path, measurements), (runs,).
    exact: Whether no other path was left out, no CPD linearised and no noise robust, (runs,).
    """

    states: dict[Discrete, Integers]
    log_probability: Array
    exact: Mask


def most_probable_path(model: DynamicBayesianNetwork, bound: BoundEvidence, count: int) -> Path:
    """The most probable path of a network's discrete variables among so many that are kept."""
    asked = Asked(count, mix=False, prune=True)
    components = [cpd for cpd in (*model.prior, *model.transition) if is_mixture(cpd)]
    if not components:
        chain = chain_of(model, bound, asked, TAYLOR, Filtering())
        components = [each.cpd for each in chain.roles.open if is_mixture(each.cpd)]
    if components:
        raise GraphError(
            f"{components[0]!r} is a mixture, or has robust noise, and the component that each of "
            "its values is of is on no path of discrete variables: make it a state of one, with a "
            "pgm.SwitchingCPD; or take pgm.smooth, which sums over them"
        )
    if chain.roles.open:
        raise GraphError(
            "most_probable finds a path of discrete variables, and here sightings leave open what "
            "was seen; pgm.smooth sums over that, and posterior.associations tells of it"
        )
    if not chain.regimes.hidden:
        raise GraphError(
            "most_probable finds a path of hidden discrete variables, and here there is none; the "
            "most probable path of continuous states is the mean of pgm.smooth"
        )
    record = _Record()
    sweep.forward(chain, bound.steps, record)
    assert record.last is not None
    logs = leading(record.last.logs, record.last.counts, 0)
    runs, size = np.arange(bound.runs), chain.regimes.size
    at = logs.argmax(axis=0)
    total = np.sum(record.log_densities, axis=0) + logs[at, runs]
    path = np.empty((bound.steps + 1, bound.runs), dtype=np.intp)
    for step in range(bound.steps, -1, -1):
        at, path[step] = np.divmod(chain.chosen[step][at, runs], size)
    found = {
        variable: np.ascontiguousarray(chain.regimes.states(variable)[path].T)
        for variable in chain.regimes.hidden
    }
    roles = chain.roles
    exact = roles.robust is None and all(isinstance(case, AffineCPD) for case in roles.cases)
    return Path(found, total, ~chain.left_out & exact)


class _Record:
    """The log-densities of a forward sweep, and its last belief."""

    def __init__(self) -> None:
        self.last: Belief | None = None
        self.log_densities: list[Array] = []

    def keep(self, step: int, predicted: State, known: State, log_density: Array | float) -> None:
        assert isinstance(known, Belief)
        self.last = known
        self.log_densities.append(np.asarray(log_density))
