"""Every row of a comparison on one model and its evidence, judged by oracles and by the truth."""

import time
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from pgm import consistency
from pgm.arguments import public
from pgm.beliefs.own.family import BeliefFamily, require_family
from pgm.boundary import as_floats, is_whole
from pgm.comparison import entries
from pgm.comparison.entries import VALUES, Entry, Method, OverTime, Track
from pgm.comparison.judgement import Judgement, Parts, judge
from pgm.comparison.oracle import (
    Compared,
    Oracle,
    family_of_oracle,
    references,
    require_judges,
    require_oracle,
)
from pgm.comparison.reference import Reference
from pgm.comparison.row import FAILURES, Name, Row, failed, of_track, proper, scored
from pgm.comparison.table import Comparison
from pgm.comparison.weakness import Judged, hidden, marked
from pgm.compile import DynamicGraph, compile
from pgm.display import titled
from pgm.errors import EvidenceError, ModelError, PgmError
from pgm.evidence import Evidence
from pgm.factors import Gaussian
from pgm.factors.scope import as_scope, labels, listed, unknown_name
from pgm.inference import Filtering, Kind, Smoothing
from pgm.inference.audit import Audit
from pgm.io.poses import Poses
from pgm.kernels.arrays import Array, Mask
from pgm.linearisers import Cubature, Lineariser, Taylor, Unscented
from pgm.networks import DynamicBayesianNetwork, Sample
from pgm.progress import Progress, counted, reporting
from pgm.schedules.argument_checks import require_lineariser
from pgm.schedules.binding import bind_chain
from pgm.variables import Discrete, Variable

Truth = Mapping[Variable, Any] | Sample
OneOracle = BeliefFamily[Any] | Audit | Oracle

LINEARISERS: tuple[Lineariser, ...] = (Taylor(), Unscented(), Cubature())
SCHEDULES: tuple[OverTime, ...] = (Filtering(), Smoothing())


