"""Calls whose evidence lies on a card, of which the card is asked for."""

from __future__ import annotations

from typing import Any

from pgm.beliefs.moments.solvers.on_card import solved
from pgm.compile import DynamicGraph
from pgm.compile.machine import as_choice, is_for_card
from pgm.errors import EvidenceError
from pgm.evidence.on_card import lies_there
from pgm.inference.families import family_of
from pgm.networks import DynamicBayesianNetwork
from pgm.posteriors.posterior import Posterior
from pgm.schedules.options import Call


def solved_there(
    model: Any,
    evidence: Any,
    steps: int | None,
    call: Call,
    belief: object,
    graph: DynamicGraph | None = None,
) -> Posterior[Any] | None:
    """The posterior of a call whose evidence lies on a card, with beliefs there.

    None where the evidence does not lie there, or ``call.compiled`` asks for no card. What is not
    done there is refused with an EvidenceError. `graph` is the user's, None to compile the model.
    """
    if not is_for_card(call.compiled) or not lies_there(evidence):
        return None
    if not isinstance(model, DynamicBayesianNetwork):
        return None
    as_choice(call.compiled, "pgm.infer(...)", card=True)
    if belief is not None:
        raise EvidenceError(
            f"evidence that lies on a card has Gaussian beliefs there, not {belief!r}"
        )
    return solved(model, evidence, steps, call, family_of(model).infer, graph)
