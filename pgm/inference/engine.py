"""Running a schedule of messages on a cluster graph."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, overload

from pgm.clustergraph import ClusterGraph
from pgm.compile import SliceGraph, compile
from pgm.errors import EvidenceError, GraphError, ModelError
from pgm.evidence import Evidence
from pgm.inference import discrete, gaussian
from pgm.inference.chain.posterior import ChainPosterior
from pgm.inference.chain.run import bind_chain
from pgm.inference.chain.run import run as run_chain
from pgm.inference.damping import Damping
from pgm.inference.posterior import Posterior
from pgm.inference.schedule import Calibration, Filtering, Schedule, Smoothing
from pgm.inference.start import Start
from pgm.linearisers import TAYLOR, Lineariser
from pgm.networks import DynamicBayesianNetwork


@overload
def infer(
    graph: SliceGraph,
    evidence: Evidence,
    *,
    schedule: Schedule | None = None,
    lineariser: Lineariser = TAYLOR,
    start: Start | None = None,
) -> ChainPosterior: ...


@overload
def infer(
    graph: ClusterGraph,
    evidence: Evidence,
    *,
    schedule: Schedule | None = None,
    lineariser: Lineariser = TAYLOR,
    start: Start | None = None,
) -> Posterior: ...


def infer(
    graph: ClusterGraph,
    evidence: Evidence,
    *,
    schedule: Schedule | None = None,
    lineariser: Lineariser = TAYLOR,
    start: Start | None = None,
) -> Posterior:
    """Send the messages of a schedule on a cluster graph.

    Parameters
    ----------
    graph : ClusterGraph
        From `compile`, or made by hand.
    evidence : mapping of Variable
        For a dynamic network arrays (..., T, d), `constant` or `sightings`, by variable. For
        others values (..., d) of continuous variables; of discrete ones the name or index of a
        state, an array of indices with −1 for "not observed in this run", or `soft` weights.
        Leading axes are runs.
    schedule : Filtering, Calibration, Smoothing, Flooding, Sequential or Residual, optional
        Without, `Smoothing()` for a dynamic network and `Calibration()` for a tree; a graph with
        loops needs one of the last three.
    lineariser : Lineariser, optional
        For every nonlinear CPD that has none of its own; `Taylor()` if not given.
    start : mapping of Variable to array_like, optional
        Means at which everything is linearised first, in place of the beliefs at hand: (..., d)
        of the variables without evidence; of a dynamic network (..., T+1, d) of the states,
        (..., T, d) of hidden controls.

    Returns
    -------
    Posterior

    Raises
    ------
    EvidenceError
        If the evidence does not fit the model or the graph, or is impossible.
    GraphError
        If a cluster is too large, or the schedule does not suit the graph.
    ModelError
        If a function returns a wrong shape.
    LinearisationError, NumericalError
        If a number that is needed does not exist.
    """
    if not isinstance(graph, ClusterGraph):
        raise GraphError(f"infer takes a cluster graph (pgm.compile(network, ...)), not {graph!r}")
    if not isinstance(evidence, Mapping):
        raise EvidenceError(f"evidence maps variables to values; found {type(evidence).__name__}")
    _require_lineariser(lineariser)
    if schedule is not None and not isinstance(schedule, Schedule):
        raise ModelError(
            f"{schedule!r} is no schedule; give one like pgm.Smoothing() or pgm.Flooding()"
        )
    if isinstance(graph, SliceGraph):
        bound = bind_chain(graph.model, evidence, graph.steps)
        return run_chain(graph, bound, schedule, lineariser, start)
    if isinstance(schedule, Filtering):
        raise GraphError("only a dynamic network is filtered; leave the schedule out for a tree")
    if isinstance(schedule, Smoothing) and schedule.damping:
        raise GraphError(
            f"{schedule!r}: the damping of linearisation points is for dynamic networks; on other "
            "graphs pgm.Flooding(damping=...) damps messages"
        )
    if schedule is None and not graph.is_tree:
        raise GraphError(
            f"{graph!r} has loops, on which messages go round: say how, schedule=pgm.Flooding(), "
            "pgm.Sequential() or pgm.Residual()"
        )
    if isinstance(schedule, Calibration) and not graph.is_tree:
        raise GraphError(
            f"{graph!r} has loops, and {schedule!r} is for trees; give schedule=pgm.Flooding(), "
            "pgm.Sequential() or pgm.Residual()"
        )
    if graph.network.discrete:
        if start is not None:
            raise EvidenceError("a start is for nonlinear CPDs; a discrete network has none")
        return discrete.run(graph, evidence, schedule)
    return gaussian.run(graph, evidence, schedule, lineariser, start)


def _require_lineariser(lineariser: Any) -> None:
    if not callable(lineariser) or isinstance(lineariser, type):
        raise ModelError(f"{lineariser!r} is no lineariser; give one like pgm.Taylor()")


def filter(
    model: DynamicBayesianNetwork,
    evidence: Evidence,
    *,
    lineariser: Lineariser = TAYLOR,
    steps: int | None = None,
    iterations: int = 1,
    tolerance: float = 1e-9,
    damping: Damping = 0.0,
) -> ChainPosterior:
    """Compile a network and filter: `infer` with `Filtering(iterations, tolerance, damping)`.

    Parameters
    ----------
    model : DynamicBayesianNetwork
    evidence : mapping of Variable
        As for `infer`.
    lineariser : Lineariser, optional
        `Taylor()` if not given.
    steps : int, optional
        T, where no plain array of the evidence tells.
    iterations, tolerance, damping
        Of `Filtering`.
    """
    schedule = Filtering(iterations, tolerance, damping)
    _require_lineariser(lineariser)
    bound = bind_chain(model, evidence, steps)
    return run_chain(compile(model, bound.steps), bound, schedule, lineariser, None)


def smooth(
    model: DynamicBayesianNetwork,
    evidence: Evidence,
    *,
    lineariser: Lineariser = TAYLOR,
    steps: int | None = None,
    start: Start | None = None,
    iterations: int = 1,
    tolerance: float = 1e-9,
    damping: Damping = 0.0,
) -> ChainPosterior:
    """Compile a network and smooth: `infer` with `Smoothing(iterations, tolerance, damping)`.

    Parameters
    ----------
    model : DynamicBayesianNetwork
    evidence : mapping of Variable
        As for `infer`.
    lineariser : Lineariser, optional
        `Taylor()` if not given.
    steps : int, optional
        T, where no plain array of the evidence tells.
    start : mapping of Variable to array_like, optional
        As for `infer`.
    iterations, tolerance, damping
        Of `Smoothing`.
    """
    schedule = Smoothing(iterations, tolerance, damping)
    _require_lineariser(lineariser)
    bound = bind_chain(model, evidence, steps)
    return run_chain(compile(model, bound.steps), bound, schedule, lineariser, start)