@public
def compare(
    model: DynamicBayesianNetwork,
    evidence: Evidence,
    *,
    linearisers: Mapping[str, Method] | Sequence[Method] | None = None,
    schedules: Mapping[str, OverTime] | Sequence[OverTime] = SCHEDULES,
    rows: Mapping[str, Any] | None = None,
    oracle: Any = None,
    repeats: int = 8,
    truth: Truth | None = None,
    states: Iterable[Variable] | None = None,
    steps: int | None = None,
    progress: Progress = False,
) -> Comparison:
    r"""Judge beliefs side by side: linearisers under schedules, and any rows of your own.

    A belief q is judged by an oracle p, by the truth x, or both:

    .. math::
        \mathrm{KL}(N_p \| q), \quad N_p = N(\mathrm{E}_p x, \mathrm{Cov}_p x), \qquad
        e^\top P^{-1} e, \quad e = \mathrm{E}_q x - x, \qquad \ln q(x)

    - N_p has the oracle's mean and covariance. Of a density p that is no Gaussian KL(p ‖ q) =
      KL(p ‖ N_p) + KL(N_p ‖ q) for every Gaussian q: the first part is the oracle's own and
      no Gaussian can be without it, the second is the row's. Each has rows of its own.
    - In nats, at each step, angles wrapped; averaged over runs, then over steps. See `Row`.
    - RMSE, NEES and log-score are those of `pgm.consistency`, their errors standard errors over
      runs.

    The KL from an oracle made of draws has a Monte Carlo error. Draws in G independent groups tell
    it: the parts of one audit, or particles with G seeds. Its bias, about d (d + 3)/4N nats of N
    effective draws, is subtracted. Where the oracle is too weak for a row, a "?" in the table marks
    it, and the text below says why:

    - the error itself is not to be trusted: weights of a Pareto shape above .7, fewer than ten
      effective draws, an audit that is not trusted, runs with other seeds that disagree, or an
      estimate that is not vouched for;
    - the KL, in some run, is no more than the bound on an estimate's own error,
      ``estimate.verdict.within``;
    - nothing tells the error: a posterior of nonlinear functions that is linearised, or a family of
      your own that draws, and takes no other seed;
    - 1.96 errors are not less than the differences between rows, which it is to show;
    - another oracle disagrees with it by more than the row's KL.

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
        where two are of one. Without, and without rows, `Taylor()`, `Unscented()` and `Cubature()`.
        A `BeliefFamily` may stand among them, as a `Grid`, or ``pgm.Gaussians(8)``: it is compared
        by the mean and covariance of its beliefs.
    schedules : mapping of str to schedule, or sequence of them, optional
        `Filtering`, `FixedLag` or `Smoothing`; a filter and a smoother without.
    rows : mapping of str to object, optional
        Rows by their labels. Run under each schedule are: a lineariser or a belief family; a model,
        with the same states and evidence; robust noise, such as ``pgm.Huber(1.5)``, for all
        sensors of the model that have Gaussian noise. A schedule is run by itself. Taken as they
        are: a posterior over time, of any model and beliefs; an `Audit`, by its corrected moments;
        a `Gaussian` over steps 0..T; a mapping of states to values (..., T+1, d), NaN where not
        known, such as ``{x: poses.along(x, ...)}``, which have RMSE alone. Gaussians and values
        count as smoothed.
    oracle : oracle, mapping of str to oracle, or sequence of them, optional
        A `Grid`, `Particles` or another `BeliefFamily` is run on the same model, as filter for
        filters, as smoother for smoothers. A posterior, a grid's, particles' or any `Oracle`, is
        taken as it is, its forward sweep for filters. An `Audit` has the exact smoothed moments. A
        mapping of states, or a `Sample`, is a truth. Several oracles, a truth among them, each have
        columns of their own; some oracle must have beliefs of each kind that rows have.
    repeats : int, optional
        How often particles are run in all, 4 or more, with as many successive seeds: a posterior's,
        too, as one run tells nothing of its error. Their beliefs are pooled.
    truth : mapping of Variable to array_like, or Sample, optional
        By state, (*runs, T+1, d), or (T+1, d) of all runs; NaN where it is not known. A `Sample`
        of the model has that of its continuous states.
    states : collection of Variable, optional
        Those compared; without, all of an oracle's, or those of a truth alone.
    steps : int, optional
        T, where no plain array of the evidence tells.
    progress : bool or callable
        As for `infer`: of an oracle's run, then of the rows.

    Raises
    ------
    ModelError
        If the model is no dynamic network of Gaussian CPDs, or a lineariser, schedule, row, oracle,
        truth or state is none, or does not fit the model, its runs or its steps; or if a function
        of the model, or a lineariser, fails by itself.
    EvidenceError
        If the evidence does not fit the model, or a row's.
    PgmError
        If the oracle's own run fails.

    References
    ----------
    Efron & Stein, The jackknife estimate of variance, 1981; Vehtari, Simpson, Gelman, Yao & Gabry,
    Pareto smoothed importance sampling, 2024.

    Examples
    --------
    >>> from pgm.examples import walk, x, z
    >>> evidence = {z: [[2.0], [3.0]]}
    >>> found = pgm.compare(walk, evidence, oracle=pgm.Grid({"x": (-8.0, 12.0, 400)}))
    >>> found["Taylor", "filter"].kl < 1e-3
    True
    >>> wider = pgm.smooth(walk, {z: [[2.0], [3.0]]}, belief=pgm.Particles(2000, seed=1))
    >>> found = pgm.compare(walk, evidence, rows={"2,000 particles": wider}, oracle=wider)
    >>> found["2,000 particles"].kl_error < 0.01
    True
    """
    methods = _methods(linearisers, rows, model)
    plans = entries.named(
        schedules, "schedules", "schedules=[pgm.Filtering()]", entries.schedule_name
    )
    for plan in plans.values():
        entries.require_schedule(plan)
    oracles, true = _parted(oracle, truth)
    if not is_whole(repeats) or repeats < 4:
        raise ModelError(f"repeats is a whole number of runs, 4 or more, not {repeats!r}")
    bound = bind_chain(model, evidence, steps)
    if model.discrete:
        raise ModelError(
            "a network of tables is exact by pgm.filter and pgm.smooth: there is nothing to "
            "linearise, and nothing to compare"
        )
    things = _things(rows, model)
    values = None if true is None else _of_states(true, model)
    chosen = as_states(model, states, None if oracles else values)
    compared = Compared(compile(model, bound.steps), evidence, bound.lead, chosen, ())
    known = _truths(values or {}, compared, model)
    every = entries.of_methods(methods, plans, compared)
    every += entries.of_rows(things, plans, compared, lambda other: _bound(other, compared))
    _require_different(every)
    compared = compared._replace(kinds=tuple(dict.fromkeys(each.kind for each in every)))
    for name, each in oracles.items():
        require_oracle(each, name if len(oracles) > 1 else "")
    require_judges(oracles.values(), compared.kinds)
    with reporting(progress):
        found = {name: references(each, compared, repeats) for name, each in oracles.items()}
        drafts = [
            draft
            for entry in counted(every, "rows")
            for draft in _drafted(entry, compared, found, known)
        ]
    own = _disagreements(found, compared, known)
    judges = [_described(each) for each in oracles.values()]
    if judges and known and truth is None:  # which stands among the oracles
        judges.append(f"the truth of {listed(known)}")
    title = "; ".join(judges)
    told = [ref.status for refs in found.values() for ref in refs.values() if ref.status]
    status = "; ".join(dict.fromkeys(told))
    rows_found = _weighed(drafts, found, own)
    return Comparison(rows_found, own, bound.steps, bound.lead, title, status, tuple(oracles))


