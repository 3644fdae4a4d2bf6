"""Oracles: beliefs that are right, or nearer to it, of each kind that is compared."""

import time
from collections.abc import Iterable, Iterator, Mapping
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np

from pgm.beliefs.grid.belief import GridBelief
from pgm.beliefs.own.family import BeliefFamily
from pgm.beliefs.points.particle_belief import ParticleBelief
from pgm.boundary import as_floats
from pgm.comparison.reference import Reference
from pgm.compile import DynamicGraph
from pgm.errors import ModelError
from pgm.evidence import Evidence
from pgm.factors import Gaussian, GaussianMixture
from pgm.factors.scope import listed
from pgm.inference import (
    Filtering,
    FixedLag,
    Kind,
    Smoothing,
    infer,
)
from pgm.inference.audit import Audit
from pgm.inference.audit.result import ENOUGH
from pgm.kernels import sampled
from pgm.kernels.angles import difference
from pgm.kernels.arrays import Array
from pgm.posteriors.belief_kind import FILTERED, SMOOTHED
from pgm.posteriors.outcome import marginal
from pgm.posteriors.status import Status
from pgm.posteriors.verdict import Verdict
from pgm.variables import Variable


@runtime_checkable
class Oracle(Protocol):
    """An oracle as a comparison takes it: marginals over time, which say of which kind.

    A `Posterior` over time is one, of any beliefs, or anything of a user's
    own. Where it has ``filtered``, which is an oracle too, that stands for filters.

    Attributes
    ----------
    kind : Kind

    Examples
    --------
    >>> from pgm.examples import walk, z
    >>> smoothed = pgm.smooth(walk, {z: [[2.0], [3.0]]})
    >>> isinstance(smoothed, pgm.comparison.Oracle)
    True
    """

    @property
    def kind(self) -> Kind | None:
        """The kind of its beliefs: the measurements that they know; one without is refused."""

    def __getitem__(self, variable: Variable, /) -> Any:
        """The marginal over steps 0..T: a `Gaussian`, `GridBelief` or `ParticleBelief`.

        Or a belief of your own: with ``gaussian()``, that of its mean and covariance, and, if it
        has a density, ``non_gaussianity()``, KL from that Gaussian by run and step.
        """


class Compared(NamedTuple):
    """The subject of a comparison.

    kinds: Of the schedules.
    """

    graph: DynamicGraph
    evidence: Evidence
    lead: tuple[int, ...]
    states: tuple[Variable, ...]
    kinds: tuple[Kind, ...]


def require_oracle(oracle: Any, name: str) -> None:
    """Refuse an object that is no oracle; `name` is the user's, empty of a single one."""
    if isinstance(oracle, BeliefFamily | Audit):
        return
    if not isinstance(oracle, Oracle) or not isinstance(oracle.kind, Kind):
        raise ModelError(
            f"oracle={f' has {name!r}, which' if name else ''} is a pgm.Grid(...) or "
            "pgm.Particles(...), a posterior over time with .kind and marginals posterior[x], a "
            "pgm.audit(...), or a mapping of states to their truth (..., T+1, d), not "
            f"{type(oracle).__name__}"
        )


def judges(oracle: BeliefFamily[Any] | Audit | Oracle, kind: Kind) -> bool:
    """Whether an oracle has beliefs of a kind."""
    if isinstance(oracle, BeliefFamily):
        return True
    own = SMOOTHED if isinstance(oracle, Audit) else oracle.kind
    return kind == own or (kind == FILTERED and hasattr(oracle, "filtered"))


def require_judges(oracles: Iterable[Any], kinds: Iterable[Kind]) -> None:
    """Refuse oracles of which none has beliefs of a kind compared."""
    every = list(oracles)
    for kind in kinds:
        if every and not any(judges(oracle, kind) for oracle in every):
            own = ", ".join(
                str(SMOOTHED if isinstance(oracle, Audit) else oracle.kind) for oracle in every
            )
            raise ModelError(
                f"the oracle's beliefs are {own}, and a row's are {kind}, which know other "
                "measurements: give an oracle of that kind, or leave that row, or its schedule, "
                "out of rows= and schedules="
            )


def references(
    oracle: BeliefFamily[Any] | Audit | Oracle, compared: Compared, repeats: int
) -> dict[tuple[Kind, Variable], Reference]:
    """The oracle's beliefs, of each kind that it has, and state; a family is run here.

    oracle: As `require_oracle` lets it pass.
    repeats: How often an oracle whose draws have a seed is run in all.
    """
    if isinstance(oracle, Audit):
        return {(SMOOTHED, state): _audited(oracle, state, compared) for state in compared.states}
    kinds = tuple(kind for kind in compared.kinds if judges(oracle, kind))
    found: dict[tuple[Kind, Variable], list[Reference]] = {}
    for each in _repeated(oracle, compared, repeats):
        for kind, posterior, seconds in _of_each_kind(each, compared, kinds):
            for state in compared.states:
                reference = _referred(posterior, state, compared, seconds)
                found.setdefault((kind, state), []).append(reference)
    return {key: each[0] if len(each) == 1 else _pooled(each) for key, each in found.items()}


