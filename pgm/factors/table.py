"""Discrete factors: tables."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import ClassVar, NamedTuple

import numpy as np
import numpy.typing as npt

from pgm.arguments import public
from pgm.boundary import as_generator, as_lengths, as_mapping
from pgm.display import NoArray, Shown, Summary, titled
from pgm.errors import ModelError, NumericalError
from pgm.factors.axes import (
    States,
    as_entries,
    as_lead,
    as_states,
    at,
    axes_of,
    require_known,
    require_positive,
    sizes,
    spread,
    without,
)
from pgm.factors.listing import FramedTable, summary, title
from pgm.factors.scope import names, parted
from pgm.immutable import Immutable
from pgm.kernels import tables as kernel
from pgm.kernels.arrays import Array, Integers, frozen, unravelled
from pgm.kernels.semirings import Semiring, log_sum
from pgm.variables import Discrete, Variable

ZERO = frozen(np.zeros(()))


class Potential(NamedTuple):
    """A factor's numbers as inference takes them: values times the exponential of a log-scale.

    `axes` are the variables of the axes of `values`.
    """

    axes: States
    values: Array
    log_scale: float

    def entries(self, semiring: Semiring) -> Array:
        """The entries in a semiring, numbers or logarithms."""
        found = semiring.entries(self.values)
        if not self.log_scale:
            return found
        scale = np.exp(self.log_scale) if semiring.linear else self.log_scale
        scaled: Array = semiring.times(found, scale)
        return scaled


@public
class Table(FramedTable, Shown, NoArray, Immutable):
    r"""A discrete factor: a non-negative table times the exponential of a log-scale.

    .. math:: \phi(x) = \text{values}[x] \, \exp(\text{log-scale})

    - x: a state of each variable of the scope;
    - values: (..., size of each variable...), in the order of the scope;
    - log-scale: (...), so that products of thousands of small numbers stay above zero.

    Leading axes are independent factors and broadcast. Values and log-scales are multiplied,
    divided and summed as they are, unless values come near what numbers hold. Then, and where the
    largest value is below 1e-100 or above 1e100, that becomes about one, and the rest goes into
    the log-scale. Entries below 1e-300 of the largest become zero. All zero is legal.

    Parameters
    ----------
    scope : Discrete or sequence of Discrete
    values, log_scale : array_like
        Not negative and finite; a log-scale of −∞ says that the table is all zero.
    lead : int or tuple of int
        The leading axes, of several tables; without, the values are those of one, so that a table
        of a wrong shape is not taken for a stack of others.

    Raises
    ------
    ModelError
        If arguments do not fit, here and in all methods: a variable is not in the scope or named
        twice, a state is none of its variable's.
    NumericalError
        Raised by `normalised`, `probabilities`, `argmax` and `sample`, if the table is all zero; by
        the latter two also if it is NaN, as the belief of a run of impossible evidence is.

    References
    ----------
    Koller & Friedman, Probabilistic Graphical Models, 2009, sections 4.2 and 10.3.

    Examples
    --------
    >>> rain, wet = (Discrete(name, states=("no", "yes")) for name in ("rain", "wet"))
    >>> f = Table(rain, [0.8, 0.2]) * Table((rain, wet), [[0.9, 0.1], [0.3, 0.7]])
    >>> f.reduce({wet: "yes"}).normalised()
    Table(rain: no 0.364, yes 0.636)
    >>> f.marginal(wet)
    Table(wet: no 0.78, yes 0.22)
    >>> float(round(f["yes", "no"], 6))
    0.06
    """

    __slots__ = ("log_scale", "scope", "values")

    _arrays: ClassVar[str] = ".values and .log_scale, or its .probabilities"

    # Python would else iterate by asking for the states 0, 1, ... until an IndexError.
    __iter__: ClassVar[None] = None

    scope: States
    values: Array
    log_scale: Array

    def __init__(
        self,
        scope: Variable | Iterable[Variable],
        values: npt.ArrayLike,
        log_scale: npt.ArrayLike = 0.0,
        *,
        lead: int | tuple[int, ...] = (),
    ) -> None:
        scope = as_states(scope)
        lead = as_lead(scope, lead)
        entries, scale = as_entries(scope, values, log_scale, lead)
        self._put(scope, entries, np.broadcast_to(scale, lead))

    def _put(self, scope: States, values: Array, log_scale: Array) -> None:
        lead = own = values.shape[: values.ndim - len(scope)]
        if log_scale.ndim:
            lead = np.broadcast_shapes(own, log_scale.shape)
        # A log-scale of −∞ is put into the values, so that log-scales always add and subtract.
        if log_scale.min(initial=0.0) == -np.inf:
            gone = log_scale == -np.inf
            values = np.where(gone.reshape(gone.shape + (1,) * len(scope)), 0.0, values)
            log_scale = np.where(gone, 0.0, log_scale)
        due = (*lead, *sizes(scope))
        if values.shape != due:
            values = np.broadcast_to(values, due)
        if log_scale.shape != lead:
            log_scale = np.broadcast_to(log_scale, lead)
        # Reductions may have made scalars of arrays without axes.
        values, log_scale = np.asarray(values), np.asarray(log_scale)
        self._set(scope=scope, values=frozen(values), log_scale=frozen(log_scale))

    @classmethod
    def _make(cls, scope: States, values: Array, log_scale: Array | float = 0.0) -> Table:
        table = object.__new__(cls)
        table._put(scope, values, np.asarray(log_scale, dtype=float))
        return table

    @classmethod
    def _plain(cls, scope: States, values: Array) -> Table:
        lead = values.shape[: values.ndim - len(scope)]
        table = object.__new__(cls)
        # One by one, since posteriors make many tables of a few numbers.
        object.__setattr__(table, "scope", scope)
        object.__setattr__(table, "values", values)
        object.__setattr__(table, "log_scale", np.broadcast_to(ZERO, lead) if lead else ZERO)
        return table

    @property
    def _potential(self) -> Potential:
        return Potential(self.scope, self.values, float(self.log_scale))

    @classmethod
    def vacuous(cls, scope: Variable | Iterable[Variable]) -> Table:
        """The factor that is one everywhere."""
        scope = as_states(scope)
        return cls._make(scope, np.ones(sizes(scope)))

    @classmethod
    def uniform(cls, scope: Variable | Iterable[Variable]) -> Table:
        """Equal probabilities of all combinations of states."""
        return cls.vacuous(scope).normalised()

    @property
    def _rescaled(self) -> tuple[Array, Array]:
        return kernel.rescale(self.values, self.log_scale, len(self.scope))

    def _combined(self, scope: States, values: Array, log_scale: Array) -> Table:
        return self._make(scope, *kernel.rescale(values, log_scale, len(scope)))

    def extend(self, scope: Variable | Iterable[Variable]) -> Table:
        """The same factor over a wider or reordered scope; it is constant in new variables."""
        scope = as_states(scope)
        if scope == self.scope:
            return self
        missing = without(self.scope, scope)
        if missing:
            raise ModelError(
                f"cannot extend to {names(scope)}: it lacks {names(missing)}; "
                "marginalise, maximise or reduce them first"
            )
        return self._make(scope, spread(self.values, self.scope, scope), self.log_scale)

    rearrange = extend

    def _aligned(self, other: Table) -> tuple[States, Array, Array]:
        scope = as_states((*self.scope, *without(other.scope, self.scope)))
        try:
            np.broadcast_shapes(self.log_scale.shape, other.log_scale.shape)
        except ValueError:
            raise ModelError(
                f"the leading axes of {self._title} and {other._title} do not broadcast"
            ) from None
        a, b = (spread(table.values, table.scope, scope) for table in (self, other))
        return scope, a, b

    def __mul__(self, other: Table) -> Table:
        """Product of two factors on the common scope."""
        if not isinstance(other, Table):
            return NotImplemented
        scope, a, b = self._aligned(other)
        values, scale = kernel.multiply(a, b, len(scope))
        return self._combined(scope, values, self.log_scale + other.log_scale + scale)

    def __truediv__(self, other: Table) -> Table:
        """Quotient of two factors on the common scope, where 0/0 is 0.

        So belief propagation divides a message out of a belief that it is part of. A divisor that
        is zero where the dividend is not raises a NumericalError.
        """
        if not isinstance(other, Table):
            return NotImplemented
        scope, a, b = self._aligned(other)
        lost = np.argwhere((b == 0.0) & (a > 0.0))
        if lost.shape[0]:
            raise NumericalError(
                f"cannot divide a table over {names(self.scope)} by one over "
                f"{names(other.scope)}: where {at(scope, lost[0][lost.shape[1] - len(scope) :])}, "
                "the divisor is zero and the dividend is not"
            )
        values, scale = kernel.divide(a, b, len(scope))
        return self._combined(scope, values, self.log_scale - other.log_scale + scale)

    def marginalise(self, *drop: Variable) -> Table:
        """Sum some variables out: φ'(x) = Σ_y φ(x, y)."""
        axes = axes_of(self.scope, drop)
        if not drop:
            return self
        values, scale = self._rescaled
        return self._combined(without(self.scope, drop), values.sum(axis=axes), scale)

    def marginal(self, *keep: Variable) -> Table:
        """Sum all but some variables out; the `Table` is in the order asked for."""
        axes_of(self.scope, keep)
        return self.marginalise(*without(self.scope, keep)).rearrange(keep)

    def maximise(self, *drop: Variable) -> Table:
        """Maximise over some variables: φ'(x) = max_y φ(x, y)."""
        axes = axes_of(self.scope, drop)
        if not drop:
            return self
        return self._combined(without(self.scope, drop), self.values.max(axis=axes), self.log_scale)

    def reduce(self, evidence: Mapping[Discrete, str | int]) -> Table:
        """Put in states, by name or index, of some variables; entries stay as they are."""
        evidence = as_mapping(evidence, "the evidence of a table", ModelError)
        axes_of(self.scope, evidence)
        index = [v.index(evidence[v]) if v in evidence else slice(None) for v in self.scope]
        values = self.values[(..., *index)]
        return self._make(without(self.scope, evidence), values, self.log_scale)

    @property
    def log_values(self) -> Array:
        """The entries ln φ(x), (..., size of each variable...); −∞ where φ is zero."""
        return kernel.log_entries(self.values, self.log_scale, len(self.scope))

    @property
    def log_total(self) -> Array:
        """The value ln Σ φ(x), (...); −∞ where the table is all zero."""
        return kernel.log_total(*self._rescaled, len(self.scope))

    def normalised(self) -> Table:
        """The table divided by its sum, with the log-scale zero."""
        return self._make(self.scope, kernel.normalise(self._positive(), len(self.scope)))

    @property
    def probabilities(self) -> Array:
        """The values of `normalised`, (..., size of each variable...)."""
        return self.normalised().values

    def entropy(self) -> Array:
        """The entropy −Σ p ln p of the probabilities in nats, (...)."""
        return kernel.entropy(self.probabilities, len(self.scope))

    def kl(self, other: Table) -> Array:
        """KL(self ‖ other) = Σ p ln(p/q) of the probabilities in nats, (...); ∞ where q alone is 0.

        The other has the same variables, in any order.
        """
        if not isinstance(other, Table) or set(other.scope) != set(self.scope):
            raise ModelError(
                f"KL compares tables of the same variables, not {self._title} with "
                f"{titled(other)}; take marginals first"
            )
        self._aligned(other)  # whose leading axes have to broadcast
        logs = other.rearrange(self.scope)._log_probabilities
        return kernel.divergence(self._log_probabilities, logs, len(self.scope))

    def mutual_information(self, *variables: Variable) -> Array:
        """How much some variables of the scope tell of the others, in nats, (...).

        Σ p ln(p / (p₁ p₂)), p₁ and p₂ being the marginals of the two parts.

        Examples
        --------
        >>> a, b = (pgm.Discrete(name, 2) for name in "ab")
        >>> both = pgm.Table((a, b), [[0.4, 0.1], [0.1, 0.4]])
        >>> round(float(both.mutual_information(a)), 6)
        0.192745
        """
        left = parted(self.scope, variables)
        logs = self.rearrange((*variables, *left))._log_probabilities
        lead, end = self.log_scale.ndim, self.log_scale.ndim + len(variables)
        own, rest = tuple(range(lead, end)), tuple(range(end, logs.ndim))
        # Of logarithms, since numbers of a marginal may be too small beside its largest.
        one, other = (np.expand_dims(log_sum(logs, axes), axes) for axes in (rest, own))
        return kernel.divergence(logs, one + other, len(self.scope))

    @property
    def _log_probabilities(self) -> Array:
        self._positive()
        total = self.log_total
        found: Array = self.log_values - total.reshape((*total.shape, *(1,) * len(self.scope)))
        return found

    def argmax(self) -> dict[Discrete, str] | dict[Discrete, Integers]:
        """The states of the largest entry, the first of equals: names; of stacks, indices (...)."""
        lead = self.log_scale.shape
        best = self._drawable().reshape((*lead, math.prod(sizes(self.scope)))).argmax(axis=-1)
        index = unravelled(best, sizes(self.scope))
        if lead:
            return dict(zip(self.scope, index, strict=True))
        return {v: v.states[k] for v, k in zip(self.scope, index, strict=True)}

    @public
    def sample(
        self, size: int | tuple[int, ...] = (), *, rng: np.random.Generator | int
    ) -> Integers:
        """Draws of the variables' joint states by the probabilities, as indices.

        Parameters
        ----------
        size : int or tuple of int
            How many draws of each table.
        rng : numpy.random.Generator or int
            The generator of draws, or its seed.

        Returns
        -------
        ndarray of int
            (*size, ..., number of variables), in the order of the scope.
        """
        shape, lead = as_lengths(size, "of each table"), self.log_scale.shape
        total = np.cumsum(self._drawable().reshape(math.prod(lead), -1), axis=1)
        level = as_generator(rng).random((math.prod(shape), len(total))) * total[:, -1]
        drawn = np.empty(level.shape, dtype=np.intp)
        for table, ends in enumerate(total):
            # What rounding leaves of the sum goes to no state of its own.
            drawn[:, table] = np.searchsorted(ends[:-1], level[:, table], side="right")
        index = unravelled(drawn.reshape((*shape, *lead)), sizes(self.scope))
        return np.stack(index, axis=-1)

    def _drawable(self) -> Array:
        # Of NaN NumPy finds the first entry to be the largest, and draws the last.
        values = self._positive()
        require_known(self.scope, kernel.largest(values, len(self.scope)))
        return values

    def _positive(self) -> Array:
        values, _ = self._rescaled
        require_positive(self.scope, kernel.largest(values, len(self.scope)))
        return values

    def __getitem__(self, states: str | int | tuple[str | int, ...]) -> Array:
        """The entries φ at a state of each variable, in the order of the scope, (...).

        An entry too large for a number raises a NumericalError; `log_values` has its logarithm.
        """
        wanted = states if isinstance(states, tuple) else (states,)
        if len(wanted) != len(self.scope):
            raise ModelError(
                f"a table over {names(self.scope)} is read at one state of each of its variables, "
                f"not at {wanted}"
            )
        index = tuple(v.index(state) for v, state in zip(self.scope, wanted, strict=True))
        entries = kernel.entries(self.values[(..., *index)], self.log_scale)  # type: ignore[arg-type]
        if np.isinf(entries).any():
            raise NumericalError(
                f"the entry of {self._title} at {at(self.scope, index)} is too large for a number; "
                "take log_values"
            )
        return entries

    @property
    def _title(self) -> str:
        return title(self.scope, self.log_scale.shape)

    def _summary(self) -> Summary:
        return summary(self.scope, self.values, self.log_scale)
