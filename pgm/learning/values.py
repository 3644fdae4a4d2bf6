"""The values of learning: the parts of CPDs that users declare, and the result."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from pgm.arguments import public
from pgm.boundary import as_floats, is_number
from pgm.cpds import CPD, SwitchingCPD
from pgm.display import InCode, Listing, Shown, Summary, few, number
from pgm.errors import ModelError
from pgm.immutable import Immutable
from pgm.kernels.arrays import Array
from pgm.networks import BayesianNetwork, DynamicBayesianNetwork
from pgm.variables import Variable

KINDS = ("full", "diagonal", "scaled")


@public
@dataclass(frozen=True)
class Covariance(InCode):
    """The noise covariance of a CPD.

    Parameters
    ----------
    kind : {'full', 'diagonal', 'scaled'}
        Any covariance; variances of independent components; or one factor on the CPD's own, which
        may be ``pgm.noise(...)``.
    lower, upper : float
        Bounds of the eigenvalues, of the variances, or of the factor: 0 ≤ lower ≤ upper.

    Examples
    --------
    >>> pgm.learning.Covariance("diagonal", lower=1e-6)
    Covariance(kind='diagonal', lower=1e-06, upper=inf)
    """

    kind: Literal["full", "diagonal", "scaled"] = "full"
    lower: float = 0.0
    upper: float = math.inf

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise ModelError(f"{self!r}: kind is one of {', '.join(map(repr, KINDS))}")
        if not (is_number(self.lower) and is_number(self.upper)) or not (
            0.0 <= self.lower <= self.upper
        ):
            raise ModelError(f"{self!r}: lower and upper are numbers, 0 <= lower <= upper")


@public
@dataclass(frozen=True)
class Coefficients(InCode):
    """The matrices of a `LinearGaussianCPD`.

    Parameters
    ----------
    free : mapping of Variable to array_like of bool, optional
        By parent, (d, dimension of it) or one for all: which entries are learnt; the others, and
        parents not named, stay as they are. Without it all are learnt.

    Examples
    --------
    >>> x = pgm.Variable("x", components=("position", "velocity"))
    >>> free = pgm.learning.Coefficients({x.previous: [[False, True], [False, True]]})
    """

    free: Mapping[Variable, npt.ArrayLike] | None = None

    def __post_init__(self) -> None:
        if self.free is not None and not isinstance(self.free, Mapping):
            raise ModelError(
                "Coefficients(free): maps parents to masks, {x.previous: True}; found "
                f"{self.free!r}"
            )


@public
@dataclass(frozen=True)
class Offset(InCode):
    """The offset of a `LinearGaussianCPD`, or the mean of a `GaussianCPD`.

    Parameters
    ----------
    free : array_like of bool
        (d,), or one for all: which components are learnt; the others stay as they are.

    Examples
    --------
    >>> pgm.learning.Offset([True, False])
    Offset(free=[True, False])
    """

    free: npt.ArrayLike = True


@public
@dataclass(frozen=True)
class Parameter(InCode):
    """A constant that functions of CPDs take as a parent: a scale, an offset, a lever arm.

    The parent is an input of the model, left out of the evidence: its value is what is learnt.

    Parameters
    ----------
    start : array_like
        (d,): the value to begin with, within the bounds.
    lower, upper : array_like
        (d,), or one for all: bounds.

    Examples
    --------
    >>> pgm.learning.Parameter(1.0, lower=0.5, upper=2.0)
    Parameter(start=1.0, lower=0.5, upper=2.0)
    """

    start: npt.ArrayLike
    lower: npt.ArrayLike = -math.inf
    upper: npt.ArrayLike = math.inf

    def __post_init__(self) -> None:
        start, lower, upper = (
            as_floats(value, f"Parameter: {name}=")
            for name, value in (("start", self.start), ("lower", self.lower), ("upper", self.upper))
        )
        if not np.isfinite(start).all() or not (lower <= start).all() or not (start <= upper).all():
            raise ModelError(f"{self!r}: start is finite, and lower <= start <= upper")


@public
@dataclass(frozen=True)
class Table(InCode):
    """The table of a `TableCPD`.

    Parameters
    ----------
    prior_counts : array_like
        As the table, or one for all: what is added to expected counts, α − 1 of a Dirichlet prior,
        whose most probable table is learnt; it is the mean of the posterior of a prior with α = the
        counts.

    Examples
    --------
    >>> pgm.learning.Table(prior_counts=1.0)
    Table(prior_counts=1.0)
    """

    prior_counts: npt.ArrayLike = 0.0

    def __post_init__(self) -> None:
        counts = as_floats(self.prior_counts, "Table: prior_counts=")
        if not np.isfinite(counts).all() or (counts < 0.0).any():
            raise ModelError(f"{self!r}: counts are finite, and 0 or more")


@public
@dataclass(frozen=True)
class DegreesOfFreedom(InCode):
    """The degrees of freedom of a sensor's `StudentT` noise.

    Parameters
    ----------
    lower, upper : float
        Bounds, 0 < lower < upper. Of noise that is Gaussian as far as readings tell, they end at
        the upper one.

    Examples
    --------
    >>> pgm.learning.DegreesOfFreedom(upper=30.0)
    DegreesOfFreedom(lower=1.0, upper=30.0)
    """

    lower: float = 1.0
    upper: float = 100.0

    def __post_init__(self) -> None:
        if not (is_number(self.lower) and is_number(self.upper)) or not (
            0.0 < self.lower < self.upper < math.inf
        ):
            raise ModelError(f"{self!r}: lower and upper are numbers, 0 < lower < upper")


PARTS = (Covariance, Coefficients, Offset, DegreesOfFreedom, Parameter, Table)
Learn = Mapping[Variable, Any]


# Log-evidences that are shown.
FEW = 8


@dataclass(frozen=True, eq=False, repr=False)
class FitStatus(Shown, Immutable):
    """The course of a search for the likeliest parameters.

    Attributes
    ----------
    iterations : int
        Points that the search moved to.
    e_steps : int
        Smoothers that were run of each recording, at points that were refused too.
    accepted, refused : int
        Accelerated steps that raised the log-evidence, and others, replaced by a plain one.
    halved : int
        How often a plain step, which did not raise the log-evidence, was halved. Exact models have
        none, but for rounding.
    converged : bool
        Whether the last step was within the tolerance, or rounding alone was left.
    stopped : str
        Why the search ended.
    closed : bool
        Whether no search was needed: all that is learnt was observed, and parameters have a closed
        form.

    Examples
    --------
    >>> from pgm.examples import walk, z
    >>> found = pgm.fit(walk, {z: [[4.0], [2.0]]}, learn={z: pgm.learning.Covariance("diagonal")})
    >>> found.status.converged
    True
    """

    iterations: int
    e_steps: int
    accepted: int
    refused: int
    halved: int
    converged: bool
    stopped: str
    closed: bool = False

    @property
    def _title(self) -> str:
        if self.closed:
            return "FitStatus(closed form)"
        went = "converged" if self.converged else "not converged"
        return f"FitStatus({self.iterations} iterations, {self.e_steps} E steps, {went})"

    def _summary(self) -> Summary:
        if self.closed:
            return Summary(self._title, [self.stopped])
        lines: list[str | Listing] = [
            f"accelerated steps: {self.accepted} accepted, {self.refused} refused"
        ]
        if self.halved:
            lines.append(f"steps halved: {self.halved}")
        return Summary(self._title, [*lines, f"stopped: {self.stopped}"])


class Fit(Shown, Immutable):
    """The result of `fit`: the model with its maximum-likelihood parameters.

    Attributes
    ----------
    model : DynamicBayesianNetwork or BayesianNetwork
        The model that was given, with what was learnt.
    parameters : mapping of Variable
        By the variables that were named: the CPD that was learnt, or the value, (d,), of a
        `Parameter`.
    evidence : Evidence, or tuple of Evidence
        With the values of parameters put in.
    log_evidence : ndarray
        (iterations + 1,): of all recordings and runs together, from the start on, records of a
        network without time times their weights.
    log_prior : ndarray
        (iterations + 1,): of tables with prior counts, but for a constant; zero without. The sum of
        both never falls, but at fixed points that have no likelihood.
    posterior : Posterior, or tuple of these
        The posterior of each recording, smoothed with the model.
    status : FitStatus

    Examples
    --------
    >>> from pgm.examples import walk, z
    >>> found = pgm.fit(walk, {z: [[4.0], [2.0]]}, learn={z: pgm.learning.Covariance("diagonal")})
    >>> found.model.observation[0].cov.round(2)
    array([[5.43]])
    >>> bool(found.log_evidence[-1] > found.log_evidence[0])
    True
    """

    model: Any
    parameters: Mapping[Variable, Any]
    evidence: Any
    log_evidence: Array
    log_prior: Array
    posterior: Any
    status: FitStatus

    def __init__(
        self,
        model: DynamicBayesianNetwork | BayesianNetwork,
        parameters: Mapping[Variable, Any],
        evidence: Any,
        log_evidence: Sequence[float],
        log_prior: Sequence[float],
        posterior: Any,
        status: FitStatus,
    ) -> None:
        trace, priors = np.array(log_evidence), np.array(log_prior)
        trace.flags.writeable = priors.flags.writeable = False
        self._set(
            model=model,
            parameters=MappingProxyType(dict(parameters)),
            evidence=evidence,
            log_evidence=trace,
            log_prior=priors,
            posterior=posterior,
            status=status,
        )

    @property
    def _title(self) -> str:
        first, last = self.log_evidence[[0, -1]]
        return f"Fit(log-evidence {number(first)} to {number(last)}, {self.status._title})"

    def _summary(self) -> Summary:
        trace = self.log_evidence
        shown = ["..." if k is None else number(trace[k]) for k in few(len(trace), FEW)]
        parts: list[str | Listing] = [f"log-evidence: {', '.join(shown)}"]
        parts += self.status._summary().parts
        for variable, value in self.parameters.items():
            if isinstance(value, np.ndarray):
                parts.append(f"{variable!r}: {', '.join(map(number, value))}")
            else:
                parts.append(f"{variable!r}: {value._title}")
                for named, own in _cases(value):
                    parts.extend([named] if named else [])
                    parts.extend(own._parts())
        return Summary(self._title, parts)


def _cases(cpd: CPD) -> Iterator[tuple[str, CPD]]:
    """The CPDs that discrete variables choose among, each with its title; else a CPD alone."""
    if not isinstance(cpd, SwitchingCPD):
        yield "", cpd
        return
    for case, own in cpd.cases.items():
        yield f"{cpd.named(case)}: {own._title}", own
