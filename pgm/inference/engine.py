"""Running a schedule of messages on a cluster graph: bind, sweep, posterior.

The family of beliefs does the work (`belief_family`): tables of discrete variables, Gaussians of
continuous ones, or the one that the user gives.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING

from pgm.arguments import public
from pgm.beliefs.own.family import BeliefFamily
from pgm.clustergraph import ClusterGraph
from pgm.compile import DynamicGraph
from pgm.display import titled
from pgm.errors import EvidenceError, GraphError, ModelError
from pgm.evidence import Evidence
from pgm.inference import gaps
from pgm.inference.families import answered, family_of
from pgm.inference.on_card import solved_there
from pgm.linearisers import TAYLOR, Lineariser
from pgm.posteriors.outcome import B
from pgm.posteriors.posterior import Posterior
from pgm.progress import Progress, reporting
from pgm.schedules.argument_checks import require_lineariser
from pgm.schedules.binding import bind_chain
from pgm.schedules.convergence import told
from pgm.schedules.impossible import RAISE
from pgm.schedules.options import IDLE, STATIC, Call, Scheduled, require, require_over_time
from pgm.schedules.schedule import (
    Filtering,
    FixedLag,
    Loopy,
    Schedule,
    require_known,
)
from pgm.schedules.starting_points import Start
from pgm.variables import Variable

if TYPE_CHECKING:
    from concurrent.futures import Executor


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
    belief: BeliefFamily[B] | None = None,
    progress: Progress = False,
    impossible: str = RAISE,
) -> Posterior[B]:
    """Send the messages of a schedule on a cluster graph.

    Parameters
    ----------
    graph : ClusterGraph
        From `compile`, or made by hand.
    evidence : mapping of Variable
        For a dynamic network arrays (..., T, d), `constant` or `sightings`, by variable. For
        others values (..., d) of continuous variables; of discrete ones the name or index of a
        state, an array of indices with −1 for "not observed in this run", or `soft` weights.
        Leading axes are runs. NaN is a component that was not observed: of a sensor's measurement
        over time, else of any variable but an input, which then has a belief, and in runs that
        observe it its value with covariance zero. `records` makes such a mapping of a table.
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
        ``keep=[x]``, with log-evidence and status; without, everything is. Of sensors among them,
        ``keep=[x, z]``, Gaussian chains keep ``posterior.predicted[z]`` and
        ``posterior.innovations[z]``. The runs are then worked through in parts of some hundreds or
        thousands, and only the parts at work are in memory, so that a study of 100,000 simulations
        fits. With a lineariser that draws points afresh for each run all runs are one part.
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
    belief : Grid, Particles, or another BeliefFamily, optional
        For a dynamic network of continuous variables: its beliefs as probabilities of the cells of
        a grid, one run after another, as weighted draws, or of a family of your own, in place of
        Gaussians. For any network of continuous variables several modes of its posterior,
        ``pgm.Gaussians(4, starts=16)``.
    progress : bool or callable
        Whether bars show how far the work is, on a terminal or in a notebook and nowhere else; or a
        function, ``progress(done, total)``, called at the start of each stage and after each of its
        items: steps, linearisations, rounds, runs or parts. An error that it raises ends the call.
    impossible : str
        For a network without time, or one of tables over time, and a graph without loops, what is
        done with runs whose evidence has probability zero, as where some of many `records`
        contradict the tables, or CPDs without noise: ``"raise"`` refuses the evidence; with
        ``"allow"`` such runs have a log-evidence of −∞ and beliefs of NaN, and all other runs their
        usual results. Over time a belief is NaN if it knows the first impossible measurement:
        filtered beliefs from its step on, fixed-lag ones from a lag before it on, smoothed ones at
        all steps.

    Returns
    -------
    Posterior
        Of ``belief``, or of tables or Gaussians; with ``keep`` reduced to what was kept.

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
    call = Call(schedule, lineariser, start, keep, executor, memory, impossible)
    if isinstance(graph, DynamicGraph):
        on_card = call._replace(compiled=graph.layout.compiled)
        there = solved_there(graph.model, evidence, graph.steps, on_card, belief, graph)
        if there is not None:
            return there
    return told(send(graph, evidence, call, belief, progress), schedule)


def send(
    graph: ClusterGraph,
    evidence: Evidence,
    call: Call,
    belief: BeliefFamily[B] | None = None,
    progress: Progress = False,
) -> Posterior[B]:
    """The posterior that `infer` returns for these options, without a `ConvergenceWarning`."""
    if not isinstance(graph, ClusterGraph):
        raise GraphError(
            f"infer takes a cluster graph (pgm.compile(network, ...)), not {titled(graph)}"
        )
    if not isinstance(evidence, Mapping):
        raise EvidenceError(
            f"evidence maps variables to values; found {type(evidence).__name__}; of a table of "
            "records pgm.records(table, network) makes it"
        )
    require_lineariser(call.lineariser)
    schedule = call.schedule
    if schedule is not None and (type(schedule) is Loopy or not isinstance(schedule, Schedule)):
        raise ModelError(
            f"{schedule!r} is no schedule; give one like pgm.Smoothing() or pgm.Flooding()"
        )
    if isinstance(graph, DynamicGraph):
        compiled = graph.layout.compiled
        asked_of = graph.model, evidence, graph.steps
        bound = bind_chain(*asked_of, identities=True, among=True, compiled=compiled)
        family = family_of(graph.model, belief, bound)
        call = call._replace(compiled=compiled or None)
        require_over_time(call, graph, family)
        with reporting(progress):
            return answered(family, family.infer(graph, bound, call))
    asked = call.asked(graph)
    own = belief if isinstance(belief, BeliefFamily) and belief.without_time else None
    if belief is not None and own is None:
        asked["belief"] = belief
    family = family_of(graph.network) if own is None else own
    if asked:
        require(asked, graph, STATIC)
        idle = IDLE | {"impossible"} if family.by_pattern else IDLE  # which runs by pattern allow
        require({n: v for n, v in asked.items() if n not in idle}, graph, family)
    _require_static(graph, schedule)
    if asked and schedule is not None:
        require(asked, graph, Scheduled(schedule))
    with reporting(progress):
        return Posterior(*gaps.run(family, graph, evidence, call))


def _require_static(graph: ClusterGraph, schedule: Schedule | None) -> None:
    """Refuse, by a GraphError, a schedule that a graph without time cannot have."""
    if schedule is not None and isinstance(schedule, Filtering | FixedLag):
        raise GraphError(
            f"only a dynamic network is filtered, or smoothed by a lag; {titled(graph)} has no "
            f"time, for which {schedule!r} is: leave the schedule out for a tree, and on a graph "
            "with loops give pgm.Flooding(), pgm.Sequential() or pgm.Residual()"
        )
    if schedule is not None:
        require_known(schedule, "a graph without time")
    if not graph.is_tree and not isinstance(schedule, Loopy):
        advice = f"and {schedule!r} is for trees; give"
        if schedule is None:
            advice = "on which messages go round: say how,"
        raise GraphError(
            f"{titled(graph)} has loops, {advice} schedule=pgm.Flooding(), pgm.Sequential() or "
            "pgm.Residual()"
        )
