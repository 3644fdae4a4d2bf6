"""Simulation studies: methods judged on many runs, drawn, inferred and reduced block by block."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, nullcontext
from functools import partial, reduce
from importlib.util import find_spec
from os import PathLike
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from pgm.arguments import public
from pgm.beliefs.moments.compiled.sweep import repays
from pgm.beliefs.own.family import BeliefFamily
from pgm.boundary import as_mapping, is_whole
from pgm.comparison.blocks import Work, worked
from pgm.comparison.comparing import as_states
from pgm.comparison.drawn_runs import DrawnRuns, drawn_runs, of_runs
from pgm.comparison.entries import belief_of, class_name
from pgm.comparison.fingerprint import fingerprint
from pgm.comparison.judged_runs import judged_runs, tally_of
from pgm.comparison.kept_sums import KeptSums
from pgm.comparison.row import FAILURES
from pgm.comparison.study_methods import Method, methods_of, seeded
from pgm.comparison.study_oracle import References, StudyOracle, judged, oracle_of
from pgm.comparison.study_result import Study
from pgm.comparison.study_rows import rows_of
from pgm.comparison.sums import NONE, Sums, far
from pgm.comparison.tally import Tally
from pgm.compile import DynamicGraph, compile
from pgm.compile.machine import Choice, Compiled, Squared, as_choice, is_for_card
from pgm.consistency.errors import check_confidence
from pgm.consistency.regions import chi_squared
from pgm.display import titled
from pgm.errors import ModelError
from pgm.evidence import Evidence
from pgm.factors import Gaussian
from pgm.factors.scope import listed
from pgm.inference import Posterior
from pgm.inference.engine import send
from pgm.inference.families import family_of
from pgm.networks import DynamicBayesianNetwork, Sample
from pgm.progress import Progress, reporting
from pgm.resources import retain
from pgm.schedules.options import require_over_time
from pgm.variables import Variable
from pgm.workers.workers import Workers

if TYPE_CHECKING:
    from pgm.comparison.card_blocks import CardBlocks

# A right belief leaves out the truth once in a million, by this region.
_SURE = 1.0 - 1e-6
# The most runs of a block of a family of beliefs, or of runs that are drawn one by one.
_FEW = 32


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
    oracle: BeliefFamily[Any] | None = None,
    repeats: int = 8,
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
        Its continuous states are judged. Gaussian CPDs, whose noise may be `StudentT`, `Cauchy` or
        `Huber`, tables, and those of both that switch or are mixed, are drawn for all runs of a
        block together. If there are others, like a `SampledCPD` or noise of your own, run k is
        ``model.sample`` by a generator of its own,
        ``Generator(Philox(SeedSequence(seed, spawn_key=(k,))))``.
    evidence : mapping of Variable, optional
        Values of the inputs, of all runs, and when sensors read, as for
        `DynamicBayesianNetwork.sample`: ``{u: controls, z: pgm.sightings(step=..., given=...)}``.
    runs : int
    methods : mapping of str to method
        By name, a lineariser, which filters; a schedule, `Filtering`, `FixedLag` or `Smoothing`,
        which has `Taylor`; or a pair of both, ``(pgm.Unscented(), pgm.Smoothing())``. In place of a
        lineariser may stand a family of beliefs, ``pgm.Particles(2000, seed=1)``. It has each run
        by itself, run k with its seed plus k; mixtures, ``pgm.Gaussians(mix=True)``, have many
        together. Mixtures and draws are judged by means and covariances.
    seed : int
        A whole number from 0.
    states : collection of Variable, optional
        Those judged; all without.
    steps : int, optional
        T, where no plain array of the evidence tells.
    confidence : float
        Of the regions whose coverage is counted.
    oracle : BeliefFamily, optional
        `Grid`, `Particles` or another family, run on each run with seeds that no method has. Rows
        then have the KL divergence from its beliefs, of Gaussians of the same moments, with the
        oracle's own Monte Carlo error, and are marked where it is too weak. It takes long: judge a
        few hundred runs, which are the first of any longer study.
    repeats : int
        How often an oracle whose draws have a seed is run on each run, 4 or more.
    compiled : bool or Compiled, optional
        Whether methods run in machine code, as for `filter`; if not given, where all blocks
        together are long enough for that to be quicker. The threads of ``pgm.Compiled(threads=2)``
        do the blocks, draws and sums among them; of fewer blocks than threads, sweeps have the
        others. All digits are those of one thread.
        On a card, ``Compiled(device="cuda")``, runs are drawn and summed as well, where there is
        neither an executor nor an oracle, for filters and for smoothers of one iteration;
        `Study.compilation` says which these were.
    executor : concurrent.futures.Executor, optional
        As for `infer`: a process pool, a thread pool, a Dask client's ``get_executor()``, an MPI
        pool. Its workers do the blocks, whose sums are joined in their order here, so that all
        digits are those of one process. Functions of the model stand in modules that other
        processes can import.
    file : str or path-like, optional
        Where the sums of the blocks that are done are kept, like ``"study.npz"``. A study that was
        killed goes on from there when it is asked for again, with the digits of one that was not.
        So does a study of more runs, by NumPy or machine code as it was begun. The first block is
        done again, to see that none of its digits has changed.
    progress : bool or callable
        As for `infer`: of the blocks that are not in the file.

    Returns
    -------
    Study
        ``found["EKF"].nees.value``; printed it is a table.

    Raises
    ------
    ModelError
        If the model is no dynamic network with sensors and continuous states, cannot be drawn, or
        has CPDs that a method does not know; if another argument is not what it should be; or if a
        function of the model fails by itself.
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
    chosen = methods_of(methods, model)
    drawn = drawn_runs(model, as_mapping(evidence, "evidence"), steps, int(runs), int(seed))
    judged_states = as_states(model, states, None)
    if not judged_states:
        raise ModelError(
            f"a study judges continuous states by means and covariances, and {titled(model)} has "
            "none"
        )
    apart = oracle is not None or any(method.belief for method in chosen.values())
    if apart or not drawn.counted:
        drawn = drawn._replace(block=min(drawn.block, _FEW))
    # The code is made once, for all blocks.
    long = bool(
        drawn.counted
        and repays(drawn.steps, min(drawn.block, drawn.runs), len(drawn.blocks))
        and find_spec("llvmlite")
    )
    plain = compile(model, drawn.steps)
    kinds = tuple(dict.fromkeys(method.schedule.kind for method in chosen.values()))
    judge = None if oracle is None else oracle_of(oracle, repeats, plain, judged_states, kinds)
    choice = as_choice(compiled, "pgm.study(...)", card=True)
    report, workers, kept = reporting(progress), Workers(executor), None
    sharing = 1
    if file is not None:
        told = _described(drawn, chosen, judge, judged_states, float(level), choice)
        kept = KeptSums(file, told, (*judged_states, *model.sensors), machine_code=long)
        kept.require_at_most(drawn.runs, drawn.block)
        long = kept.machine_code
    if choice or (choice is None and long):
        given = choice if isinstance(choice, Compiled) else Compiled()
        if executor is None and given.device is None:
            sharing = min(given.threads, len(drawn.blocks))
        choice = Squared(given.threads // sharing, given.device)
    graph = compile(model, drawn.steps, compiled=choice)
    drawn = drawn._replace(compiled=bool(choice))
    for method in chosen.values():
        if method.belief is None:
            require_over_time(method.call, graph, family_of(model))
        else:
            require_over_time(method.call, plain, method.belief)
    asked = _Asked(graph, plain, judged_states, float(level), judge)
    work: Work = partial(of_block, drawn, methods=chosen, asked=asked)
    parts = (part for method in chosen.values() for part in method)
    named = (*model.cpds, *parts, oracle)
    with report, ExitStack() as stack:
        card, pool = None, stack.enter_context(_threads(sharing))
        if is_for_card(choice) and executor is None and judge is None:
            card = stack.enter_context(_on_card(drawn, chosen, asked).held())
        sums = worked(card or work, drawn, Workers(pool) if pool else workers, kept, named)
    words = "" if card is None else card.words
    return Study(rows_of(sums, chosen, judged_states, float(level)), drawn, float(level), words)


def _on_card(drawn: DrawnRuns, methods: Mapping[str, Method], asked: _Asked) -> CardBlocks:
    """The work on blocks by a card."""
    from pgm.comparison.card_blocks import CardBlocks  # here, as llvmlite may not be installed
    from pgm.comparison.card_part import Asked

    processor = asked._replace(graph=compile(drawn.model, drawn.steps, compiled=Squared()))

    def plain(first: int, some: Mapping[str, Method]) -> Mapping[str, Sums]:
        return of_block(drawn, first, some, asked)

    def aside(method: Method, sample: Sample, first: int) -> Iterator[Sums]:
        return _of_method(method, sample, first, processor, None)

    of = Asked(drawn, asked.graph, asked.states, asked.confidence)
    return CardBlocks(of, methods, _SURE, plain, aside)


def _threads(count: int) -> AbstractContextManager[Any]:
    """A pool of threads; None where there is to be no more than this one."""
    from concurrent.futures import ThreadPoolExecutor  # here, since few need it

    return ThreadPoolExecutor(count) if count > 1 else nullcontext()


def _described(
    drawn: DrawnRuns,
    methods: Mapping[str, Method],
    oracle: StudyOracle | None,
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
        "device": str(getattr(compiled, "device", None)),
        "model": f"{titled(model)} [{fingerprint(parts)}]",
        "evidence": f"of {listed(drawn.inputs)} [{fingerprint(drawn.inputs)}]",
        "block": str(drawn.block),
        "oracle": "none"
        if oracle is None
        else f"{class_name(oracle.family)} × {oracle.repeats} [{fingerprint(oracle.family)}]",
    } | {
        f"method {name}": f"{class_name(method.belief or method.lineariser)}, "
        f"{class_name(method.schedule)} [{fingerprint(tuple(method))}]"
        for name, method in methods.items()
    }


def of_block(
    drawn: DrawnRuns, first: int, methods: Mapping[str, Method], asked: _Asked
) -> dict[str, Sums]:
    """The sums of each method over the block that begins with run `first`."""
    retain()
    sample = drawn.sample(first)
    judges = asked.oracle.references(sample, first) if asked.oracle else None
    found: dict[str, Sums] = {}
    for name, method in methods.items():
        found[name] = reduce(Sums.joined, _of_method(method, sample, first, asked, judges))
        if not found[name].runs and not first:  # whose error tells more than a table without it
            alone = of_runs(sample, slice(1))
            _reduced(method, _inferred(method, alone, 0, asked), alone, 0, asked)
    return found


class _Asked(NamedTuple):
    """The subject of a study.

    graph: For methods of linearisers.
    plain: For families of beliefs, which have no use for machine code.
    states: Those that are judged.
    confidence: Of the regions whose coverage is counted.
    oracle: None without one.
    """

    graph: DynamicGraph
    plain: DynamicGraph
    states: tuple[Variable, ...]
    confidence: float
    oracle: StudyOracle | None = None


def _of_method(
    method: Method,
    sample: Sample,
    first: int,
    asked: _Asked,
    judges: Sequence[References] | None,
) -> Iterator[Sums]:
    """The sums of a method over a block whose first run has this number.

    Where some run fails the halves of the block are tried by themselves, down to single runs. Most
    families of beliefs have each run by itself, with a seed of its own.

    judges: The oracle's beliefs of each run.
    """
    count = len(sample[asked.states[0]])
    if count == 1 or not method.alone:
        try:
            posterior = _inferred(method, sample, first, asked)
            with far():
                sums = _reduced(method, posterior, sample, first, asked)
                if judges is not None:
                    sums = _judged(sums, posterior, judges, method, first, asked)
            if method.iterates:
                sums = sums._replace(unsettled=int((~posterior.status.converged).sum()))
            yield sums
            return
        except FAILURES:
            if count == 1:
                yield Sums.of_failed(first)
                return
    half = count // 2
    for part, start in ((slice(half), first), (slice(half, None), first + half)):
        own = judges and judges[part]
        yield from _of_method(method, of_runs(sample, part), start, asked, own)


def _inferred(method: Method, sample: Sample, first: int, asked: _Asked) -> Any:
    """The posterior of a method."""
    if method.belief is None:
        return send(asked.graph, sample.evidence, method.call)
    return send(asked.plain, sample.evidence, method.call, seeded(method.belief, first))


def _belief(posterior: Posterior[Any], state: Variable) -> Gaussian:
    """The belief of a state, of other forms than Gaussians the Gaussian of their moments."""
    found = belief_of(posterior, state)
    assert isinstance(found, Gaussian)
    return found


def _judged(
    sums: Sums,
    posterior: Any,
    judges: Sequence[References],
    method: Method,
    first: int,
    asked: _Asked,
) -> Sums:
    """The sums with the KL of the runs from the oracle's beliefs."""
    tallies, doubtful = dict(sums.tallies), set[int]()
    for state in asked.states:
        belief = _belief(posterior, state)
        found, places = judged(belief, judges, method.schedule.kind, state)
        tallies |= {(name, state): tally for name, tally in found.items()}
        doubtful |= {first + int(place) for place in places}
    return sums._replace(tallies=tallies, doubtful=np.array(sorted(doubtful), dtype=np.intp))


