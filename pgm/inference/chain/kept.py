"""Posteriors of chains of which only some marginals are kept."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NoReturn

from pgm.clustergraph import Cluster
from pgm.compile import DynamicGraph
from pgm.errors import EvidenceError, GraphError
from pgm.factors import CanonicalForm, Gaussian
from pgm.inference.chain.innovations import Innovations
from pgm.inference.chain.marginals import Marginals, located
from pgm.inference.kind import FILTERED, Kind
from pgm.inference.posterior import Posterior
from pgm.inference.status import Status
from pgm.kernels.arrays import Array
from pgm.variables import Variable


@dataclass(frozen=True, eq=False)
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
        Which readings the marginals know.
    log_evidence : ndarray
        (...).
    log_evidence_kind : str
        ``exact``, ``linearised`` or ``laplace``.

    Raises
    ------
    EvidenceError, GraphError
        If what was not kept is asked for.
    """

    graph: DynamicGraph
    status: Status
    kind: Kind
    _kept: Mapping[Variable, Gaussian]
    _log_evidence: Array
    _log_evidence_kind: str

    def __getitem__(self, variable: Variable) -> Gaussian:  # type: ignore[override]
        """The marginal of a variable that was kept, at all its steps or at one."""
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
    def log_evidence(self) -> Array:
        """The value ln p(readings), (...)."""
        return self._log_evidence

    @property
    def log_evidence_kind(self) -> str:
        """The kind of `log_evidence`: exact, linearised or laplace."""
        return self._log_evidence_kind

    @property
    def predicted(self) -> Marginals:
        """Not kept."""
        raise EvidenceError(self._missing("marginals given the readings before each step"))

    @property
    def filtered(self) -> Marginals:
        """Not kept."""
        here = self.kind == FILTERED
        what = "are posterior[x] here" if here else "are kept by pgm.filter(..., keep=[x])"
        raise EvidenceError(f"{self._missing('the forward pass')}; filtered marginals {what}")

    @property
    def innovations(self) -> Mapping[Variable, Innovations]:
        """Not kept."""
        raise EvidenceError(self._missing("innovations"))

    def joint(self, *variables: Variable) -> NoReturn:
        """Not kept."""
        raise EvidenceError(self._missing("joints"))

    def message(self, source: int | Cluster, target: int | Cluster) -> CanonicalForm:
        """Not kept."""
        raise GraphError(self._missing("messages"))

    def belief(self, cluster: int | Cluster) -> CanonicalForm:
        """Not kept."""
        raise GraphError(self._missing("beliefs of clusters"))

    def _missing(self, what: str) -> str:
        return (
            f"{what}: not kept, since keep= keeps {self.kind} marginals, log-evidence and status "
            "alone; leave keep= out to have everything"
        )

    def __repr__(self) -> str:
        runs = self._log_evidence.shape
        return (
            f"Posterior({self.kind}, kept {list(self._kept)}, steps 0..{self.graph.steps}"
            f"{f', runs {runs}' if runs else ''})"
        )