def _repeated(oracle: Any, compared: Compared, repeats: int) -> Iterator[Any]:
    """The oracle, and itself with other seeds, where its family can be given them.

    A posterior is run again on the graph and the evidence that it was made with.
    """
    yield oracle
    family: Any = family_of_oracle(oracle)
    given = oracle is not family
    again = getattr(getattr(oracle, "_outcome", oracle), "again", None)
    if hasattr(family, "with_seed") and (again or not given):
        for other in range(1, repeats):
            seed = family.seed + other
            yield again(seed) if given and again else family.with_seed(seed)


def family_of_oracle(oracle: Any) -> BeliefFamily[Any] | None:
    """The family of beliefs that an oracle is, or has; None of one that the network decided."""
    found = oracle if isinstance(oracle, BeliefFamily) else getattr(oracle, "family", None)
    return found if isinstance(found, BeliefFamily) else None


def _of_each_kind(
    oracle: Any, compared: Compared, kinds: tuple[Kind, ...]
) -> Iterable[tuple[Kind, Any, float]]:
    if not isinstance(oracle, BeliefFamily):
        for kind in kinds:
            # A filtered posterior is its own forward sweep.
            yield kind, (oracle if kind == oracle.kind else oracle.filtered), np.nan
        return
    ran: dict[Kind, Any] = {}
    # The smoother first: the filter's beliefs come with it.
    for kind in sorted(kinds, key=lambda kind: -kind.lag):
        seconds = np.nan
        if kind == FILTERED and ran:
            ran[kind] = next(iter(ran.values())).filtered
        else:
            began = time.perf_counter()
            ran[kind] = infer(
                compared.graph, compared.evidence, schedule=_schedule(kind), belief=oracle
            )
            seconds = time.perf_counter() - began
        yield kind, ran[kind], seconds


def _schedule(kind: Kind) -> Filtering | FixedLag | Smoothing:
    if kind == SMOOTHED:
        return Smoothing()
    return Filtering() if kind == FILTERED else FixedLag(int(kind.lag))


def _referred(posterior: Any, state: Variable, compared: Compared, seconds: float) -> Reference:
    """A posterior's belief of a state as a reference, by itself."""
    gaussian = gaussian_of(posterior, state, compared, "the oracle's marginal")
    belief = posterior[state]
    count = compared.graph.steps + 1
    evidence = getattr(posterior, "log_evidence", None)
    kind = str(getattr(posterior, "log_evidence_kind", ""))
    status = getattr(posterior, "status", None)
    few = isinstance(belief, ParticleBelief) and bool(getattr(status, "few", False))
    doubt = "fewer than ten of its particles are effective at a step" if few else ""
    told = [status._title] if isinstance(status, Status) and status._phrases else []
    verdict = getattr(posterior, "verdict", None)
    bound = None
    if isinstance(verdict, Verdict):
        bound, told = verdict.within, [verdict.headline, *told]
        if not verdict.vouched.all():
            doubt = f"an estimate that is {verdict.headline}"
    elif kind in _NEARLY:
        doubt = f"its beliefs are approximate ({kind}), and nothing tells by how much"
    return Reference(
        gaussian,
        _apart(belief, gaussian, state).reshape(-1, count).mean(axis=0),
        error=0.0 if _without_draws(belief, kind) else np.nan,
        doubt=doubt,
        within=bound,
        seconds=seconds,
        log_evidence=np.nan if evidence is None else float(np.mean(evidence)),
        log_evidence_kind=kind,
        status="; ".join(told),
    )


# Kinds of the log-evidence of beliefs that are not exact, and have no figures of their error.
_NEARLY = "linearised", "laplace", "linearised bound", "bound", "unnormalised", "merged", "modes"


def _without_draws(belief: Any, kind: str) -> bool:
    """Whether a belief is known to be made without draws, so that it has no Monte Carlo error."""
    return isinstance(belief, Gaussian | GridBelief) or (
        isinstance(belief, GaussianMixture) and kind != "draws"
    )


