"""The parts of a CPD that may be learnt, as users declare them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from pgm.boundary import as_floats, is_number
from pgm.display import InCode
from pgm.errors import ModelError
from pgm.variables import Variable

KINDS = ("full", "diagonal", "scaled")


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


@dataclass(frozen=True)
class Table(InCode):
    """The table of a `TableCPD`.

    Parameters
    ----------
    prior_counts : array_like
        As the table, or one for all: what is added to expected counts, α − 1 of a Dirichlet prior.

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


PARTS = (Covariance, Coefficients, Offset, Parameter, Table)
Part = Covariance | Coefficients | Offset | Parameter | Table
Learn = Mapping[Variable, Any]
