"""Simulation studies: methods judged on many runs, drawn, inferred and reduced block by block."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from functools import partial, reduce
from importlib.util import find_spec
from os import PathLike
from typing import Any, NamedTuple

import numpy as np

from pgm.arguments import public
from pgm.beliefs.moments.compiled.sweep import repays
from pgm.boundary import as_mapping, is_whole
from pgm.comparison.blocks import worked
from pgm.comparison.comparing import as_states
from pgm.comparison.drawn_runs import DrawnRuns, drawn_runs, of_runs
from pgm.comparison.entries import OverTime, class_name, named
from pgm.comparison.fingerprint import fingerprint
from pgm.comparison.judged_runs import judged_runs, tally_of
from pgm.comparison.kept_sums import KeptSums
from pgm.comparison.row import FAILURES
from pgm.comparison.study_result import Statistic, Study, StudyRow
from pgm.comparison.sums import NONE, Sums
from pgm.comparison.tally import Tally
from pgm.compile import DynamicGraph, compile
from pgm.compile.machine import Choice, Compiled, Squared, as_choice
from pgm.consistency.errors import check_confidence
from pgm.consistency.regions import chi_squared
from pgm.display import titled
from pgm.errors import ModelError
from pgm.evidence import Evidence
from pgm.factors import Gaussian
from pgm.factors.scope import listed
from pgm.inference import Filtering, Posterior
from pgm.inference.engine import send
from pgm.inference.families import family_of
from pgm.kernels.arrays import Array
from pgm.linearisers import TAYLOR, Lineariser
from pgm.networks import DynamicBayesianNetwork, Sample
from pgm.progress import Progress, reporting
from pgm.schedules.argument_checks import require_lineariser
from pgm.schedules.options import Call, require_over_time
from pgm.variables import Variable
from pgm.workers.workers import Workers

# A right belief leaves out the truth once in a million, by this region.
_SURE = 1.0 - 1e-6
_EXAMPLE = 'methods={"EKF": pgm.Taylor(), "RTS": (pgm.Taylor(), pgm.Smoothing())}'


@public
def study(
    model: DynamicBayesianNetwork,
    evidence: Evidence | None = None,
    *,
    runs: int,
    methods: Mapping[str, Any],
    seed: int,
    states: Iterable[Variable] | None = None,
    steps: int | None = None,
    confidence: float = 0.95,
    compiled: Choice = None,
    executor: Any = None,
    file: str | PathLike[str] | None = None,
    progress: Progress = False,
) -> Study:
    r"""Judge methods on many runs of a model: draw, filter or smooth, and reduce to statistics.

    Of each method's beliefs N(μ, P), against the truths x that were drawn, over runs and by step:

    .. math::
        \sqrt{\overline{e^2}}, \quad \bar e, \qquad \overline{e^\top P^{-1} e}, \qquad
        \overline{[\,e^\top P^{-1} e \le \chi^2_d(c)\,]}, \quad e = \mu - x, \qquad
        \overline{\nu^\top S^{-1} \nu}

    with standard errors: RMSE and bias, NEES, the coverage of regions of confidence c, and the NIS
    of each sensor, ν its innovation of covariance S. All methods have the same runs.

    Runs are worked through in blocks, of which one is held at a time, so that a study takes the
    memory of a block, however many runs it has. The draws of run k depend on the seed and k alone
    (Philox, a counter-based generator): a longer study begins with the runs of a shorter one, and
    `Study.run` draws any run again by itself.

    Parameters
    ----------
    model : DynamicBayesianNetwork
        Of Gaussian CPDs, whose noise may be `StudentT`, `Cauchy` or `Huber`.
    evidence : mapping of Variable, optional
        Values of the inputs, of all runs, and when sensors read, as for
        `DynamicBayesianNetwork.sample`: ``{u: controls, z: pgm.sightings(step=..., given=...)}``.
    runs : int
    methods : mapping of str to method
        By name, a lineariser, which filters; a schedule, `Filtering`, `FixedLag` or `Smoothing`,
        which has `Taylor`; or a pair of both, ``(pgm.Unscented(), pgm.Smoothing())``.
    seed : int
        A whole number from 0.
    states : collection of Variable, optional
        Those judged; all without.
    steps : int, optional
        T, where no plain array of the evidence tells.
    confidence : float
        Of the regions whose coverage is counted.
    compiled : bool or Compiled, optional
        Whether methods run in machine code, as for `filter`; if not given, where all blocks
        together are long enough for that to be quicker.
    executor : concurrent.futures.Executor, optional
        As for `infer`: a process pool, a thread pool, a Dask client's ``get_executor()``, an MPI
        pool. Its workers do the blocks, whose sums are joined in their order here, so that all
        digits are those of one process. Functions of the model stand in modules that other
        processes can import.
    file : str or path-like, optional
        Where the sums of the blocks that are done are kept, like ``"study.npz"``. A study that was
        killed goes on from there when it is asked for again, with the digits of one that was not;
        so does a study of more runs. The first block is done again, to see that nothing of its
        digits has changed.
    progress : bool or callable
        As for `infer`: of the blocks that are not in the file.

    Returns
    -------
    Study
        ``found["EKF"].nees.value``; printed it is a table.

    Raises
    ------
    ModelError
        If the model is no dynamic network of CPDs that can be drawn by counters, or another
        argument is not what it should be; or if a function of the model fails by itself.
    EvidenceError
        If the evidence does not fit the model, or has axes of runs.
    LinearisationError, NumericalError
        If a draw of the model has no finite value, or a method fails in all runs of the first
        block.
    FileError
        If the file is damaged, of another study or of more runs, if its first block has other
        figures now, or if it cannot be written.
    ExecutorError
        If a worker dies.

    References
    ----------
    Bar-Shalom, Li & Kirubarajan, Estimation with Applications to Tracking and Navigation, 2001,
    section 5.4; Salmon, Moraes, Dror & Shaw, Parallel random numbers: as easy as 1, 2, 3, 2011.

    Examples
    --------
    >>> from pgm.examples import walk
    >>> methods = {"KF": pgm.Filtering(), "RTS": pgm.Smoothing()}
    >>> found = pgm.study(walk, steps=10, runs=2000, methods=methods, seed=1)
    >>> bool(abs(found["KF"].nees.value - 1.0) < 4 * found["KF"].nees.error)
    True
    """
    if not isinstance(model, DynamicBayesianNetwork):
        raise ModelError(f"a study is of a DynamicBayesianNetwork, not of {titled(model)}")
    _require_whole("runs", runs, 1)
    _require_whole("seed", seed, 0)
    level = check_confidence(confidence)
    if level.ndim:
        raise ModelError(f"confidence= is one probability, not {confidence!r}")
    chosen = _methods(methods)
    drawn = drawn_runs(model, as_mapping(evidence, "evidence"), steps, int(runs), int(seed))
    judged = as_states(model, states, None)
    _require_shared_points(model, chosen)
    # The code is made once, for all blocks.
    long = bool(
        repays(drawn.steps, min(drawn.block, drawn.runs), len(drawn.blocks))
        and find_spec("llvmlite")
    )
    choice = as_choice(compiled, "pgm.study(...)", card=True)
    report, workers, kept = reporting(progress), Workers(executor), None
    if file is not None:
        told = _described(drawn, chosen, judged, float(level), choice)
        kept = KeptSums(file, told, (*judged, *model.sensors), machine_code=long)
        kept.require_at_most(drawn.runs, drawn.block)
        long = kept.machine_code
    if choice or (choice is None and long):
        given = choice if isinstance(choice, Compiled) else Compiled()
        choice = Squared(given.threads, given.device)
    graph = compile(model, drawn.steps, compiled=choice)
    family = family_of(model)
    for method in chosen.values():
        require_over_time(method.call, graph, family)
    asked = _Asked(graph, judged, float(level))
    work = partial(of_block, drawn, methods=chosen, asked=asked)
    named = (*model.cpds, *(method.lineariser for method in chosen.values()))
    with report:
        sums = worked(work, drawn, workers, kept, named)
    return Study(_rows(sums, chosen, asked), drawn, float(level))


def _described(
    drawn: DrawnRuns,
    methods: Mapping[str, _Method],
    states: tuple[Variable, ...],
    confidence: float,
    compiled: Choice,
) -> dict[str, str]:
    """The arguments of a study by name, all but the number of runs, for its file."""
    model = drawn.model
    parts = (model.prior, model.transition, model.observation)
    return {
        "seed": str(drawn.seed),
        "steps": str(drawn.steps),
        "states": listed(states),
        "confidence": str(confidence),
        "compiled": str(compiled if compiled is None else bool(compiled)),
        "model": f"{titled(model)} [{fingerprint(parts)}]",
        "evidence": f"of {listed(drawn.inputs)} [{fingerprint(drawn.inputs)}]",
        "block": str(drawn.block),
    } | {
        f"method {name}": f"{class_name(rule)}, {class_name(schedule)} "
        f"[{fingerprint((rule, schedule))}]"
        for name, (rule, schedule) in methods.items()
    }


def of_block(
    drawn: DrawnRuns, first: int, methods: Mapping[str, _Method], asked: _Asked
) -> dict[str, Sums]:
    """The sums of each method over the block that begins with run `first`."""
    sample = drawn.sample(first)
    found: dict[str, Sums] = {}
    for name, method in methods.items():
        found[name] = reduce(Sums.joined, _of_method(method, sample, first, asked))
        if not found[name].runs and not first:  # whose error tells more than a table without it
            alone = of_runs(sample, slice(1))
            _reduced(send(asked.graph, alone.evidence, method.call), alone, 0, asked)
    return found


class _Method(NamedTuple):
    """A lineariser under a schedule."""

    lineariser: Lineariser
    schedule: OverTime

    @property
    def call(self) -> Call:
        """The options of its inference."""
        return Call(self.schedule, self.lineariser)


class _Asked(NamedTuple):
    """The graph that methods run on, the states that are judged, and the regions' confidence."""

    graph: DynamicGraph
    states: tuple[Variable, ...]
    confidence: float


