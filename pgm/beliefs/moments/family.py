"""Gaussian beliefs, as a family of beliefs: the default of continuous variables."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, ClassVar

from pgm.beliefs import gaussian
from pgm.beliefs.moments.online.moment_steps import MomentSteps
from pgm.beliefs.moments.outcomes.families import family_beliefs
from pgm.beliefs.moments.outcomes.outcome import ChainOutcome
from pgm.beliefs.moments.parts.run import run
from pgm.beliefs.own.family import BeliefFamily
from pgm.clustergraph import ClusterGraph
from pgm.compile import DynamicGraph
from pgm.evidence import BoundEvidence, Evidence
from pgm.factors import Gaussian
from pgm.networks import DynamicBayesianNetwork
from pgm.posteriors.expectations import Expectations, Learnable
from pgm.posteriors.outcome import Outcome
from pgm.schedules.options import Call


class Moments(BeliefFamily[Gaussian]):
    """Means and covariances: filters and smoothers of the Kalman kind, and Gaussian networks."""

    takes: ClassVar[frozenset[str]] = frozenset(
        {
            *("lineariser", "start", "keep", "executor", "compiled", "method"),
            *("gate", "iterations", "damping", "schedule", "lag", "watch"),
        }
    )
    beliefs: ClassVar[str] = "Gaussian beliefs"
    spare: ClassVar[str] = "is not for Gaussian beliefs"
    by_pattern: ClassVar[bool] = True
    by_modes: ClassVar[bool] = True

    # The moments of all slices, or of the variables to keep.
    infer = staticmethod(run)

    def infer_to_learn(
        self, graph: DynamicGraph, bound: BoundEvidence, call: Call, *, by_score: bool = False
    ) -> tuple[Outcome[Gaussian], Callable[[Sequence[Learnable]], Expectations]]:
        """The moments, and the smoothed beliefs of all families."""
        outcome = run(graph, bound, call)
        assert isinstance(outcome, ChainOutcome)  # nothing is asked to be kept alone
        return outcome, lambda parts: family_beliefs(outcome, by_score=by_score)

    def infer_static(
        self, graph: ClusterGraph, evidence: Evidence, call: Call
    ) -> Outcome[Gaussian]:
        """The moments of a network without time."""
        options = call.schedule, call.lineariser, call.start
        return gaussian.run_factors(graph, evidence, *options, warn=call.tells)

    def online(self, model: DynamicBayesianNetwork, options: dict[str, Any]) -> MomentSteps:
        """The steps of a Kalman filter, in machine code where that was asked for."""
        return MomentSteps(model, **options)


MOMENTS = Moments()
