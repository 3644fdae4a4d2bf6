"""Running a schedule on a dynamic network, with the family of beliefs that it takes."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from pgm.compile import DynamicGraph
from pgm.errors import EvidenceError, ModelError
from pgm.evidence import BoundEvidence
from pgm.inference.chain.marginals import KeptPosterior
from pgm.inference.chain.posterior import ChainPosterior
from pgm.inference.markov.posterior import StatePosterior
from pgm.inference.markov.run import run as run_tables
from pgm.inference.parts.run import Keep
from pgm.inference.parts.run import run as run_moments
from pgm.inference.schedule import Schedule
from pgm.inference.start import Start
from pgm.linearisers import Lineariser
from pgm.networks import DynamicBayesianNetwork

if TYPE_CHECKING:
    from concurrent.futures import Executor

TemporalPosterior = ChainPosterior | KeptPosterior | StatePosterior


def runner(model: DynamicBayesianNetwork) -> Callable[..., TemporalPosterior]:
    """The function that sends the messages: moments of Gaussians, or tables of discrete states."""
    return _run_tables if model.discrete else run_moments


def _run_tables(
    graph: DynamicGraph,
    bound: BoundEvidence,
    schedule: Schedule | None,
    lineariser: Lineariser,
    start: Start | None,
    keep: Keep | None,
    executor: Executor | None,
) -> StatePosterior:
    if start is not None:
        raise EvidenceError("a start is for nonlinear CPDs; a discrete network has none")
    if keep is not None or executor is not None:
        name = "keep" if keep is not None else "executor"
        raise ModelError(f"{name}= is for networks of Gaussian CPDs, and this one is of tables")
    return run_tables(graph, bound, schedule)