def _of_method(method: _Method, sample: Sample, first: int, asked: _Asked) -> Iterator[Sums]:
    """The sums of a method over a block whose first run has this number.

    Where some run fails the halves of the block are tried by themselves, down to single runs.
    """
    count = len(sample[asked.states[0]])
    try:
        posterior = send(asked.graph, sample.evidence, method.call)
        sums = _reduced(posterior, sample, first, asked)
        if method.schedule.iterations > 1 and method.schedule.tolerance > 0.0:
            sums = sums._replace(unsettled=int((~posterior.status.converged).sum()))
        yield sums
    except FAILURES:
        if count == 1:
            yield Sums.of_failed(first)
            return
        half = count // 2
        yield from _of_method(method, of_runs(sample, slice(half)), first, asked)
        yield from _of_method(method, of_runs(sample, slice(half, None)), first + half, asked)


def _reduced(posterior: Posterior[Gaussian], sample: Sample, first: int, asked: _Asked) -> Sums:
    compiled = bool(asked.graph.layout.compiled)
    tallies: dict[tuple[str, Variable], Tally] = {}
    worst: dict[Variable, tuple[float, int]] = {}
    lost = np.zeros(len(sample[asked.states[0]]), dtype=bool)
    for state in asked.states:
        truth = np.asarray(sample[state])
        found = judged_runs(posterior[state], truth, asked.confidence, compiled=compiled)
        tallies |= {(name, state): tally for name, tally in found.tallies.items()}
        worst[state] = float(found.most.max()), first + int(found.most.argmax())
        lost |= found.last > chi_squared(_SURE, state.dimension)
    for sensor, (nis, dof) in posterior._squares.items():
        for name, values in (("nis", nis), ("dof", dof)):
            each = np.where(dof > 0, values, np.nan)
            tallies[name, sensor] = tally_of(each, compiled=compiled)
    return Sums(tallies, len(lost), first + np.flatnonzero(lost), NONE, 0, worst)


