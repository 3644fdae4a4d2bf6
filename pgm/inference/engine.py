"""Running a schedule of messages on a cluster graph, with the kind of beliefs that it takes.

Beliefs are tables of discrete variables, or Gaussians of continuous ones. Of a dynamic network of
continuous variables they may also be *point masses*: the cells of a grid, or particles. The
arguments of all functions are these, in a few words; `infer` tells more:

- `schedule` says which messages are sent in which order, and how often CPDs are linearised; None
  for both passes, forward and back, over a chain or tree.
- `lineariser` is for the nonlinear CPDs that have none of their own.
- `start` has means, by variable, at which everything is linearised first; None for the beliefs at
  hand.
- `keep` names the variables of a dynamic network whose marginals are kept; None for all.
- `executor` is a pool of processes or threads that works on parts of the runs; None for none.
- `memory` is the number of bytes that the tables of all runs may take; None for 256 MiB.
- `belief` is a `Grid` or `Particles`, for point masses; None for tables or Gaussians.
- `progress` says whether bars show how far the work is.
- `impossible` says what is done with runs whose evidence has probability zero, if the network is
  discrete: ``"raise"``, the default, refuses the evidence; ``"allow"`` gives such runs NaN.
- `bound` is the evidence, checked and laid out by CPD and step.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from functools import partial
from typing import TYPE_CHECKING, Any, TypedDict, Unpack, overload

from pgm.arguments import public
from pgm.clustergraph import ClusterGraph
from pgm.compile import DynamicGraph
from pgm.display import titled
from pgm.errors import EvidenceError, GraphError, ModelError
from pgm.evidence import BoundEvidence, Evidence
from pgm.inference import discrete, gaussian
from pgm.inference.argument_checks import require_lineariser
from pgm.inference.associations import by_density
from pgm.inference.chain.kept_posterior import KeptPosterior
from pgm.inference.chain.posterior import ChainPosterior
from pgm.inference.chain.run import bind_chain
from pgm.inference.convergence import told
from pgm.inference.grid.online import OnlineGrid
from pgm.inference.grid.posterior import GridPosterior
from pgm.inference.grid.run import run as run_grid
from pgm.inference.grid.value import Grid
from pgm.inference.impossible import RAISE
from pgm.inference.markov.posterior import StatePosterior
from pgm.inference.markov.run import run as run_tables
from pgm.inference.particles.online import OnlineParticles
from pgm.inference.particles.posterior import ParticlePosterior
from pgm.inference.particles.run import run as run_particles
from pgm.inference.particles.value import Particles
from pgm.inference.parts.run import Keep
from pgm.inference.parts.run import run as run_moments
from pgm.inference.posterior import Posterior
from pgm.inference.schedule import ONCE, Filtering, FixedLag, Loopy, Schedule, Smoothing
from pgm.inference.starting_points import Start
from pgm.linearisers import TAYLOR, Lineariser
from pgm.networks import DynamicBayesianNetwork
from pgm.progress import Progress, reporting
from pgm.variables import Variable

if TYPE_CHECKING:
    from concurrent.futures import Executor

PointMasses = Grid | Particles


def online_points(
    belief: PointMasses,
    model: Any,
    lineariser: Any = TAYLOR,
    schedule: Any = None,
    lag: int | None = None,
) -> OnlineGrid | OnlineParticles:
    """The online filter whose beliefs are a grid or particles.

    A lineariser, schedule or lag other than the default is refused by a `ModelError`, since such a
    filter has no use for it. So is a model that is no dynamic network of continuous variables.
    """
    require_points(belief, model)
    asked = None if schedule == ONCE else schedule
    require_no_others(belief, lineariser, schedule=asked, lag=lag)
    if isinstance(belief, Grid):
        return OnlineGrid(model, belief)
    return OnlineParticles(model, belief)


def require_points(belief: Any, model: Any) -> None:
    """Refuse a `belief` that is no `Grid` and no `Particles`, or a model that cannot have it.

    The model has to be a dynamic network of continuous variables. The error is a `ModelError`.
    """
    if not isinstance(belief, Grid | Particles):
        raise ModelError(f"belief= is a pgm.Grid(...) or pgm.Particles(...), not {titled(belief)}")
    if not isinstance(model, DynamicBayesianNetwork):
        raise ModelError(f"a dynamic network was due, not {titled(model)}")
    if model.discrete:
        raise ModelError(
            "a network of tables has the probabilities of its states, exactly: leave belief= out"
        )


def require_no_others(belief: PointMasses, lineariser: Any, **given: Any) -> None:
    """Refuse arguments that are for Gaussian beliefs alone, where `belief` is a grid or particles.

    `given` are such arguments by name, and each has to be None, as if left out. The lineariser has
    to be `Taylor()`, the default. The error is a `ModelError`.
    """
    named = [name for name, value in given.items() if value is not None]
    if lineariser is not TAYLOR and lineariser != TAYLOR:
        named.insert(0, "lineariser")
    if named and isinstance(belief, Grid):
        raise ModelError(
            f"{named[0]}= is for beliefs that are Gaussian; a grid linearises nothing, has no lag "
            "online, and works one run after another: leave it out"
        )
    if named:
        raise ModelError(
            f"{named[0]}= is for beliefs that are Gaussian; particles linearise nothing, are of "
            "all runs at once, and have no lag online: leave it out"
        )


PointPosterior = GridPosterior | ParticlePosterior
TemporalPosterior = ChainPosterior | KeptPosterior | StatePosterior | PointPosterior


def runner(
    model: DynamicBayesianNetwork, belief: PointMasses | None = None, impossible: str = RAISE
) -> Callable[..., TemporalPosterior]:
    """The function that runs a schedule of a dynamic network with one kind of beliefs.

    It takes, in this order, the graph, the bound evidence, the schedule, lineariser, start, keep
    and executor, and returns the posterior: of point masses if there is a `belief`, else of tables
    if the model is discrete, else of Gaussians. `impossible` counts for tables alone. A `belief` of
    a wrong type, or for a model that is not of continuous variables over time, is a `ModelError`.
    """
    if belief is not None:
        require_points(belief, model)
        return partial(_run_points, belief)
    return partial(_run_tables, impossible=impossible) if model.discrete else run_moments


def require_tables(model: Any, impossible: str, belief: Any) -> None:
    """Refuse an argument `impossible` other than the default for a network that is not discrete.

    `model` is a network or its graph; the default is ``"raise"``. The error is a `GraphError`. If
    `belief` is a `Particles`, the error's text tells that `Particles` itself has an argument
    `impossible`.
    """
    if impossible == RAISE or getattr(model, "network", model).discrete:
        return
    advice = ": leave it out"
    if isinstance(belief, Particles):
        advice = (
            '; particles have their own, pgm.Particles(..., impossible="restart"): leave it out'
        )
    raise GraphError(
        f"impossible= is for the runs of discrete networks, not for {titled(model)}{advice}"
    )


def _run_points(
    belief: PointMasses,
    graph: DynamicGraph,
    bound: BoundEvidence,
    schedule: Schedule | None,
    lineariser: Lineariser,
    start: Start | None,
    keep: Keep | None,
    executor: Executor | None,
) -> PointPosterior:
    """The posterior of a grid or particles; arguments for Gaussian beliefs alone are refused.

    Refused, by a `ModelError`, are a start, keep, an executor, a lineariser other than `Taylor()`,
    and a graph that was compiled for sweeps in machine code. Measurements of unknown identity that
    are to be associated all together are an `EvidenceError`.
    """
    given = {"start": start, "keep": keep, "executor": executor}
    require_no_others(belief, lineariser, **given, compiled=graph.layout.compiled or None)
    bound = by_density(bound)
    if isinstance(belief, Grid):
        return run_grid(graph, bound, schedule, belief)
    return run_particles(graph, bound, schedule, belief)


def _run_tables(
    graph: DynamicGraph,
    bound: BoundEvidence,
    schedule: Schedule | None,
    lineariser: Lineariser,
    start: Start | None,
    keep: Keep | None,
    executor: Executor | None,
    *,
    impossible: str,
) -> StatePosterior:
    """The posterior of a discrete network; arguments for Gaussian CPDs alone are refused.

    A start is refused by an `EvidenceError`; keep, an executor, and a lineariser other than
    `Taylor()` are refused by a `ModelError`.
    """
    if start is not None:
        raise EvidenceError("a start is for nonlinear CPDs; a discrete network has none")
    given = {"keep": keep, "executor": executor}
    named = [name for name, value in given.items() if value is not None]
    if lineariser != TAYLOR:
        named.append("lineariser")
    if named:
        raise ModelError(f"{named[0]}= is for networks of Gaussian CPDs, and this one is of tables")
    return run_tables(graph, bound, schedule, impossible)


CONTINUOUS = (
    "memory= is for the runs of discrete networks; of a dynamic network keep=[x] holds fewer at a "
    "time, and of others fewer runs to a call do"
)


class _Options(TypedDict, total=False):
    """The options that `infer` takes with every kind of belief; for each see the module."""

    schedule: Schedule | None
    lineariser: Lineariser
    start: Start | None
    progress: Progress
    impossible: str


@overload
def infer(
    graph: DynamicGraph, evidence: Evidence, *, belief: Grid, **options: Unpack[_Options]
) -> GridPosterior: ...


@overload
def infer(
    graph: DynamicGraph,
    evidence: Evidence,
    *,
    keep: None = None,
    executor: Executor | None = None,
    memory: float | None = None,
    belief: None = None,
    **options: Unpack[_Options],
) -> ChainPosterior: ...


@overload
def infer(
    graph: DynamicGraph,
    evidence: Evidence,
    *,
    keep: Variable | Iterable[Variable],
    executor: Executor | None = None,
    memory: float | None = None,
    belief: None = None,
    **options: Unpack[_Options],
) -> KeptPosterior: ...


@overload
def infer(
    graph: ClusterGraph,
    evidence: Evidence,
    *,
    keep: Variable | Iterable[Variable] | None = None,
    executor: Executor | None = None,
    memory: float | None = None,
    belief: None = None,
    **options: Unpack[_Options],
) -> Posterior: ...


@overload
def infer(
    graph: DynamicGraph, evidence: Evidence, *, belief: Particles, **options: Unpack[_Options]
) -> ParticlePosterior: ...


@public
def infer(
    graph: ClusterGraph,
    evidence: Evidence,
    *,
    schedule: Schedule | None = None,
    lineariser: Lineariser = TAYLOR,
    start: Start | None = None,
    keep: Variable | Iterable[Variable] | None = None,
    executor: Executor | None = None,
    memory: float | None = None,
    belief: PointMasses | None = None,
    progress: Progress = False,
    impossible: str = RAISE,
) -> Posterior | GridPosterior | ParticlePosterior:
    """Send the messages of a schedule on a cluster graph.

    Parameters
    ----------
    graph : ClusterGraph
        From `compile`, or made by hand.
    evidence : mapping of Variable
        For a dynamic network arrays (..., T, d), `constant` or `sightings`, by variable. For
        others values (..., d) of continuous variables; of discrete ones the name or index of a
        state, an array of indices with −1 for "not observed in this run", or `soft` weights.
        Leading axes are runs. NaN is a component that was not observed, of a sensor's measurement
        or of a variable on which no other depends. `records` makes such a mapping of a table.
    schedule : Schedule, optional
        `Filtering`, `FixedLag` or `Smoothing` for a dynamic network, `Smoothing()` if not given;
        `Calibration()` for a tree; `Flooding`, `Sequential` or `Residual`, which a graph with loops
        needs.
    lineariser : Lineariser, optional
        For every nonlinear CPD that has none of its own; `Taylor()` if not given.
    start : mapping of Variable to array_like, optional
        Means at which everything is linearised first, in place of the beliefs at hand: (..., d)
        of the variables without evidence; of a dynamic network (..., T+1, d) of the states,
        (..., T, d) of hidden controls. Without, a `Balanced` tree is linearised first at dead
        reckoning, where motion alone leads from the prior mean.
    keep : collection of Variable, optional
        For a dynamic network, the hidden variables whose marginals at all steps are kept,
        ``keep=[x]``, with log-evidence and status; without, everything is. The runs are then
        worked through in parts of some hundreds or thousands, and only the parts at work are in
        memory, so that a study of 100,000 simulations fits. With a lineariser that draws points
        afresh for each run all runs are one part.
    executor : concurrent.futures.Executor, optional
        For a dynamic network: a process pool, a thread pool, a Dask client's `get_executor()`, an
        MPI pool. Workers are handed about equally many parts of the runs. Results are those of one
        process. Where a worker fails, the calling process solves again, so that the error is raised
        in it. Functions and classes of a model must stand in modules, by name, since they are
        pickled. On Linux a `ProcessPoolExecutor` shares memory with its caller, kept for the next
        call while the executor lives. Threads gain little, since most calls are short, and need
        functions that are thread-safe. With small states the threads of NumPy's linear algebra only
        get in the way (OMP_NUM_THREADS=1).
    memory : number, optional
        For a discrete network and a graph without loops, how many bytes the tables of all runs may
        take, besides the compiled graph, the evidence, and what is asked for; 2²⁸ (256 MiB), if not
        given. The runs are worked through in parts that fit; the results are the same.
    belief : Grid or Particles, optional
        For a dynamic network of continuous variables: its beliefs as probabilities of the cells of
        a grid, one run after another, or as weighted draws, in place of Gaussians. Nothing is
        linearised then.
    progress : bool or callable
        Whether bars show how far the work is, on a terminal or in a notebook and nowhere else; or a
        function, ``progress(done, total)``, called at the start of each stage and after each of its
        items: steps, linearisations, rounds, runs or parts. An error that it raises ends the call.
    impossible : str
        For a discrete network and a graph without loops, what is done with runs whose evidence has
        probability zero, as where some of many `records` contradict the tables: ``"raise"`` refuses
        the evidence; with ``"allow"`` such runs have a log-evidence of −∞ and beliefs of NaN, and
        all other runs their usual results. Over time a belief is NaN if it knows the first
        impossible measurement: filtered beliefs from its step on, fixed-lag ones from a lag before
        it on, smoothed ones at all steps.

    Returns
    -------
    Posterior
        A `ChainPosterior` of a dynamic network, of tables a `StatePosterior`; a `KeptPosterior`
        with ``keep``, a `GridPosterior` or `ParticlePosterior` with ``belief``.

    Warns
    -----
    ConvergenceWarning
        If a schedule that iterates ends before it settles, in any run.
    PrecisionWarning
        If rounding leaves fewer than six digits of a mean.

    Raises
    ------
    EvidenceError
        If the evidence, `start` or `keep` does not fit the model, or the evidence is impossible
        (``.run`` and, over time, ``.step`` tell where).
    GraphError
        If a cluster is too large, `memory` is too small for a run, or an argument is not for graphs
        of this kind.
    ModelError
        If a function returns a wrong shape, or cannot be pickled for a worker.
    LinearisationError, NumericalError
        If a linearisation, a belief or its log-evidence has no finite value, or the evidence
        contradicts an exact model.
    ExecutorError
        If a worker dies, or the executor takes no work; ``.runs`` tells which runs were lost.

    Examples
    --------
    >>> from pgm.examples import a, b, pair
    >>> posterior = pgm.infer(pgm.compile(pair), {b: [2.0]})
    >>> posterior[a]
    Gaussian(a)
         mean ± deviation
      a     1.000 ± 0.707
    """
    posterior: Posterior | GridPosterior | ParticlePosterior = send(
        graph,
        evidence,
        schedule=schedule,
        lineariser=lineariser,
        start=start,
        keep=keep,
        executor=executor,
        memory=memory,
        belief=belief,
        progress=progress,
        impossible=impossible,
    )
    return told(posterior, schedule)


def send(
    graph: ClusterGraph,
    evidence: Evidence,
    *,
    schedule: Schedule | None = None,
    lineariser: Lineariser = TAYLOR,
    start: Start | None = None,
    keep: Keep | None = None,
    executor: Executor | None = None,
    memory: float | None = None,
    belief: PointMasses | None = None,
    progress: Progress = False,
    impossible: str = RAISE,
) -> Any:
    """Run a schedule on a graph, and return the posterior; no `ConvergenceWarning` is given.

    The posterior is the one that `infer`, which gives the warning, returns for the same arguments.
    """
    if not isinstance(graph, ClusterGraph):
        raise GraphError(
            f"infer takes a cluster graph (pgm.compile(network, ...)), not {titled(graph)}"
        )
    if not isinstance(evidence, Mapping):
        raise EvidenceError(
            f"evidence maps variables to values; found {type(evidence).__name__}; of a table of "
            "records pgm.records(table, network) makes it"
        )
    require_lineariser(lineariser)
    if schedule is not None and (type(schedule) is Loopy or not isinstance(schedule, Schedule)):
        raise ModelError(
            f"{schedule!r} is no schedule; give one like pgm.Smoothing() or pgm.Flooding()"
        )
    require_tables(graph, impossible, belief)
    if isinstance(graph, DynamicGraph):
        if memory is not None:
            raise GraphError(CONTINUOUS)
        choice = graph.layout.compiled
        bound = bind_chain(graph.model, evidence, graph.steps, identities=True, compiled=choice)
        run = runner(graph.model, belief, impossible)
        with reporting(progress):
            return run(graph, bound, schedule, lineariser, start, keep, executor)
    if belief is not None:
        raise GraphError(
            f"belief= is for dynamic networks, whose states it is of, not for {titled(graph)}"
        )
    if keep is not None or executor is not None:
        raise GraphError(
            f"keep= and executor= are for the runs of dynamic networks, not for {titled(graph)}; "
            "to hold less at a time, give fewer runs to a call"
        )
    if schedule is not None and isinstance(schedule, Filtering | FixedLag):
        raise GraphError(
            f"only a dynamic network is filtered, or smoothed by a lag; {titled(graph)} has no "
            f"time, for which {schedule!r} is: leave the schedule out for a tree, and on a graph "
            "with loops give pgm.Flooding(), pgm.Sequential() or pgm.Residual()"
        )
    if isinstance(schedule, Smoothing) and schedule.damping:
        raise GraphError(
            f"{schedule!r}: the damping of linearisation points is for dynamic networks; on other "
            "graphs pgm.Flooding(damping=...) damps messages"
        )
    if isinstance(schedule, Smoothing) and schedule.gate is not None:
        raise GraphError(
            f"{schedule!r}: a gate is for dynamic networks, at whose predicted beliefs it decides"
        )
    if not graph.is_tree and not isinstance(schedule, Loopy):
        advice = f"and {schedule!r} is for trees; give"
        if schedule is None:
            advice = "on which messages go round: say how,"
        raise GraphError(
            f"{titled(graph)} has loops, {advice} schedule=pgm.Flooding(), pgm.Sequential() or "
            "pgm.Residual()"
        )
    if graph.network.discrete:
        if start is not None:
            raise EvidenceError("a start is for nonlinear CPDs; a discrete network has none")
        with reporting(progress):
            return discrete.run(graph, evidence, schedule, memory, impossible)
    if memory is not None:
        raise GraphError(CONTINUOUS)
    with reporting(progress):
        return gaussian.run(graph, evidence, schedule, lineariser, start)