class _Draft(NamedTuple):
    """A row before its marks, and the parts that groups of each oracle have in its errors."""

    row: Row
    parts: Mapping[str, Parts | None]


def _drafted(
    entry: Entry,
    compared: Compared,
    found: Mapping[str, Mapping[tuple[Kind, Variable], Reference]],
    truth: Mapping[Variable, Array],
) -> list[_Draft]:
    """The rows of an entry, of each state, judged by each oracle that has beliefs of its kind."""
    count = compared.graph.steps + 1
    names = {s: Name(entry.label, entry.schedule, s, entry.kind) for s in entry.states}
    # A family that only filters, or has no moments, is a row beside the others.
    failures: tuple[type[PgmError], ...] = FAILURES
    if entry.lenient:
        failures = (*FAILURES, ModelError, EvidenceError)
    began = time.perf_counter()
    try:
        posterior = entry.run()
    except failures as error:
        seconds = time.perf_counter() - began
        return [
            _Draft(failed(name, count, truth.get(state), error, seconds=seconds), {})
            for state, name in names.items()
        ]
    rest: dict[str, Any] = {} if entry.given else {"seconds": time.perf_counter() - began}
    evidence = getattr(posterior, "log_evidence", None)
    if evidence is not None:
        rest["log_evidence"] = float(np.mean(evidence))
        rest["log_evidence_kind"] = str(getattr(posterior, "log_evidence_kind", ""))
    if entry.iterated:
        rest["converged"] = float(posterior.status.converged.mean())
    drafts = []
    for state, name in names.items():
        try:
            belief = entries.belief_of(posterior, state)
            if isinstance(belief, Track):
                row = of_track(name, belief.values, truth.get(state), **rest)
                drafts.append(_Draft(row, {}))
                continue
            drafts.append(_judged(name, belief, found, truth.get(state), rest))
        except failures as error:
            drafts.append(_Draft(failed(name, count, truth.get(state), error, **rest), {}))
    return drafts


def _judged(
    name: Name,
    belief: Gaussian,
    found: Mapping[str, Mapping[tuple[Kind, Variable], Reference]],
    truth: Array | None,
    rest: Mapping[str, Any],
) -> _Draft:
    key = name.kind, name.state
    judging = {oracle: refs[key] for oracle, refs in found.items() if key in refs}
    kept = _kept(belief, judging)
    each = {oracle: judge(reference, belief, kept) for oracle, reference in judging.items()}
    judgements = {
        oracle: replace(judgement, weak=hidden(judging[oracle], belief, kept))
        for oracle, (judgement, _) in each.items()
    }
    row = scored(name, belief, truth, kept, judgements, **rest)
    return _Draft(row, {oracle: parts for oracle, (_, parts) in each.items()})


def _kept(belief: Gaussian, judging: Mapping[str, Reference]) -> Mask:
    """The steps at which the belief and all oracles have regular, finite covariances."""
    kept = proper(belief)
    for reference in judging.values():
        kept &= proper(reference.gaussian)
    return kept