def _rows(
    sums: Mapping[str, Sums], methods: Mapping[str, _Method], asked: _Asked
) -> Iterator[StudyRow]:
    for name, (lineariser, schedule) in methods.items():
        tallies, runs, diverged, failed, unsettled, worst = sums[name]
        for each in (diverged, failed):
            each.flags.writeable = False
        nis = {
            z: _statistic(tally, float(tallies["dof", z].over_all()[0]))
            for (what, z), tally in tallies.items()
            if what == "nis"
        }
        for state in asked.states:
            yield StudyRow(
                name,
                lineariser,
                schedule,
                state,
                schedule.kind,
                runs,
                _root(_statistic(tallies["square", state])),
                _statistic(tallies["error", state], 0.0),
                _statistic(tallies["nees", state], float(state.dimension)),
                _statistic(tallies["held", state], asked.confidence),
                nis,
                diverged,
                failed,
                unsettled,
                worst[state][1] if worst[state][0] > -np.inf else None,
            )


def _statistic(tally: Tally, expected: float = np.nan) -> Statistic:
    value, error = map(np.asarray, tally.over_all())
    by_step, error_by_step = tally.by_step()
    for each in (value, error, by_step, error_by_step):
        each.flags.writeable = False
    return Statistic(value, error, by_step, error_by_step, expected)