def _pooled(each: list[Reference]) -> Reference:
    """The belief of one oracle that was run with several seeds, each run being a group."""
    first = each[0].gaussian
    mean, cov = (np.stack([getattr(r.gaussian, name) for r in each]) for name in ("mean", "cov"))
    offset = difference(mean, first.mean, first.angles)
    mass = np.ones(offset.shape[:-1])
    squares = cov + offset[..., :, None] * offset[..., None, :]
    shift = offset.mean(axis=0)
    pooled = squares.mean(axis=0) - shift[..., :, None] * shift[..., None, :]
    parts = sampled.spread(mass, offset, squares, shift, pooled)
    worth = sampled.worth(parts, pooled) / len(each)
    doubt = next((r.doubt for r in each if r.doubt), "")
    if not doubt and worth.size and worth.min() < ENOUGH:
        step = int(np.unravel_index(int(worth.argmin()), worth.shape)[-1])
        doubt = (
            f"its runs with other seeds differ as much as if each had {worth.min():.2g} draws at "
            f"step {step}"
        )
    return each[0]._replace(
        gaussian=Gaussian._make(first.scope, first.mean + shift, pooled, first.steps),
        from_gaussian=np.mean([r.from_gaussian for r in each], axis=0),
        spread=parts,
        doubt=doubt,
        seconds=float(np.sum([r.seconds for r in each])),
        log_evidence=float(np.mean([r.log_evidence for r in each])),
    )


def _audited(audit: Audit, state: Variable, compared: Compared) -> Reference:
    """The exact moments that an audit has estimated, as a reference."""
    if state not in audit.corrected:
        raise ModelError(
            f"the audit has no moments of {state!r}; it has those of "
            f"{listed(tuple(audit.corrected))}: audit a posterior of this model",
            variable=state,
        )
    gaussian = gaussian_of(Held(audit.corrected), state, compared, "the audit's belief")
    spread, doubt = audit._spreads.get(state), ""
    if not audit.trusted.all():
        k, draws = float(audit.pareto_k.max()), float(audit.effective_draws.min())
        missed = float(np.nanmax(audit.missed, initial=0.0))
        doubt = (
            f"an audit that is not trusted: Pareto shape {k:.2g}, {draws:.3g} effective draws, "
            f"{missed:.2g} of the mass in modes not drawn from"
        )
    elif spread is None:
        doubt = "an audit of so many runs and steps that its errors were not kept"
    return Reference(
        gaussian,
        np.full(compared.graph.steps + 1, np.nan),
        spread=spread,
        error=np.nan,
        doubt=doubt,
        log_evidence=float(audit.log_evidence.mean()),
        log_evidence_kind="corrected",
        status=audit._title,
    )


class Held(NamedTuple):
    """Marginals that are held in a mapping."""

    marginals: Mapping[Variable, Any]

    def __getitem__(self, variable: Any) -> Any:
        return self.marginals[variable]


def gaussian_of(posterior: Any, state: Variable, compared: Compared, whose: str) -> Gaussian:
    """The Gaussian of the mean and covariance of a belief over steps 0..T.

    whose: The belief, for the text of an error, such as "the oracle's marginal".
    """
    count = compared.graph.steps + 1
    belief = posterior[state]
    gaussian = belief
    if not isinstance(belief, Gaussian):
        # Or what a family whose marginals are of its own form makes of their moments.
        own = hasattr(belief, "gaussian")
        gaussian = belief.gaussian() if own else marginal(posterior, state)
    if not isinstance(gaussian, Gaussian):
        raise ModelError(
            f"{whose} of {state!r} is a {type(belief).__name__}; a pgm.Gaussian, "
            "a pgm.results.GridBelief or a pgm.results.ParticleBelief over steps 0..T was due, or "
            "a belief of your own that has gaussian()",
            variable=state,
        )
    due = (*compared.lead, count, state.dimension)
    steps = gaussian.steps
    if (
        gaussian.scope != (state,)
        or gaussian.mean.shape not in (due, due[-2:])
        or (steps is not None and steps.tolist() != list(range(count)))
    ):
        raise ModelError(
            f"{whose} of {state!r} is over {listed(gaussian.scope)} with means of "
            f"shape {gaussian.mean.shape}; {due} was due: the same model, runs and steps 0.."
            f"{count - 1} as are compared",
            variable=state,
        )
    return gaussian


def _apart(belief: Any, gaussian: Gaussian, state: Variable) -> Array:
    """KL(p ‖ N_p) of the oracle's belief p, (*runs, T+1), as it tells by `non_gaussianity`.

    NaN of a belief that does not, as draws, which have no density to integrate.
    """
    lead = gaussian.mean.shape[:-1]
    if isinstance(belief, Gaussian):
        return np.zeros(lead)
    if not hasattr(belief, "non_gaussianity"):
        return np.full(lead, np.nan)
    whose = f"non_gaussianity() of the oracle's marginal of {state!r}"
    found = as_floats(belief.non_gaussianity(), whose, ModelError)
    if found.shape != lead:
        raise ModelError(
            f"{whose} has shape {found.shape}; {lead} was due: KL by run and step",
            variable=state,
        )
    return found
