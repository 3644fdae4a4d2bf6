"""Marginals over time, joints of several steps, and posteriors of which only marginals are kept."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import NoReturn

import numpy as np

from pgm.clustergraph import Cluster
from pgm.compile import DynamicGraph, SliceLayout
from pgm.display import NoArray, Shown, Summary
from pgm.errors import EvidenceError, GraphError
from pgm.factors import CanonicalForm, Gaussian
from pgm.factors.scope import Scope, as_scope, listed, positions
from pgm.inference.associations import Found
from pgm.inference.chain.backward import Beliefs, Reverse
from pgm.inference.chain.innovations import Innovations
from pgm.inference.lost import Lost
from pgm.inference.posterior import Posterior, require_variable
from pgm.inference.rejections import Rejections
from pgm.inference.status import FILTERED, Kind, Status
from pgm.inference.summaries import marginals_over_time, over_time
from pgm.kernels.arrays import Array, Integers, block, transpose
from pgm.variables import Variable

# Rows that are mirrored at once: a block and its mirror image stay in the processor's cache.
_ROWS = 256


def joint_moments(
    reverse: Reverse, beliefs: Beliefs, layout: SliceLayout, variables: Sequence[Variable]
) -> tuple[Array, Array]:
    r"""Mean (runs, n) and covariance (runs, n, n) of variables at steps.

    With the gain A_t of the slice at t given the one at t + 1, the covariance of the slice at s
    with those of all later steps is that of its successor, moved back once:

        cov(x_s, x_t) = A_s cov(x_{s+1}, x_t),    t > s,

    so that going back once, from the latest step wanted, gives all rows, each in one product.
    """
    steps = [variable.step for variable in variables if variable.step is not None]
    order = sorted(range(len(variables)), key=steps.__getitem__)
    latest, first = steps[order[-1]], steps[order[0]]
    starts = np.cumsum([0, *(variables[k].dimension for k in order)])
    due: dict[int, list[tuple[slice, Integers]]] = {}
    everywhere = np.arange(beliefs.mean.shape[-1])
    for k, (begin, end) in zip(order, pairwise(starts.tolist()), strict=True):
        places = everywhere[layout.places[variables[k].template]]
        due.setdefault(steps[k], []).append((slice(begin, end), places))
    runs, size = beliefs.mean.shape[1], int(starts[-1])
    mean, cov = np.empty((runs, size)), np.empty((runs, size, size))
    at, spread = beliefs.mean[latest], beliefs.cov[latest]
    # The covariance of the whole slice at a step with the components wanted from that step on,
    # which stand from `start` on.
    cross, start = np.empty((runs, everywhere.size, size)), size
    for step in range(latest, first - 1, -1):
        if step < latest:
            at, spread = reverse.back(step, (at, spread))
            cross[..., start:] = _gain(reverse, step) @ cross[..., start:]
        for rows, places in due.get(step, []):
            cross[..., rows] = spread[..., places]
            mean[:, rows] = at[:, places]
            start = min(start, rows.start)
        for rows, places in due.get(step, []):
            cov[:, rows, start:] = cross[:, places, start:]
    _mirror(cov)
    if order == sorted(order):
        return mean, cov
    # Where each component of the result stands among those sorted by step.
    place = np.concatenate(
        [np.arange(*starts[[k, k + 1]]) for k in np.argsort(order, kind="stable")]
    )
    return mean[:, place], cov[:, place[:, None], place]


def _gain(reverse: Reverse, step: int) -> Array:
    gain: Array = reverse.states.matrix[step]
    return gain if reverse.slices is None else reverse.slices.matrix[step] @ gain


def _mirror(cov: Array) -> None:
    size = cov.shape[-1]
    for start in range(0, size, _ROWS):
        rows = slice(start, start + _ROWS)
        block = cov[:, rows, rows]
        above = np.triu(block)
        block[...] = above + transpose(np.triu(block, 1))
        for other in range(start + _ROWS, size, _ROWS):
            later = slice(other, other + _ROWS)
            cov[:, later, rows] = transpose(cov[:, rows, later])


@dataclass(frozen=True, eq=False, repr=False)
class Marginals(Shown, NoArray):
    """The marginals of hidden variables over all steps, by variable.

    Attributes
    ----------
    kind : Kind
        Which measurements they know.
    """

    layout: SliceLayout
    beliefs: Beliefs
    lead: tuple[int, ...]
    kind: Kind

    def __getitem__(self, variable: Variable) -> Gaussian:
        """The marginal of ``x`` at all its steps, stacked; of ``x.at(3)`` at one, (*runs, d).

        Raises
        ------
        EvidenceError
            If the variable is not hidden, or has no such step.
        """
        layout, last = self.layout, self.beliefs.mean.shape[0] - 1
        template, first = located(layout, variable, last)
        places = positions(layout.slice, [template])
        if variable.step is not None:
            mean = self.beliefs.mean[variable.step][:, places]
            cov = block(self.beliefs.cov[variable.step], places, places)
            shape = self.lead
            return Gaussian._make(
                (variable,),
                mean.reshape(*shape, mean.shape[-1]),
                cov.reshape(*shape, *cov.shape[-2:]),
            )
        mean = self.beliefs.mean[first:][..., places].swapaxes(0, 1)
        cov = block(self.beliefs.cov[first:], places, places).swapaxes(0, 1)
        return Gaussian._make(
            (variable,),
            mean.reshape(*self.lead, *mean.shape[1:]),
            cov.reshape(*self.lead, *cov.shape[1:]),
            np.arange(first, last + 1),
        )

    @property
    def _title(self) -> str:
        runs = f", runs {self.lead}" if self.lead else ""
        return f"Marginals({self.kind}, steps 0..{self.beliefs.mean.shape[0] - 1}{runs})"

    def _summary(self) -> Summary:
        last = self.beliefs.mean.shape[0] - 1
        return marginals_over_time(self._title, self, self.layout, self.lead, last)


def located(layout: SliceLayout, variable: Variable, last: int) -> tuple[Variable, int]:
    """The template of a hidden variable, and its first step; refuses what has no marginal."""
    template = require_variable(variable).template
    if template in layout.model.inputs:
        raise EvidenceError(
            f"{variable!r} is observed: its value is its evidence", variable=variable
        )
    if template in layout.model.sensors:
        where = "its value is its evidence"
        if not layout.model.discrete:
            where = f"see posterior.innovations[{variable.name}]"
        raise EvidenceError(f"{variable!r} is observed; {where}", variable=variable)
    if variable.lag or template not in layout.slice:
        raise EvidenceError(
            f"{variable!r} is not among the hidden variables, {list(layout.slice)}",
            variable=variable,
        )
    first = 0 if template in layout.states else 1
    if variable.step is not None and not first <= variable.step <= last:
        raise EvidenceError(
            f"{template!r} has steps {first}..{last}; there is no {variable!r}",
            variable=variable,
            step=variable.step,
        )
    return template, first


def require_at_steps(layout: SliceLayout, variables: Sequence[Variable], last: int) -> Scope:
    """The scope of a joint; refuses variables that are not hidden ones at steps, or none."""
    if not variables:
        raise EvidenceError("joint takes variables at steps, like x.at(3), x.at(4)")
    scope = as_scope(variables)
    for variable in scope:
        if variable.step is None:
            raise EvidenceError(
                f"a joint is of variables at steps; write {variable.name}.at(3)", variable=variable
            )
        located(layout, variable, last)
    return scope


@dataclass(frozen=True, eq=False, repr=False)
class KeptPosterior(Posterior):
    """The marginals of some hidden variables at all their steps, and nothing else.

    What `filter`, `smooth` and `infer` return with ``keep=[x]``: ``posterior[x]``, with means
    (..., T+1, d) of a state and (..., T, d) of a hidden control, and ``posterior[x.at(3)]`` are
    those of a `ChainPosterior`.

    Attributes
    ----------
    graph : DynamicGraph
    status : Status
        Linearisations, residuals, and whether they converged.
    kind : Kind
        Which measurements the marginals know.
    log_evidence : ndarray
        (...).
    log_evidence_kind : str
        ``exact``, ``linearised`` or ``laplace``.
    associations : mapping of Variable to Associations
        By sensor, of sightings that left open what was seen, with `unknown`.

    Raises
    ------
    EvidenceError, GraphError
        If what was not kept is asked for.

    Examples
    --------
    >>> from pgm.examples import walk, x, z
    >>> posterior = pgm.smooth(walk, {z: [[4.0]]}, keep=x)
    >>> posterior[x].mean.ravel()
    array([1., 2.])
    >>> posterior[x.at(0)].cov
    array([[0.75]])
    """

    graph: DynamicGraph
    status: Status
    kind: Kind
    _kept: Mapping[Variable, Gaussian]
    _log_evidence: Array
    _log_evidence_kind: str
    associations: Found = field(default_factory=dict)

    def __getitem__(self, variable: Variable) -> Gaussian:  # type: ignore[override]
        """The marginal of a variable that was kept, at all its steps or at one.

        Raises
        ------
        EvidenceError
            If it was not kept, or is not hidden.
        """
        template, first = located(self.graph.layout, variable, self.graph.steps)
        if template not in self._kept:
            wanted = ", ".join(v.name for v in (*self._kept, template))
            raise EvidenceError(
                f"{template!r} was not kept; ask for it, keep=[{wanted}]", variable=variable
            )
        found = self._kept[template]
        if variable.step is None:
            return found
        at = variable.step - first
        return Gaussian._make((variable,), found.mean[..., at, :], found.cov[..., at, :, :])

    @property
    def _hidden(self) -> Scope:
        return tuple(self._kept)

    @property
    def log_evidence(self) -> Array:
        """The value ln p(measurements), (...)."""
        return self._log_evidence

    @property
    def log_evidence_kind(self) -> str:
        """The kind of `log_evidence`: exact, linearised or laplace."""
        return self._log_evidence_kind

    @property
    def predicted(self) -> Marginals:
        """Not kept: raises EvidenceError."""
        raise EvidenceError(self._missing("marginals given the measurements before each step"))

    @property
    def filtered(self) -> Marginals:
        """Not kept: raises EvidenceError."""
        here = self.kind == FILTERED
        what = "are posterior[x] here" if here else "are kept by pgm.filter(..., keep=[x])"
        raise EvidenceError(f"{self._missing('the forward pass')}; filtered marginals {what}")

    @property
    def innovations(self) -> Mapping[Variable, Innovations]:
        """Not kept: raises EvidenceError."""
        raise EvidenceError(self._missing("innovations"))

    @property
    def rejected(self) -> Mapping[Variable, Rejections]:
        """Not kept: raises EvidenceError."""
        raise EvidenceError(self._missing("rejections by gates"))

    @property
    def lost(self) -> Lost:
        """Not kept: raises EvidenceError."""
        raise EvidenceError(self._missing("innovations, which tell where a belief was lost"))

    def joint(self, *variables: Variable) -> NoReturn:
        """Not kept: raises EvidenceError."""
        raise EvidenceError(self._missing("joints"))

    def message(self, source: int | Cluster, target: int | Cluster) -> CanonicalForm:
        """Not kept: raises GraphError."""
        raise GraphError(self._missing("messages"))

    def belief(self, cluster: int | Cluster) -> CanonicalForm:
        """Not kept: raises GraphError."""
        raise GraphError(self._missing("beliefs of clusters"))

    def potential(self, cluster: int | Cluster) -> CanonicalForm:
        """Not kept: raises GraphError."""
        raise GraphError(self._missing("potentials of clusters"))

    def _missing(self, what: str) -> str:
        return (
            f"{what}: not kept, since keep= keeps {self.kind} marginals, log-evidence and status "
            "alone; leave keep= out to have everything"
        )

    @property
    def _title(self) -> str:
        runs = self._log_evidence.shape
        return (
            f"Posterior({self.kind}, kept [{listed(self._kept)}], steps 0..{self.graph.steps}"
            f"{f', runs {runs}' if runs else ''})"
        )

    def _summary(self) -> Summary:
        runs, last = self._log_evidence.shape, self.graph.steps
        return over_time(self._title, self, tuple(self._kept), runs, last)
