"""Every lineariser under every schedule on one model and its evidence."""

import time
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from pgm import consistency
from pgm.arguments import public
from pgm.beliefs.own.family import BeliefFamily, require_family
from pgm.boundary import as_floats, as_tuple
from pgm.comparison.oracle import Compared, Oracle, Reference, references, require_oracle
from pgm.comparison.row import FAILURES, Name, Row, failed, judge
from pgm.comparison.table import Comparison
from pgm.compile import compile
from pgm.display import titled
from pgm.errors import EvidenceError, ModelError, PgmError
from pgm.evidence import Evidence
from pgm.factors import Gaussian
from pgm.factors.scope import as_scope, labels, listed
from pgm.inference import Filtering, FixedLag, Kind, Smoothing
from pgm.inference.engine import send
from pgm.kernels.arrays import Array
from pgm.linearisers import Cubature, Lineariser, Taylor, Unscented
from pgm.networks import DynamicBayesianNetwork
from pgm.posteriors.outcome import marginal
from pgm.progress import Progress, counted, reporting
from pgm.schedules.argument_checks import require_lineariser
from pgm.schedules.binding import bind_chain
from pgm.schedules.options import Call
from pgm.variables import Discrete, Variable

OverTime = Filtering | FixedLag | Smoothing
Truth = Mapping[Variable, Any]
Method = Lineariser | BeliefFamily[Any]

LINEARISERS: tuple[Lineariser, ...] = (Taylor(), Unscented(), Cubature())
SCHEDULES: tuple[OverTime, ...] = (Filtering(), Smoothing())
_WORDS = {Filtering: "filter", Smoothing: "smoother"}


@public
def compare(
    model: DynamicBayesianNetwork,
    evidence: Evidence,
    *,
    linearisers: Mapping[str, Method] | Sequence[Method] = LINEARISERS,
    schedules: Mapping[str, OverTime] | Sequence[OverTime] = SCHEDULES,
    oracle: BeliefFamily[Any] | Oracle | Truth | None = None,
    truth: Truth | None = None,
    states: Iterable[Variable] | None = None,
    steps: int | None = None,
    progress: Progress = False,
) -> Comparison:
    r"""Run every lineariser under every schedule on the same evidence, and judge their beliefs.

    A belief q is judged by an oracle p, by the truth x, or both:

    .. math::
        \mathrm{KL}(N_p \| q), \quad N_p = N(\mathrm{E}_p x, \mathrm{Cov}_p x), \qquad
        e^\top P^{-1} e, \quad e = \mathrm{E}_q x - x

    - N_p has the oracle's mean and covariance. Of a density p that is no Gaussian KL(p ‖ q) =
      KL(p ‖ N_p) + KL(N_p ‖ q) for every Gaussian q: the first part is the oracle's own and
      no Gaussian can be without it, the second is the lineariser's. Each has rows of its own.
    - In nats, at each step, angles wrapped; averaged over runs, then over steps. See `Row`.
    - RMSE and NEES are those of `pgm.consistency`.

    A run that fails, of a `LinearisationError` or `NumericalError`, is a row with its error in
    words, and so is a schedule that a `BeliefFamily` refuses. A CPD with a lineariser of its own
    keeps it.

    Parameters
    ----------
    model : DynamicBayesianNetwork
        A model of Gaussian CPDs, or of those and discrete variables, of which the continuous
        states are compared.
    evidence : mapping of Variable
        As for `infer`; leading axes are runs, over which rows are averaged.
    linearisers : mapping of str to Lineariser, or sequence of Lineariser, optional
        A mapping names them; those of a sequence are called by their class, or all they show
        where two are of one. `Taylor()`, `Unscented()` and `Cubature()` without. A `BeliefFamily`
        may stand among them, as a `Grid`, or ``pgm.Gaussians(8)``: it is compared by the mean and
        covariance of its beliefs.
    schedules : mapping of str to schedule, or sequence of them, optional
        `Filtering`, `FixedLag` or `Smoothing`; a filter and a smoother without.
    oracle : Grid, posterior over time, or mapping, optional
        A `Grid`, or another `BeliefFamily`, is run on the same model, as filter for filters, as
        smoother for smoothers. A posterior, a grid's, particles' or any `Oracle`, is taken as it
        is, its forward sweep for filters; it must have beliefs of each kind that the schedules
        leave. A mapping is a truth.
    truth : mapping of Variable to array_like, optional
        By state, (*runs, T+1, d), or (T+1, d) of all runs; NaN where it is not known.
    states : collection of Variable, optional
        Those compared; without, all of an oracle's, or those of a truth alone.
    steps : int, optional
        T, where no plain array of the evidence tells.
    progress : bool or callable
        As for `infer`: of an oracle's run, then of the lineariser and schedule pairs.

    Raises
    ------
    ModelError
        If the model is no dynamic network of Gaussian CPDs, or a lineariser, schedule, oracle,
        truth or state is none, or does not fit the model, its runs or its steps; or if a function
        of the model, or a lineariser, fails by itself.
    EvidenceError
        If the evidence does not fit the model.
    PgmError
        If the oracle's own run fails.

    Examples
    --------
    >>> from pgm.examples import walk, x, z
    >>> found = pgm.compare(walk, {z: [[2.0], [3.0]]}, oracle=pgm.Grid({"x": (-8.0, 12.0, 400)}))
    >>> found["Taylor", "filter"].kl < 1e-3
    True
    """
    methods = _named(linearisers, "linearisers", "linearisers=[pgm.Taylor()]", _class)
    for method in methods.values():
        if isinstance(method, BeliefFamily):
            require_family(method, model)
        else:
            require_lineariser(method)
    plans = _named(schedules, "schedules", "schedules=[pgm.Filtering()]", _word)
    for plan in plans.values():
        _require_schedule(plan)
    oracle, truth = _parted(oracle, truth)
    bound = bind_chain(model, evidence, steps)
    if model.discrete:
        raise ModelError(
            "a network of tables is exact by pgm.filter and pgm.smooth: there is nothing to "
            "linearise, and nothing to compare"
        )
    chosen = _states(model, states, truth if oracle is None else None)
    kinds = tuple(dict.fromkeys(plan.kind for plan in plans.values()))
    compared = Compared(compile(model, bound.steps), evidence, bound.lead, chosen, kinds)
    true = _truths(truth or {}, compared, model)
    found: dict[tuple[Kind, Variable], Reference] = {}
    pairs = [(each, plan) for each in methods.items() for plan in plans.items()]
    rows: list[Row] = []
    with reporting(progress):
        if oracle is not None:
            require_oracle(oracle, kinds)
            found = references(oracle, compared)
        for (label, method), (word, plan) in counted(pairs, "linearisers and schedules"):
            rows += _run(compared, (label, word), method, plan, found, true)
    own = [
        _oracle_row(_title(oracle), kind, state, found[kind, state], true.get(state))
        for kind in (kinds if found else ())
        for state in chosen
    ]
    title = "" if oracle is None else _described(oracle)
    status = "; ".join(dict.fromkeys(each.status for each in found.values() if each.status))
    return Comparison(rows, own, bound.steps, bound.lead, title, status)


