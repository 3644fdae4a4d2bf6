"""The sensitivities of a posterior probability to the entries of tables, as results."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import ClassVar, NamedTuple

import numpy as np
import numpy.typing as npt

from pgm.boundary import as_floats, is_number, is_whole
from pgm.cpds import TableCPD
from pgm.display import Listing, Shown, Summary, number
from pgm.errors import EvidenceError, ModelError
from pgm.immutable import Immutable
from pgm.inference.query.asked import found_of
from pgm.kernels.arrays import Array
from pgm.posteriors.summaries import spread
from pgm.variables import Discrete, Variable

# How many entries a summary lists.
LISTED = 10
# How far below zero rounding may bring a difference, in units of its terms.
ROUNDING = 1e-14
# Decimals of a derivative's binary mantissa by which it is ranked.
EQUAL = 12


class Coefficients(NamedTuple):
    """Coefficients of P(θ) = (a θ + b) / (c θ + d), each (*runs, sizes of the table...)."""

    a: Array
    b: Array
    c: Array
    d: Array


@dataclass(frozen=True, eq=False, repr=False)
class Sensitivity(Shown, Immutable):
    r"""The dependence of a posterior probability on each entry of one CPD's table.

    .. math:: P(\theta) = \frac{a\,\theta + b}{c\,\theta + d}

    - θ: the entry, the others of its column in the proportions that they have now; or, where they
      are all zero, in equal parts;
    - P(θ): the probability of the event given the evidence, with this entry alone changed.

    All arrays are (*runs, size of each parent..., size of the child), as the table is.

    Attributes
    ----------
    cpd : TableCPD
    derivative : ndarray
        dP/dθ at the table's own entries.

    Examples
    --------
    >>> from pgm.examples import rain, rainy, wet
    >>> own = pgm.sensitivity(rainy, {rain: "yes"}, {wet: "yes"})[rain]
    >>> own.probability([0.9, 0.9]).round(6)
    array([0.25    , 0.964286])
    >>> lower, upper = own.interval(lowest=0.5)
    >>> lower.round(6), upper.round(6)
    (array([0.  , 0.25]), array([0.75, 1.  ]))
    """

    cpd: TableCPD
    derivative: Array
    # p(event, evidence) and p(evidence) at θ = 0, and where it is its column's sum.
    _first: tuple[Array, Array]
    _last: tuple[Array, Array]
    _sums: Array

    @property
    def coefficients(self) -> Coefficients:
        """The coefficients a, b, c, d of each entry, but for a factor that all four share."""
        (j0, e0), (j1, e1) = self._first, self._last
        return Coefficients((j1 - j0) / self._sums, j0, (e1 - e0) / self._sums, e0)

    def probability(self, theta: npt.ArrayLike) -> Array:
        """P(θ), of each entry by itself; NaN where it makes the evidence impossible.

        Parameters
        ----------
        theta : array_like
            Values from 0 to 1, which broadcast to (*runs, size of each parent..., size of the
            child). A column that is rounded takes them up to its sum.

        Returns
        -------
        ndarray
            (*runs, size of each parent..., size of the child).
        """
        values = as_floats(theta, f"values of the entries of {self.cpd!r}", cpd=self.cpd)
        try:
            share = np.broadcast_to(values, self.derivative.shape) / self._sums
        except ValueError:
            raise ModelError(
                f"values of the entries of {self.cpd!r} are numbers that broadcast to "
                f"{self.derivative.shape}; found {values.shape}",
                cpd=self.cpd,
            ) from None
        if not ((values >= 0.0) & (values <= 1.0)).all():
            raise ModelError(
                f"an entry of {self.cpd!r} is a probability, from 0 to 1; found {values.min():g} "
                f"to {values.max():g}",
                cpd=self.cpd,
            )
        # A column whose sum is one but for rounding is taken whole by an entry of one.
        share = np.where(values == 1.0, 1.0, np.minimum(share, 1.0))
        event, given = (
            (1.0 - share) * low + share * high
            for low, high in zip(self._first, self._last, strict=True)
        )
        with np.errstate(invalid="ignore"):
            found: Array = event / np.where(given > 0.0, given, np.nan)
        return found

    def interval(self, lowest: float = 0.0, highest: float = 1.0) -> tuple[Array, Array]:
        """The values of each entry for which lowest ≤ P(θ) ≤ highest, from the one to the other.

        P(θ) never turns, so that they are an interval. An end at which the evidence would be
        impossible belongs to it.

        Parameters
        ----------
        lowest, highest : float
            Probabilities.

        Returns
        -------
        lower, upper : ndarray
            (*runs, size of each parent..., size of the child); NaN where there are none.
        """
        if not all(is_number(p) and 0.0 <= p <= 1.0 for p in (lowest, highest)) or lowest > highest:
            raise ModelError(
                "an interval is of probabilities lowest and highest, from 0 to 1 and in this "
                f"order; found {lowest!r} and {highest!r}"
            )
        (j0, e0), (j1, e1) = self._first, self._last
        low = _not_negative(_less(j0, lowest * e0), _less(j1, lowest * e1))
        high = _not_negative(_less(highest * e0, j0), _less(highest * e1, j1))
        lower, upper = np.maximum(low[0], high[0]), np.minimum(low[1], high[1])
        # Where both are one point, rounding may have them change places.
        empty = ~(lower <= upper + ROUNDING)
        lower, upper = np.minimum(lower, upper), np.maximum(lower, upper)
        return (
            np.where(empty, np.nan, lower * self._sums),
            np.where(empty, np.nan, upper * self._sums),
        )

    @property
    def _title(self) -> str:
        lead = self.derivative.ndim - self.cpd.table.ndim
        runs = f", runs {self.derivative.shape[:lead]}" if lead else ""
        largest = np.abs(self.derivative).max()
        return f"Sensitivity({self.cpd!r}; largest |derivative| {largest:.3g}{runs})"


def _less(one: Array, other: Array) -> Array:
    """A difference of numbers that are not negative; zero where it may be of rounding alone."""
    found: Array = one - other
    return np.where(np.abs(found) <= ROUNDING * (one + other), 0.0, found)


def _not_negative(first: Array, last: Array) -> tuple[Array, Array]:
    """The interval of t in [0, 1] where (1 − t) first + t last ≥ 0; NaN where there is none."""
    apart = first - last
    root = first / np.where(apart == 0.0, 1.0, apart)
    lower = np.where(first >= 0.0, 0.0, np.where(last >= 0.0, root, np.nan))
    upper = np.where(last >= 0.0, 1.0, np.where(first >= 0.0, root, np.nan))
    return lower, upper


@dataclass(frozen=True, eq=False, repr=False)
class SensitiveEntry(Shown, Immutable):
    """An entry of a table, and how a posterior probability depends on it.

    Attributes
    ----------
    child : Discrete
    state : str
        The child's state of the entry.
    given : mapping of Discrete to str
        The parents' states of its column.
    value : float
        The entry.
    derivative : float
        dP/dθ there.

    Examples
    --------
    >>> from pgm.examples import rain, rainy, wet
    >>> entry = pgm.sensitivity(rainy, {rain: "yes"}, {wet: "yes"}).ranked(1)[0]
    >>> entry.child, entry.state, dict(entry.given), entry.value
    (rain, 'no', {}, 0.5)
    """

    child: Discrete
    state: str
    given: Mapping[Discrete, str]
    value: float
    derivative: float

    @property
    def _where(self) -> str:
        column = ", ".join(f"{v!r}={state}" for v, state in self.given.items())
        return f"{self.child!r}={self.state}{f' | {column}' if column else ''}"

    @property
    def _title(self) -> str:
        return f"SensitiveEntry({self._where}: {self.value:.6g}, derivative {self.derivative:.3g})"


@dataclass(frozen=True, eq=False, repr=False)
class Sensitivities(Shown, Immutable):
    """The dependence of a posterior probability on each entry of each table of a network.

    ``found[x]`` is the `Sensitivity` to the table of x, and ``found.ranked()`` are the entries on
    which the probability depends most.

    Attributes
    ----------
    event : mapping of Discrete to str
        The states whose probability is meant.
    probability : ndarray
        (*runs): P(event | evidence), by the tables as they are.

    Examples
    --------
    >>> from pgm.examples import rain, rainy, wet
    >>> found = pgm.sensitivity(rainy, {rain: "yes"}, {wet: "yes"})
    >>> found[wet].derivative
    array([[ 0.75, -0.75],
           [-0.25,  0.25]])
    >>> found.ranked(1)
    [SensitiveEntry(rain=no: 0.5, derivative -0.75)]
    """

    # Python would else iterate by asking for the variables 0, 1, ....
    __iter__: ClassVar[None] = None

    event: Mapping[Discrete, str]
    probability: Array
    _by_child: Mapping[Discrete, Sensitivity]

    def __getitem__(self, variable: Variable) -> Sensitivity:
        """The sensitivity to the entries of a variable's table."""
        return found_of(self._by_child, variable, "has no table; the network's variables are")

    def ranked(self, count: int = LISTED) -> list[SensitiveEntry]:
        """The entries of the largest derivatives, whatever their signs, the largest first.

        Parameters
        ----------
        count : int
            How many, at the most. Of equal ones those come first whose child does in the network.

        Returns
        -------
        list of SensitiveEntry

        Raises
        ------
        EvidenceError
            If the evidence has axes of runs: each ranks the entries in its own way.
        """
        if not is_whole(count) or count < 1:
            raise ModelError(f"count is how many entries are wanted, 1 or more; found {count!r}")
        if self.probability.ndim:
            raise EvidenceError(
                f"entries are ranked for one set of evidence, and this has the runs "
                f"{self.probability.shape}; ask for each by itself, or look at found[x].derivative"
            )
        tables = list(self._by_child.values())
        flat = np.concatenate([own.derivative.ravel() for own in tables])
        ends = np.cumsum([own.derivative.size for own in tables])
        found = []
        # The entries of a column of two are equal but for rounding; the sort keeps their order.
        digits, power = np.frexp(np.abs(flat))
        rounded = np.ldexp(np.round(digits, EQUAL), power)
        for k in np.argsort(-rounded, kind="stable")[:count].tolist():
            place = int(np.searchsorted(ends, k, side="right"))
            first = int(ends[place]) - tables[place].derivative.size
            found.append(_entry(tables[place], k - first))
        return found

    @property
    def _title(self) -> str:
        told = ", ".join(f"{v!r}={state}" for v, state in self.event.items())
        lead = self.probability.shape
        level = f"runs {lead}" if lead else f"{self.probability:.6g}"
        return f"Sensitivities(P({told} | evidence); {level})"

    def _summary(self) -> Summary:
        if self.probability.ndim:
            return Summary(self._title, [f"P {spread(self.probability)}"])
        rows = []
        for entry in self.ranked(LISTED):
            rows.append((entry._where, number(entry.value, 4), number(entry.derivative, 3)))
        return Summary(self._title, [Listing(("", "entry", "derivative"), rows, cell=80)])


def _entry(table: Sensitivity, place: int) -> SensitiveEntry:
    """The entry at a place of a table, counted in C order."""
    cpd, at = table.cpd, np.unravel_index(place, table.derivative.shape)
    states = [v.states[k] for v, k in zip((*cpd.given, cpd.child), at, strict=True)]
    column = dict(zip(cpd.given, states, strict=False))
    value, derivative = float(cpd.table[at]), float(table.derivative[at])
    return SensitiveEntry(cpd.child, states[-1], MappingProxyType(column), value, derivative)
