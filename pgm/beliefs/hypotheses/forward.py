"""The forward pass of a mixed chain: made for a network and its evidence, and kept by step."""

from __future__ import annotations

import numpy as np

from pgm.beliefs.hypotheses.back import BackwardChain
from pgm.beliefs.hypotheses.cases import Given
from pgm.beliefs.hypotheses.chain import HypothesisChain
from pgm.beliefs.hypotheses.records import Asked, Belief, Settings, State, Swept
from pgm.beliefs.hypotheses.regimes import Regimes
from pgm.beliefs.hypotheses.roles import Roles, roles_of
from pgm.compile import DynamicGraph
from pgm.errors import GraphError, ModelError
from pgm.evidence import BoundEvidence
from pgm.factors.scope import listed
from pgm.kernels.arrays import Array, components_last
from pgm.linearisers import Lineariser
from pgm.networks import DynamicBayesianNetwork
from pgm.resources import require_memory
from pgm.schedules import sweep
from pgm.schedules.options import Call
from pgm.schedules.schedule import Filtering


def chain_of(
    model: DynamicBayesianNetwork,
    bound: BoundEvidence,
    asked: Asked,
    lineariser: Lineariser,
    schedule: Filtering,
    *,
    first: int = 0,
    back: bool = False,
) -> HypothesisChain:
    """The forward pass of a network with its evidence, which begins at step `first`."""
    regimes = Regimes(model, bound, first)
    settings = _settings(asked, regimes, back=back)
    hidden = tuple(cpd.child for cpd in model.transition if not cpd.discrete)
    given = Given(bound, hidden, frozenset(model.states), lineariser, schedule, first)
    several = regimes.hidden or asked.pieces > 1
    roles = roles_of(model, bound, regimes.hidden if several else None)
    _require_room(given, regimes, roles, settings)
    return HypothesisChain(given, regimes, roles, settings)


def _settings(asked: Asked, regimes: Regimes, *, back: bool) -> Settings:
    count = regimes.memories if asked.count is None else asked.count
    kept = regimes.remembered
    if asked.prune:
        return Settings(count, mix=False, back=back, prune=True)
    if count < regimes.memories:
        raise ModelError(
            f"{count} Gaussian{'s' * (count > 1)} for ({listed(kept)}), whose states the next step "
            f"depends on: these have {regimes.memories} joint states, each of which keeps one at "
            f"least; give a count of {regimes.memories} or more"
        )
    if asked.mix and count != regimes.memories:
        raise ModelError(
            f"mix=True keeps a Gaussian for each joint state of ({listed(kept)}), "
            f"{regimes.memories} in all, not {count}: leave the count out, or mix"
        )
    return Settings(count, asked.mix, back, asked.pieces)


def _require_room(given: Given, regimes: Regimes, roles: Roles, settings: Settings) -> None:
    """Refuse beliefs, and the divergences by which members are merged, that would not fit."""
    size = sum(v.dimension for v in given.hidden)
    alternatives = [1 + r.unknown[1].count for r in roles.open if r.unknown is not None]
    copies = max([regimes.size, *alternatives])
    bound, pairs = given.bound, max(settings.count, settings.pieces) * copies
    each = settings.count * (1 + size + size * size)
    if settings.back:
        each = 2 * each + 2 * pairs * (2 + size + size * size)
    merging = 0 if settings.prune else 4 * pairs * settings.count
    if not settings.prune and settings.count != regimes.memories:
        merging += 2 * pairs * pairs
    passing = merging + 8 * pairs * (size + 1) ** 2
    if settings.prune:  # of each step it is kept alone which pairs were
        passing, each = passing + each, settings.count
    require_memory(
        bound.runs * ((bound.steps + 1) * each + passing),
        f"the beliefs of {settings.count:,} Gaussians with {regimes.size:,} joint states of "
        f"({listed(regimes.variables)}) at {bound.steps + 1:,} steps in {bound.runs:,} runs",
        "keep fewer Gaussians, cut the prior into fewer pieces, or give fewer runs or steps",
        error=GraphError,
    )


class Record:
    """The beliefs and log-densities of a forward sweep."""

    def __init__(self, chain: HypothesisChain) -> None:
        self._chain = chain
        self.known: list[Belief] = []
        self.log_densities: list[Array] = []

    def keep(self, step: int, predicted: State, known: State, log_density: Array | float) -> None:
        """Keep a step, as of `sweep.Record`; of pieces of the prior what they merge into."""
        assert isinstance(known, Belief)
        self.known.append(self._chain.reduced(known))
        self.log_densities.append(np.asarray(log_density))

    @property
    def swept(self) -> Swept:
        """The sweep by step."""
        known = self.known
        return Swept(
            np.stack([each.shares for each in known]),
            np.stack([components_last(each.mean, 1) for each in known]),
            np.stack([components_last(each.cov, 2) for each in known]),
            np.stack(self._chain.regime_logs),
            np.stack(self.log_densities),
        )


def again(graph: DynamicGraph, bound: BoundEvidence, call: Call, asked: Asked) -> BackwardChain:
    """The pass back of a call's smoother, over its forward pass."""
    chain = chain_of(graph.model, bound, asked, call.lineariser, Filtering(), back=True)
    sweep.forward(chain, bound.steps, Record(chain))
    return BackwardChain(chain)