def _run(
    compared: Compared,
    named: tuple[str, str],
    method: Method,
    schedule: OverTime,
    found: Mapping[tuple[Kind, Variable], Reference],
    truth: Mapping[Variable, Array],
) -> list[Row]:
    count, kind = compared.graph.steps + 1, schedule.kind
    names = {state: Name(*named, state, kind) for state in compared.states}
    family, call = None, Call(schedule, keep=compared.states)
    failures: tuple[type[PgmError], ...] = FAILURES
    if isinstance(method, BeliefFamily):
        family, call = method, Call(schedule)
        # One that only filters, or has no moments, is a row beside the others.
        failures = (*FAILURES, ModelError, EvidenceError)
    else:
        call = call._replace(lineariser=method)
        if compared.graph.model.mixed:  # whose mixtures are kept whole
            call = call._replace(keep=None)
    began = time.perf_counter()
    try:
        posterior = send(  # of runs that did not settle the rows tell
            compared.graph,
            compared.evidence,
            call,
            family,
        )
    except failures as error:
        seconds = time.perf_counter() - began
        return [
            failed(name, count, truth.get(state), error, seconds=seconds)
            for state, name in names.items()
        ]
    rest: dict[str, Any] = {
        "seconds": time.perf_counter() - began,
        "log_evidence": float(posterior.log_evidence.mean()),
        "log_evidence_kind": posterior.log_evidence_kind,
    }
    if schedule.iterations > 1:
        rest["converged"] = float(posterior.status.converged.mean())
    rows = []
    for state, name in names.items():
        reference = found.get((kind, state))
        oracle = None if reference is None else reference.gaussian
        try:
            belief = marginal(posterior, state)
            if not isinstance(belief, Gaussian):
                belief = belief.gaussian()
            rows.append(judge(name, belief, oracle, truth.get(state), **rest))
        except failures as error:
            rows.append(failed(name, count, truth.get(state), error, **rest))
    return rows


def _oracle_row(
    title: str, kind: Kind, state: Variable, reference: Reference, truth: Array | None
) -> Row:
    name = Name(title, kind.name, state, kind)
    return judge(
        name,
        reference.gaussian,
        None,
        truth,
        own=reference.from_gaussian,
        seconds=reference.seconds,
        log_evidence=reference.log_evidence,
        log_evidence_kind=reference.log_evidence_kind,
    )