def _reduced(
    method: Method, posterior: Posterior[Any], sample: Sample, first: int, asked: _Asked
) -> Sums:
    compiled = bool(asked.graph.layout.compiled)
    tallies: dict[tuple[str, Variable], Tally] = {}
    worst: dict[Variable, tuple[float, int]] = {}
    lost = np.zeros(len(sample[asked.states[0]]), dtype=bool)
    for state in asked.states:
        truth = np.asarray(sample[state])
        belief = _belief(posterior, state)
        found = judged_runs(belief, truth, asked.confidence, compiled=compiled)
        tallies |= {(name, state): tally for name, tally in found.tallies.items()}
        worst[state] = float(found.most.max()), first + int(found.most.argmax())
        lost |= found.last > chi_squared(_SURE, state.dimension)
    squares = posterior._squares if method.belief is None else {}  # families may have none
    for sensor, (nis, dof) in squares.items():
        for name, values in (("nis", nis), ("dof", dof)):
            each = np.where(dof > 0, values, np.nan)
            tallies[name, sensor] = tally_of(each, compiled=compiled)
    return Sums(tallies, len(lost), first + np.flatnonzero(lost), NONE, 0, worst)


def _require_whole(name: str, value: Any, least: int) -> None:
    if not is_whole(value) or value < least:
        raise ModelError(f"{name} = {value!r}; a whole number, {least} or more, was due")
