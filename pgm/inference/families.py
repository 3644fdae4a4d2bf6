"""The family of beliefs of a call: the one that the user gives, or that of the network's CPDs.

And the posterior of what it answers.
"""

from __future__ import annotations

from typing import Any

from pgm.beliefs.hypotheses.family import GAUSSIANS
from pgm.beliefs.markov.family import TABLES
from pgm.beliefs.mixed import MIXED
from pgm.beliefs.moments.family import MOMENTS
from pgm.beliefs.own.family import BeliefFamily, require_family
from pgm.cpds.caused import has_mixtures
from pgm.display import titled
from pgm.errors import ModelError
from pgm.evidence import BoundEvidence
from pgm.networks import DynamicBayesianNetwork
from pgm.posteriors.associations import is_summed
from pgm.posteriors.outcome import B, Outcome
from pgm.posteriors.posterior import Posterior


def family_of(
    model: Any, belief: BeliefFamily[B] | None = None, bound: BoundEvidence | None = None
) -> BeliefFamily[B]:
    """The given family, or tables of a discrete network, mixtures of a mixed one, or moments.

    Mixtures of Gaussians are also the beliefs of a continuous network that has a `MixtureCPD`; and
    evidence, if it is `bound`, asks for them where it leaves open which of several hidden
    variables was seen, or has candidates that are to be summed over. A `belief` that is no family,
    or a model that cannot have it, is a ModelError.
    """
    if belief is not None:
        require_family(belief, model)
        return belief
    # B is Any here, as it is of every call without belief=: which one the network decides.
    found: BeliefFamily[Any] = TABLES if model.discrete else MOMENTS
    several = model.mixed or (not model.discrete and has_mixtures(model.cpds))
    if isinstance(model, DynamicBayesianNetwork):
        return GAUSSIANS if several or (bound is not None and is_summed(bound)) else found
    return MIXED if several else found


def answered(family: BeliefFamily[B], outcome: Outcome[B]) -> Posterior[B]:
    """The posterior of a family's outcome; a ModelError refuses what is no `Outcome`."""
    if not isinstance(outcome, Outcome):
        raise ModelError(
            f"{family!r}: infer(graph, bound, call) returned {titled(outcome)}; an Outcome of "
            "pgm.posteriors.outcome was due"
        )
    return Posterior(outcome)
