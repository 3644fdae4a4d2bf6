"""Tables of discrete variables, as a family of beliefs: the only one of discrete networks."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, ClassVar

from pgm.beliefs import discrete
from pgm.beliefs.markov.counts import expectations
from pgm.beliefs.markov.online import online_tables
from pgm.beliefs.markov.run import run
from pgm.beliefs.own.family import BeliefFamily
from pgm.clustergraph import ClusterGraph
from pgm.compile import DynamicGraph
from pgm.compile.machine import without_machine_code
from pgm.errors import EvidenceError, ModelError, PgmError
from pgm.evidence import BoundEvidence, Evidence
from pgm.factors import Table
from pgm.networks import DynamicBayesianNetwork
from pgm.posteriors.expectations import Expectations, Learnable
from pgm.posteriors.outcome import Outcome
from pgm.schedules.options import Call


class Tables(BeliefFamily[Table]):
    """Probabilities of all states: hidden Markov chains, and discrete networks."""

    takes: ClassVar[frozenset[str]] = frozenset({"impossible", "memory", "schedule", "lag"})
    beliefs: ClassVar[str] = "tables"
    spare: ClassVar[str] = (
        "is for networks of Gaussian CPDs, and this one is of tables, which linearises nothing"
    )

    def refusal(self, option: str, of: object) -> PgmError:
        """The error for an option that tables have no use for, with the remedy."""
        if option == "compiled":
            return without_machine_code("tables", of)
        if option in ("gate", "watch"):
            return ModelError(
                f"{option}= is for beliefs that are Gaussian, whose innovations have a "
                "covariance: leave it out"
            )
        if option == "start":
            return EvidenceError("a start is for nonlinear CPDs; a discrete network has none")
        return super().refusal(option, of)

    def infer(self, graph: DynamicGraph, bound: BoundEvidence, call: Call) -> Outcome[Table]:
        """The tables of all slices."""
        return run(graph, bound, call.schedule, call.impossible)

    def infer_to_learn(
        self, graph: DynamicGraph, bound: BoundEvidence, call: Call, *, by_score: bool = False
    ) -> tuple[Outcome[Table], Callable[[Sequence[Learnable]], Expectations]]:
        """The tables, and their expected counts."""
        outcome = run(graph, bound, call.schedule, call.impossible)
        return outcome, lambda parts: expectations(outcome, parts, call.lineariser)

    def infer_static(self, graph: ClusterGraph, evidence: Evidence, call: Call) -> Outcome[Table]:
        """The tables of a network without time."""
        return discrete.run(graph, evidence, call.schedule, call.memory, call.impossible)

    def online(self, model: DynamicBayesianNetwork, options: dict[str, Any]) -> Any:
        """The filter of one step at a time."""
        return online_tables(model, **options)


TABLES = Tables()
