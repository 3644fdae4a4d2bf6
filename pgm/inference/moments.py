"""Gaussian beliefs, as a family of beliefs: the default of continuous variables."""

from __future__ import annotations

from typing import Any, ClassVar

from pgm.clustergraph import ClusterGraph
from pgm.evidence import Evidence
from pgm.factors import Gaussian
from pgm.inference import gaussian
from pgm.inference.belief_family import BeliefFamily
from pgm.inference.online.moment_steps import MomentSteps
from pgm.inference.options import Call
from pgm.inference.outcome import Outcome
from pgm.inference.parts.run import run
from pgm.networks import DynamicBayesianNetwork


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

    # The moments of all slices, or of the variables to keep.
    infer = staticmethod(run)

    def infer_static(
        self, graph: ClusterGraph, evidence: Evidence, call: Call
    ) -> Outcome[Gaussian]:
        """The moments of a network without time."""
        return gaussian.run(graph, evidence, call.schedule, call.lineariser, call.start)

    def online(self, model: DynamicBayesianNetwork, options: dict[str, Any]) -> MomentSteps:
        """The steps of a Kalman filter, in machine code where that was asked for."""
        return MomentSteps(model, **options)


MOMENTS = Moments()