def _named(items: Any, what: str, example: str, word: Callable[[Any], str]) -> dict[str, Any]:
    if isinstance(items, Mapping):
        for name in items:
            if not isinstance(name, str):
                raise ModelError(f"{what}= maps names to {what}; found the name {name!r}")
        found = dict(items)
    else:
        every = as_tuple(items)
        if every is None:
            raise ModelError(
                f"{what}= is a sequence of {what}, or a mapping of their names to them, as in "
                f"{example}; found {items!r}"
            )
        count = Counter(map(word, every))
        names = [word(item) if count[word(item)] == 1 else repr(item) for item in every]
        found = dict(zip(names, every, strict=True))
        if len(found) < len(names):
            twice = next(name for name in names if names.count(name) > 1)
            raise ModelError(f"{what}= has {twice} twice; name them by a mapping, or leave one out")
    if not found:
        raise ModelError(f"{what}= is empty; give one or more, as in {example}")
    return found


def _class(lineariser: Any) -> str:
    return str(getattr(lineariser, "__name__", type(lineariser).__name__))


def _word(schedule: Any) -> str:
    if isinstance(schedule, FixedLag):
        word = f"fixed lag {schedule.lag}"
    else:
        word = _WORDS.get(type(schedule), repr(schedule))
    iterations, gate = getattr(schedule, "iterations", 1), getattr(schedule, "gate", None)
    word = word if iterations == 1 else f"{word} × {iterations}"
    return word if gate is None else f"{word}, gate {gate}"


def _require_schedule(schedule: Any) -> None:
    if not isinstance(schedule, OverTime):
        raise ModelError(
            f"{schedule!r} is no schedule of a dynamic network; give pgm.Filtering(), "
            "pgm.FixedLag(...) or pgm.Smoothing()"
        )


def _parted(oracle: Any, truth: Any) -> tuple[BeliefFamily[Any] | Oracle | None, Truth | None]:
    if truth is not None and not isinstance(truth, Mapping):
        raise ModelError(
            f"truth= maps states to their values (..., T+1, d), not {type(truth).__name__}"
        )
    if not isinstance(oracle, Mapping):
        return oracle, truth
    if truth is not None:
        raise ModelError(
            "oracle= is a mapping of states, which is a truth, and truth= is given too; give the "
            "truth once, and as oracle= a pgm.Grid(...) or a posterior"
        )
    return None, oracle


def _states(
    model: DynamicBayesianNetwork, states: Any, truth: Truth | None
) -> tuple[Variable, ...]:
    continuous = tuple(state for state in model.states if not isinstance(state, Discrete))
    if states is None:
        return tuple(state for state in continuous if state in (truth or ())) or continuous
    chosen = as_scope(states, "states=")
    for state in chosen:
        _require_continuous("states=", state, model.states)
        if state not in model.states:
            raise ModelError(
                f"states=: {state!r} is no state of the network; those are {listed(model.states)}",
                variable=state,
            )
    if not chosen:
        raise ModelError("states= is empty; name one or more, or leave it out for all")
    return chosen


def _require_continuous(role: str, state: Variable, states: Sequence[Variable]) -> None:
    if isinstance(state, Discrete):
        continuous = tuple(other for other in states if not isinstance(other, Discrete))
        raise ModelError(
            f"{role}: {state!r} is discrete, and beliefs are compared by means and covariances; "
            f"continuous states are {listed(continuous)}",
            variable=state,
        )


def _truths(
    truth: Truth, compared: Compared, model: DynamicBayesianNetwork
) -> dict[Variable, Array]:
    found = {}
    shape = (*compared.lead, compared.graph.steps + 1)
    for state, values in truth.items():
        _require_continuous("truth=", state, model.states)
        if state not in model.states:
            raise ModelError(
                f"a truth is given of {state!r}, which is no state of the network; those are "
                f"{listed(model.states)}"
            )
        array = as_floats(values, f"the truth of {state!r}", labels=labels((state,)))
        cov = np.broadcast_to(np.eye(state.dimension), (*shape, *(state.dimension,) * 2))
        mean = np.zeros((*shape, state.dimension))
        if np.isnan(array).all():
            raise ModelError(f"the truth of {state!r} is NaN throughout: leave it out, or give it")
        # Refused as it will be by what is made of it, but before any work.
        consistency.error(Gaussian(state, mean, cov, steps=np.arange(shape[-1])), array)
        if state in compared.states:
            found[state] = array
    return found


def _title(oracle: BeliefFamily[Any] | Oracle | None) -> str:
    family = _family(oracle)
    return "oracle" if family is None else f"oracle: {type(family).__name__}"


def _described(oracle: BeliefFamily[Any] | Oracle) -> str:
    return titled(_family(oracle) or oracle)


def _family(oracle: Any) -> BeliefFamily[Any] | None:
    """The family of beliefs that an oracle is, or has; None of one that the network decided."""
    found = oracle if isinstance(oracle, BeliefFamily) else getattr(oracle, "family", None)
    return found if isinstance(found, BeliefFamily) else None