def _disagreements(
    found: Mapping[str, Mapping[tuple[Kind, Variable], Reference]],
    compared: Compared,
    truth: Mapping[Variable, Array],
) -> list[Row]:
    """The oracles' own rows: KL from their own Gaussians, and from those of other oracles."""
    rows = []
    for oracle, refs in found.items():
        for kind in compared.kinds:
            for state in compared.states:
                if (kind, state) not in refs:
                    continue
                own = refs[kind, state]
                judging = {o: r[kind, state] for o, r in found.items() if (kind, state) in r}
                kept = _kept(own.gaussian, judging)
                judgements = {
                    other: _itself(own, kept) if other == oracle else _between(reference, own, kept)
                    for other, reference in judging.items()
                }
                label = _LABEL + oracle if oracle != "oracle" else oracle
                rest = {name: getattr(own, name) for name in _TOLD}
                name = Name(label, kind.name, state, kind)
                rows.append(scored(name, own.gaussian, truth.get(state), kept, judgements, **rest))
    return rows


# How the row of an oracle is called, before the oracle's name.
_LABEL = "oracle: "
_TOLD = ("seconds", "log_evidence", "log_evidence_kind")


def _itself(own: Reference, kept: Mask) -> Judgement:
    none = np.full(kept.size, np.nan)
    return Judgement(np.where(kept, own.from_gaussian, np.nan), none, np.nan, own.doubt)


def _between(reference: Reference, own: Reference, kept: Mask) -> Judgement:
    """How far one oracle is from another, with the errors of both.

    The error of the one that stands for q is that of the KL in the other direction: to first order
    both are the same function of its moments.
    """
    there, back = judge(reference, own.gaussian, kept)[0], judge(own, reference.gaussian, kept)[0]
    if not kept.any():
        return there
    each = consistency.kl(own.gaussian[..., kept], reference.gaussian[..., kept])
    bias = np.zeros(kept.size)
    bias[kept] = each.reshape(-1, each.shape[-1]).mean(axis=0) - back.kl_by_step[kept]
    return Judgement(
        there.kl_by_step - bias,
        np.hypot(there.error_by_step, back.error_by_step),
        float(np.hypot(there.error, back.error)),
    )


def _weighed(
    drafts: Sequence[_Draft],
    found: Mapping[str, Mapping[tuple[Kind, Variable], Reference]],
    own: Sequence[Row],
) -> list[Row]:
    """The rows, marked where an oracle is too weak for them."""
    rows = [draft.row for draft in drafts]
    for oracle, refs in found.items():
        for (kind, state), reference in refs.items():
            places = [
                k
                for k, row in enumerate(rows)
                if (row.kind, row.state) == (kind, state) and oracle in row.by_oracle
            ]
            every = [
                Judged(
                    f"{rows[k].lineariser}, {rows[k].schedule}",
                    rows[k].by_oracle[oracle],
                    drafts[k].parts[oracle],
                )
                for k in places
            ]
            apart = {
                row.lineariser.removeprefix(_LABEL): row.by_oracle[oracle]
                for row in own
                if (row.kind, row.state) == (kind, state)
                and row.lineariser.removeprefix(_LABEL) != oracle
                and oracle in row.by_oracle
            }
            for k, judgement in zip(places, marked(reference, every, apart), strict=True):
                judgements = {**rows[k].by_oracle, oracle: judgement}
                rows[k] = replace(rows[k], by_oracle=judgements)
    return rows


def _methods(linearisers: Any, rows: Any, model: DynamicBayesianNetwork) -> dict[str, Method]:
    """The linearisers and families that are run under each schedule, by name."""
    if linearisers is None:
        linearisers = LINEARISERS if rows is None else {}
        if not linearisers:
            return {}
    methods: dict[str, Method] = entries.named(
        linearisers, "linearisers", "linearisers=[pgm.Taylor()]", entries.class_name
    )
    for method in methods.values():
        if isinstance(method, BeliefFamily):
            require_family(method, model)
        else:
            require_lineariser(method)
    return methods