def _root(squares: Statistic) -> Statistic:
    """The root of mean squares, with its errors to first order."""

    def root(square: Array, error: Array) -> tuple[Array, Array]:
        value = np.asarray(np.sqrt(square))
        return value, np.divide(error, 2.0 * value, out=np.array(error), where=value > 0.0)

    return Statistic(
        *root(squares.value, squares.error), *root(squares.by_step, squares.error_by_step)
    )


def _require_whole(name: str, value: Any, least: int) -> None:
    if not is_whole(value) or value < least:
        raise ModelError(f"{name} = {value!r}; a whole number, {least} or more, was due")


def _methods(methods: Any) -> dict[str, _Method]:
    if not isinstance(methods, Mapping):
        raise ModelError(f"methods= maps names to methods, as in {_EXAMPLE}; found {methods!r}")
    return {
        name: _method(name, each)
        for name, each in named(methods, "methods", _EXAMPLE, class_name).items()
    }


def _method(name: str, given: Any) -> _Method:
    """A method from a lineariser, a schedule, or a pair of both."""
    parts = given if isinstance(given, tuple) else (given,)
    schedules = [part for part in parts if isinstance(part, OverTime)]
    rules = [part for part in parts if not isinstance(part, OverTime)]
    if not parts or len(schedules) > 1 or len(rules) > 1 or not all(map(callable, rules)):
        raise ModelError(
            f"methods= has {name!r}, which is {titled(given)}; a method is a lineariser, a "
            f"schedule over time, or a pair of both, as in {_EXAMPLE}"
        )
    for rule in rules:
        require_lineariser(rule)
    return _Method(*(rules or [TAYLOR]), *(schedules or [Filtering()]))


def _require_shared_points(model: DynamicBayesianNetwork, methods: Mapping[str, _Method]) -> None:
    """Refuse rules that draw points of their own for each run of a call, as blocks are calls."""
    rules: list[Any] = [method.lineariser for method in methods.values()]
    rules += [getattr(cpd, "lineariser", None) for cpd in model.cpds]
    for rule in rules:
        if getattr(rule, "fresh_per_run", False):
            raise ModelError(
                f"{titled(rule)} draws anew for each run of a call, and would repeat its draws in "
                "each block of a study; leave fresh_per_run out"
            )
