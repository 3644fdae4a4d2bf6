"""Oracles: beliefs that are right, or nearer to it, of each kind that is compared."""

import time
from collections.abc import Iterable
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np

from pgm.beliefs.own.family import BeliefFamily
from pgm.boundary import as_floats
from pgm.compile import DynamicGraph
from pgm.errors import ModelError
from pgm.evidence import Evidence
from pgm.factors import Gaussian
from pgm.factors.scope import listed
from pgm.inference import (
    Filtering,
    FixedLag,
    Kind,
    Smoothing,
    infer,
)
from pgm.kernels.arrays import Array
from pgm.posteriors.belief_kind import FILTERED, SMOOTHED
from pgm.posteriors.outcome import marginal
from pgm.posteriors.status import Status
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


class Reference(NamedTuple):
    """The oracle's belief of a state over steps 0..T.

    gaussian: Of its mean and covariance, (*runs, T+1, d).
    from_gaussian: (T+1,), in nats, the mean over runs: KL from that Gaussian; NaN of beliefs that
        tell none, as particles.
    seconds: Of the oracle's call; NaN if it was made with another, or given.
    log_evidence: The mean over runs; NaN if the oracle has none.
    status: The figures of its family of beliefs, such as a grid, in words; empty without any.
    """

    gaussian: Gaussian
    from_gaussian: Array
    seconds: float
    log_evidence: float
    log_evidence_kind: str
    status: str


class Compared(NamedTuple):
    """The subject of a comparison.

    kinds: Of the schedules.
    """

    graph: DynamicGraph
    evidence: Evidence
    lead: tuple[int, ...]
    states: tuple[Variable, ...]
    kinds: tuple[Kind, ...]


def require_oracle(oracle: Any, kinds: Iterable[Kind]) -> None:
    """Refuse an object that is no oracle, or an oracle without beliefs of a kind compared."""
    if isinstance(oracle, BeliefFamily):
        return
    if not isinstance(oracle, Oracle) or not isinstance(oracle.kind, Kind):
        raise ModelError(
            "oracle= is a pgm.Grid(...), a posterior over time with .kind and marginals "
            "posterior[x], or a mapping of states to their truth (..., T+1, d), not "
            f"{type(oracle).__name__}"
        )
    for kind in kinds:
        if kind != oracle.kind and not (kind == FILTERED and hasattr(oracle, "filtered")):
            raise ModelError(
                f"the oracle's beliefs are {oracle.kind}, and a schedule's are {kind}, which know "
                "other measurements: give an oracle of that kind, or leave that schedule out of "
                "schedules="
            )


def references(
    oracle: BeliefFamily[Any] | Oracle, compared: Compared
) -> dict[tuple[Kind, Variable], Reference]:
    """The oracle's beliefs, of each kind and state; a grid is run here.

    oracle: As `require_oracle` lets it pass.
    """
    found = {}
    for kind, posterior, seconds in _of_each_kind(oracle, compared):
        evidence = getattr(posterior, "log_evidence", None)
        mean = np.nan if evidence is None else float(np.mean(evidence))
        name = str(getattr(posterior, "log_evidence_kind", ""))
        status = getattr(posterior, "status", None)
        words = status._title if isinstance(status, Status) and status._told else ""
        for state in compared.states:
            gaussian, apart = _gaussian(posterior, state, compared)
            found[kind, state] = Reference(gaussian, apart, seconds, mean, name, words)
    return found


def _of_each_kind(
    oracle: BeliefFamily[Any] | Oracle, compared: Compared
) -> Iterable[tuple[Kind, Any, float]]:
    if not isinstance(oracle, BeliefFamily):
        for kind in compared.kinds:
            # A filtered posterior is its own forward sweep.
            yield kind, (oracle if kind == oracle.kind else oracle.filtered), np.nan  # type: ignore[attr-defined]
        return
    ran: dict[Kind, Any] = {}
    # The smoother first: the filter's beliefs come with it.
    for kind in sorted(compared.kinds, key=lambda kind: -kind.lag):
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


def _gaussian(posterior: Any, state: Variable, compared: Compared) -> tuple[Gaussian, Array]:
    """The Gaussian of the mean and covariance of the oracle's belief, and KL from it, (T+1,)."""
    count = compared.graph.steps + 1
    belief = posterior[state]
    gaussian = belief
    if not isinstance(belief, Gaussian):
        # Or what a family whose marginals are of its own form makes of their moments.
        own = hasattr(belief, "gaussian")
        gaussian = belief.gaussian() if own else marginal(posterior, state)
    if not isinstance(gaussian, Gaussian):
        raise ModelError(
            f"the oracle's marginal of {state!r} is a {type(belief).__name__}; a pgm.Gaussian, "
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
            f"the oracle's marginal of {state!r} is over {listed(gaussian.scope)} with means of "
            f"shape {gaussian.mean.shape}; {due} was due: the same model, runs and steps 0.."
            f"{count - 1} as are compared",
            variable=state,
        )
    return gaussian, _apart(belief, gaussian, state).reshape(-1, count).mean(axis=0)


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
