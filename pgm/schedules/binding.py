"""The evidence of a call, bound to the CPDs of a dynamic network."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pgm.compile.machine import Choice
from pgm.display import titled
from pgm.errors import EvidenceError, ModelError
from pgm.evidence import BoundEvidence, Evidence, bind
from pgm.networks import DynamicBayesianNetwork


def bind_chain(
    model: Any,
    evidence: Evidence,
    steps: int | None,
    *,
    identities: bool = False,
    among: bool = False,
    compiled: Choice = None,
) -> BoundEvidence:
    """The evidence of a dynamic network, checked and laid out by step.

    `steps` is T, None for that of the evidence; `identities` allows measurements of unknown
    identity (`pgm.unknown`), `among` hidden variables as candidates, too; `compiled` tells how many
    threads may lay it out. A model that is not dynamic is refused with a ModelError, evidence that
    is no mapping or does not fit with an EvidenceError.
    """
    if not isinstance(model, DynamicBayesianNetwork):
        raise ModelError(f"a dynamic network was due, not {titled(model)}")
    if not isinstance(evidence, Mapping):
        raise EvidenceError(f"evidence maps variables to values; found {type(evidence).__name__}")
    cpds = model.transition, model.observation
    threads = getattr(compiled, "threads", 1)
    return bind(
        *cpds,
        evidence,
        steps,
        model.lead,
        identities=identities,
        among=frozenset(cpd.child for cpd in model.transition) if among else (),
        threads=threads,
        forecasts=True,
    )