def _things(rows: Any, model: DynamicBayesianNetwork) -> dict[str, Any]:
    """The user's rows by label, checked."""
    if rows is None:
        return {}
    if not isinstance(rows, Mapping):
        raise ModelError(
            f"rows= maps labels to rows, as in rows={{'best': posterior}}; found {titled(rows)}"
        )
    things = entries.named(rows, "rows", "rows={'best': posterior}", entries.class_name)
    for label, thing in things.items():
        entries.require_row(label, thing, model)
    return things


def _require_different(every: Sequence[Entry]) -> None:
    """Refuse two rows of one name, of which none could be asked for."""
    count = Counter((each.label, each.schedule) for each in every)
    for (label, schedule), number in count.items():
        if number > 1:
            raise ModelError(f"rows= and linearisers= have {label!r}, {schedule} both; rename one")


def _bound(model: DynamicBayesianNetwork, compared: Compared) -> DynamicGraph:
    """Another model compiled, after the evidence and the states were found to fit it."""
    missing = [state for state in compared.states if state not in model.states]
    if missing:
        raise ModelError(
            f"a model of rows= has no state {missing[0]!r}, which is compared; its states are "
            f"{listed(model.states)}",
            variable=missing[0],
        )
    bound = bind_chain(model, compared.evidence, compared.graph.steps)
    if bound.lead != compared.lead:
        raise ModelError(f"a model of rows= has runs {bound.lead}; {compared.lead} are compared")
    return compile(model, bound.steps)


def _parted(oracle: Any, truth: Any) -> tuple[dict[str, OneOracle], Truth | None]:
    """The oracles by name, and the truth, which may stand among them."""
    if isinstance(truth, Poses):
        raise ModelError(f"truth= is Poses; {VALUES}")
    if truth is not None and not isinstance(truth, Mapping | Sample):
        raise ModelError(
            "truth= maps states to their values (..., T+1, d), or is what model.sample() has "
            f"drawn, not {type(truth).__name__}"
        )
    found: dict[str, Any] = {}
    for name, each in _listed_oracles(oracle):
        if not isinstance(each, Mapping | Sample):
            found[name] = each
            continue
        if truth is not None:
            raise ModelError(
                "oracle= is or has a mapping of states, which is a truth, and truth= is given too; "
                "give the truth once, and as oracle= a pgm.Grid(...) or a posterior"
            )
        truth = each
    return found, truth


def _listed_oracles(oracle: Any) -> list[tuple[str, Any]]:
    if oracle is None:
        return []
    if isinstance(oracle, Mapping) and oracle and all(isinstance(key, str) for key in oracle):
        return list(oracle.items())
    if not isinstance(oracle, list | tuple):
        return [(_title(oracle), oracle)]
    titles = [_title(each) for each in oracle]
    names = [
        title if titles.count(title) == 1 else f"{title} {titles[: k + 1].count(title)}"
        for k, title in enumerate(titles)
    ]
    return list(zip(names, oracle, strict=True))


def _of_states(truth: Truth, model: DynamicBayesianNetwork) -> Mapping[Variable, Any]:
    """The truth by state; of a sample of the model that of its continuous states."""
    if not isinstance(truth, Sample):
        return truth
    for variable in truth.values:
        if variable not in model.variables:
            raise ModelError(
                f"the truth, a sample, has {variable!r}, {unknown_name(variable, model.variables)}",
                variable=variable,
            )
    continuous = [state for state in model.states if not isinstance(state, Discrete)]
    return {state: truth.values[state] for state in continuous if state in truth.values}


def as_states(
    model: DynamicBayesianNetwork, states: Any, truth: Mapping[Variable, Any] | None
) -> tuple[Variable, ...]:
    """The continuous states that are judged: those named, else those of a truth, or all."""
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
    truth: Mapping[Variable, Any], compared: Compared, model: DynamicBayesianNetwork
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


def _title(oracle: Any) -> str:
    """The name of an oracle that was given without one: its family's class, or "oracle"."""
    if isinstance(oracle, Mapping | Sample):
        return "truth"
    family = family_of_oracle(oracle)
    if family is None:
        return "Audit" if isinstance(oracle, Audit) else "oracle"
    return type(family).__name__


def _described(oracle: OneOracle) -> str:
    return titled(family_of_oracle(oracle) or oracle)
