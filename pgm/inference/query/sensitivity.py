r"""Sensitivity of a posterior probability to each entry of the tables of a Bayesian network.

Let θ be the entry of a column for the child's state x, and s the column's sum, one but for
rounding. As θ changes, the other entries of the column keep their proportions and the column its
sum (proportional co-variation). p(y, e) and p(e), the probabilities of the event and of the
evidence, are then linear in θ. Each of them is w + r, where w is what the entry alone would make
if it took the whole column, s ∂p/∂θ, or what the others would, and r is the sum over all other
columns. The *ends* are their values at θ = 0 and θ = s.

Source: Chan and Darwiche (2002), When do numbers really matter? Castillo, Gutiérrez and Hadi
(1997), Sensitivity analysis in discrete Bayesian networks. Kjærulff and van der Gaag (2000), Making
sensitivity analysis computationally efficient.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, ClassVar, NamedTuple

import numpy as np
import numpy.typing as npt

from pgm.arguments import public
from pgm.beliefs.discrete.derivatives import Derivatives, derivatives
from pgm.beliefs.discrete.run import of_tree
from pgm.boundary import is_number, is_whole
from pgm.clustergraph import ClusterGraph
from pgm.compile import DynamicGraph, compile
from pgm.cpds import TableCPD
from pgm.display import Listing, Shown, Summary, number, titled
from pgm.errors import EvidenceError, GraphError, ModelError, NumericalError
from pgm.evidence import Evidence
from pgm.evidence.static import BoundStates, bind_discrete
from pgm.factors.axes import discrete
from pgm.factors.scope import namesake
from pgm.immutable import Immutable
from pgm.inference.query.asked import require_mapping, require_whole_tables
from pgm.inference.query.elimination import NOTHING
from pgm.kernels.arrays import Array, frozen
from pgm.kernels.semirings import exp, log_sum
from pgm.networks import BayesianNetwork, DynamicBayesianNetwork, MarkovNetwork
from pgm.posteriors.posterior import require_variable
from pgm.posteriors.summaries import spread
from pgm.schedules import limits
from pgm.variables import Discrete, Variable

# How many entries a summary lists.
LISTED = 10
# Arrays of the size of all clusters' tables that are kept: products, and numbers of zeros.
ARRAYS = 2
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
        try:
            values = np.asarray(theta, dtype=np.float64)
            share = np.broadcast_to(values, self.derivative.shape) / self._sums
        except (TypeError, ValueError):
            raise ModelError(
                f"values of the entries of {self.cpd!r} are numbers that broadcast to "
                f"{self.derivative.shape}; found {np.shape(theta)} of {type(theta).__name__}",
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
        if not isinstance(variable, Discrete) or variable not in self._by_child:
            require_variable(variable)
            raise EvidenceError(
                f"{variable!r} has no table; the network's variables are {list(self._by_child)}"
                f"{namesake(variable, self._by_child)}",
                variable=variable,
            )
        return self._by_child[variable]

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


@public
def sensitivity(
    network: BayesianNetwork | ClusterGraph,
    event: Mapping[Discrete, str | int],
    evidence: Evidence = NOTHING,
) -> Sensitivities:
    r"""Find how the posterior probability of an event depends on each entry of the tables.

    .. math:: P(\theta) = p(\text{event} \mid \text{evidence}) = \frac{a\,\theta + b}{c\,\theta + d}

    Here θ is one entry of one table, and the others of its column change with it, in proportion;
    all other columns stay. Derivatives and functions of all entries are exact, and found together,
    from two passes of messages over the junction tree, one with the event and one without.

    Parameters
    ----------
    network : BayesianNetwork or ClusterGraph
        Of tables; or its compiled graph, which is used if it has no loops.
    event : mapping of Discrete
        States, by name or index, of variables without evidence: the event is that all have these.
    evidence : mapping of Discrete, optional
        As for `infer`; leading axes are runs.

    Returns
    -------
    Sensitivities
        ``found[x].derivative``, ``.probability(theta)``, ``.interval(lowest, highest)`` and
        ``.coefficients`` of the table of x, and ``found.ranked(count)``.

    Raises
    ------
    ModelError
        If `network` is no network without time.
    GraphError
        If it is not one of tables alone, each with a direction, or its junction tree is too large.
    EvidenceError
        If event or evidence do not fit the network, the event is observed, or the evidence has
        probability zero.
    NumericalError
        If a derivative is too large for a number.

    References
    ----------
    Chan & Darwiche, When do numbers really matter?, 2002; Kjærulff & van der Gaag, Making
    sensitivity analysis computationally efficient, 2000.

    Examples
    --------
    >>> from pgm.examples import rain, rainy, wet
    >>> found = pgm.sensitivity(rainy, {rain: "yes"}, {wet: "yes"})
    >>> round(float(found.probability), 6)
    0.75
    >>> lower, upper = found[rain].interval(lowest=0.9)  # of p(rain=yes), for P(yes | wet) ≥ 0.9
    >>> round(float(lower[1]), 6), float(upper[1])
    (0.75, 1.0)
    """
    graph = _tree(network)
    require_mapping(evidence)
    known = frozenset(graph.network.variables)
    bound = bind_discrete(known, evidence)
    happens = _event(event, known, bound)
    limits.require_runs(ARRAYS * sum(graph.sizes), bound.runs, "products of all clusters")
    of_tree(graph, bound, limits.Room.of(None, graph))  # impossible evidence is told here
    given = derivatives(graph, bound)
    states = {**bound.states, **happens}
    with_event = derivatives(graph, BoundStates(bound.lead, states, bound.weights))
    # Of a tree without the event both are the same number.
    shares = {k: with_event.log_evidence[k] - own for k, own in given.log_evidence.items()}
    own = {k: share for k, share in shares.items() if share.any()}
    found = dict[Discrete, Sensitivity]()
    for place, factor in enumerate(given.factors):
        assert isinstance(factor, TableCPD)
        elsewhere = sum((s for k, s in own.items() if k != given.trees[place]), np.zeros(1))
        found[factor.child] = _of_table(factor, place, given, with_event, elsewhere, bound.lead)
    probability = exp(sum(own.values(), np.zeros(bound.runs)))
    return Sensitivities(
        MappingProxyType({v: v.states[state] for v, state in happens.items()}),
        frozen(np.asarray(probability).reshape(bound.lead)),
        MappingProxyType({v: found[v] for v in discrete(graph.network.variables)}),
    )


def _of_table(
    cpd: TableCPD,
    place: int,
    given: Derivatives,
    with_event: Derivatives,
    elsewhere: Array,
    lead: tuple[int, ...],
) -> Sensitivity:
    """The sensitivity to a table, the factor at a place of both kinds of derivatives.

    `elsewhere`, (runs or 1,), is ln P(event | evidence) in all trees but the factor's.
    """
    size, runs = cpd.child.size, given.logs[place].shape[-1]
    table = cpd.table.reshape(-1, size)
    with np.errstate(divide="ignore"):
        logs = np.log(table)[..., None]
    sums = table.sum(axis=1, keepdims=True)[..., None]
    event, evidence = (
        _ends(own.logs[place].reshape(-1, size, runs) + more, logs, np.log(sums))
        for own, more in ((with_event, elsewhere), (given, 0.0))
    )
    # Of all four numbers a common factor is taken out, by which none is above one.
    top = np.maximum(*evidence)
    j0, j1, e0, e1 = (exp(own - top) for own in (*event, *evidence))
    # p(evidence) itself, for 1 − θ may have lost what others of the column add to.
    total = exp(given.log_evidence[given.trees[place]] - top)
    with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
        slope = (j1 * (e0 / total) - j0 * (e1 / total)) / total / sums
    if not np.isfinite(slope).all():
        raise NumericalError(
            f"a derivative by an entry of {cpd!r} is too large for a number: with the entry as it "
            "is, the evidence is next to impossible beside what another value makes of it",
            cpd=cpd,
        )

    def shaped(values: Array) -> Array:
        """Values (columns, states, runs or 1) as (*runs or (), sizes of the table...)."""
        by_run = np.moveaxis(np.broadcast_to(values, (*table.shape, runs)), -1, 0)
        return frozen(by_run.reshape(*lead, *cpd.table.shape))

    return Sensitivity(
        cpd,
        shaped(slope),
        (shaped(j0), shaped(e0)),
        (shaped(j1), shaped(e1)),
        frozen(np.broadcast_to(sums[..., 0], table.shape).reshape(cpd.table.shape)),
    )


def _ends(derivative: Array, logs: Array, log_sums: Array) -> tuple[Array, Array]:
    """The logarithms of a probability where each entry is zero, and where it is its column's sum.

    derivative: (columns, states, runs): ln ∂p/∂θ of each entry θ.
    logs: (columns, states, 1): ln θ.
    log_sums: (columns, 1, 1): of the columns' sums.
    """
    columns = log_sum(logs + derivative, 1)[:, None]
    rest = _others(columns, 0)
    if logs.shape[1] == 1:  # a single state, whose entry cannot change
        ends = np.logaddexp(log_sums + derivative, rest)
        return ends, ends
    # The others in their proportions; in equal parts where they are all zero.
    weights = _others(logs, 1)
    proportional = _others(logs + derivative, 1) - np.where(weights == -np.inf, 0.0, weights)
    equal = _others(derivative, 1) - np.log(logs.shape[1] - 1)
    mean = np.where(weights == -np.inf, equal, proportional)
    return np.logaddexp(log_sums + mean, rest), np.logaddexp(log_sums + derivative, rest)


def _others(logs: Array, axis: int) -> Array:
    """Of each entry along an axis, ln of the sum of all others, without any difference."""
    moved = np.moveaxis(logs, axis, 0)
    none = np.full((1, *moved.shape[1:]), -np.inf)
    before = np.concatenate([none, np.logaddexp.accumulate(moved[:-1], 0)])
    after = np.concatenate([none, np.logaddexp.accumulate(moved[:0:-1], 0)])[::-1]
    return np.moveaxis(np.logaddexp(before, after), 0, axis)


def _event(event: Any, known: frozenset[Variable], evidence: BoundStates) -> dict[Discrete, int]:
    """The states of an event, checked, as indices."""
    require_mapping(event, "the event")
    bound = bind_discrete(known, event)
    observed = next((v for v in bound.states if v in evidence.states), None)
    if observed is not None:
        raise EvidenceError(
            f"{observed!r} is observed: the event is of variables without evidence",
            variable=observed,
        )
    states = {v: state for v, state in bound.states.items() if isinstance(state, int)}
    if bound.lead or bound.weights or not event or len(states) < len(event):
        raise EvidenceError(
            "the event is one state, by name or index, of each of one or more variables, like "
            f"{{rain: 'yes'}}; found {dict(event)!r}"
        )
    return states


def _tree(network: Any) -> ClusterGraph:
    """The graph without loops of a network of tables, which the user gave, or its graph."""
    if isinstance(network, DynamicBayesianNetwork | DynamicGraph):
        raise GraphError(
            "sensitivity is for networks without time, and this one is dynamic; of tables, take "
            "model.unroll(steps)"
        )
    graph = network if isinstance(network, ClusterGraph) else None
    asked = graph.network if graph is not None else network
    if not isinstance(asked, BayesianNetwork):
        if isinstance(asked, MarkovNetwork):
            raise GraphError(
                f"sensitivity is of probabilities, the entries of CPDs, and {titled(asked)} has "
                "factors without direction"
            )
        raise ModelError(
            f"sensitivity takes a network of tables or its compiled graph, not {titled(network)}"
        )
    if not asked.discrete:
        raise GraphError(
            f"sensitivity is for networks of tables, and this one is {asked._kind}; of continuous "
            "variables, compare posteriors of networks with other numbers"
        )
    tree = graph if graph is not None and graph.is_tree else compile(asked)
    require_whole_tables(
        tree, "there is no sensitivity", "its table's entries stand in none of the tree's factors"
    )
    return tree
