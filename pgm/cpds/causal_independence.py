"""CPDs of causes that contribute to their child independently of each other.

The contributions are combined to the child's state one cause after another, so that each step
depends on what the causes before it amount to, which is an *intermediate* variable, and on one
cause. These steps are the factors of the CPD; its table grows exponentially with its parents, and
is made where it is asked for.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import count
from typing import Any

import numpy as np
import numpy.typing as npt

from pgm.arguments import public
from pgm.boundary import as_floats, as_tuple
from pgm.cpds.base import Known, Values
from pgm.cpds.table import TableCPD
from pgm.display import Listing, few, number
from pgm.errors import ModelError
from pgm.factors.axes import sizes
from pgm.factors.scope import listed
from pgm.kernels.arrays import Array, Integers, frozen
from pgm.kernels.stochastic import Dense
from pgm.resources import gibibytes, require_memory
from pgm.variables import Discrete, Variable


@dataclass(frozen=True, slots=True, init=False, repr=False)
class Intermediate(Discrete):
    """A variable of the states that the causes of a child up to some cause amount to.

    whole: The child.
    """

    whole: Discrete  # type: ignore[misc]

    def __init__(self, name: str, whole: Discrete) -> None:
        Discrete.__init__(self, name, whole.states)
        object.__setattr__(self, "whole", whole)

    __hash__ = Discrete.__hash__


def of_user(variable: Discrete) -> Discrete:
    """The user's variable that a variable is, or is part of."""
    return variable.whole if isinstance(variable, Intermediate) else variable


# The most entries of a table that is made of independent causes: 128 MiB.
LARGEST = 2**24

# Two states, as indices, to the state that they amount to.
Combine = Callable[[Any, Any], npt.ArrayLike]


@public
class CausalIndependence(TableCPD):
    r"""The probabilities of a discrete child to which causes contribute independently.

    .. math:: p(y \mid x_1, \dots, x_n) =
              \sum_{y_0 * y_1 * \dots * y_n = y} p_0(y_0) \prod_i p_i(y_i \mid x_i)

    - :math:`p_i(y_i \mid x_i)`: the *contribution* of a cause, a state of the child;
    - \*: the operation that combines contributions, from the left, ``((y₀ * y₁) * y₂) * ...``;
    - :math:`p_0`: the *leak*, the contribution of all causes that are not modelled.

    `NoisyOr` and `NoisyMax` combine by the maximum; the minimum makes a noisy-and, ``a + b`` a
    count, ``a ^ b`` a parity. With contributions that are certain the child is a function of its
    parents. Numbers grow with the sum over the parents, not with the product of their states: in
    networks without time `compile` and `query` take the factors

    .. math:: p(z_i \mid z_{i-1}, x_i) = \sum_{z_{i-1} * y_i = z_i} p_i(y_i \mid x_i)

    over intermediate variables z, that nothing else shows but clusters; the last z is the child. A
    CPD whose table is no larger than all its factors is that table. So are those of dynamic
    networks, and wherever `table` is asked for: up to 2²⁴ entries.

    Parameters
    ----------
    child : Discrete
    given : Discrete or sequence of Discrete
        The causes, in the order in which they are combined. Children of the same parents have them
        in the same order: this makes clusters small.
    contributions : sequence of array_like
        Of each cause, (its size, size of the child): the last axis sums to one.
    combine : callable or array_like
        The operation: a function of two arrays of indices of the child's states, such as
        ``np.minimum``, or the matrix of its values. It need be neither associative nor commutative.
    leak : array_like, optional
        (size of the child,), of sum one. Without, the first contribution is where it starts.

    Attributes
    ----------
    contributions : tuple of ndarray
    operation : ndarray of int
        (size of the child, size of the child): the states that two states amount to.
    leak : ndarray or None

    Raises
    ------
    ModelError
        If shapes do not fit, a distribution is none, the operation leads out of the child's states,
        or a table of more than 2²⁴ entries is asked for.

    References
    ----------
    Heckerman and Breese (1996), Causal independence for probability assessment and inference using
    Bayesian networks. Zhang and Poole (1996), Exploiting causal independence in Bayesian network
    inference.

    Examples
    --------
    >>> bits = [pgm.Discrete(f"bit {k}", 2) for k in range(40)]
    >>> parity = pgm.Discrete("parity", states=("even", "odd"))
    >>> cpd = CausalIndependence(parity, bits, [np.eye(2)] * 40, combine=np.bitwise_xor)
    >>> net = pgm.BayesianNetwork([*(pgm.TableCPD(bit, table=[0.9, 0.1]) for bit in bits), cpd])
    >>> pgm.query(net, parity)
    Table(parity: even 0.5, odd 0.5)
    """

    contributions: tuple[Array, ...]
    operation: Integers
    leak: Array | None

    def __init__(
        self,
        child: Variable,
        given: Variable | Iterable[Variable],
        contributions: Sequence[npt.ArrayLike],
        combine: Combine | npt.ArrayLike,
        leak: npt.ArrayLike | None = None,
    ) -> None:
        self._set_causes(child, given)
        self._set_contributions(contributions, leak, self._operation(combine))

    def _set_causes(self, child: Variable, given: Variable | Iterable[Variable]) -> None:
        self._set_scope(child, given)
        if not self.given:
            raise ModelError(
                f"{self!r} has no cause; give it some, or the child a TableCPD without parents",
                variable=child,
                cpd=self,
            )

    def _set_contributions(
        self,
        contributions: Sequence[npt.ArrayLike],
        leak: npt.ArrayLike | None,
        operation: Integers,
    ) -> None:
        each = self._each(contributions, "contributions")
        # A table of each cause alone, which refuses what is none.
        alone = [
            TableCPD(
                self.child,
                given=cause,
                table=as_floats(own, f"{self!r}: the contribution of {cause!r}"),
            )
            for cause, own in zip(self.given, each, strict=True)
        ]
        if leak is not None:
            leak = TableCPD(self.child, table=as_floats(leak, f"{self!r}: leak")).table
        operation.flags.writeable = False
        self._set(
            contributions=tuple(cpd.table for cpd in alone),
            leak=leak,
            operation=operation,
        )

    def _each(self, given: Any, what: str) -> tuple[Any, ...]:
        """The values given for the causes, one each, in their order."""
        found = as_tuple(given)
        if found is None or isinstance(given, Mapping) or len(found) != len(self.given):
            count = "none" if found is None or isinstance(given, Mapping) else len(found)
            raise ModelError(
                f"{self!r}: {what} has one of each cause ({listed(self.given)}), "
                f"{len(self.given)} in their order; found {count}",
                cpd=self,
            )
        return found

    def _operation(self, combine: Any) -> Integers:
        """The states that two states amount to, (size, size)."""
        size = self.child.size
        found = combine
        if callable(combine):
            states = np.arange(size)
            try:
                found = combine(states[:, None], states[None, :])
            except Exception as error:
                raise ModelError(
                    f"{self!r}: combine failed, at all pairs of states, which it was given as two "
                    f"arrays of indices, (n, 1) and (1, n): {type(error).__name__}: {error}",
                    cpd=self,
                ) from error
        values = as_floats(found, f"{self!r}: combine", cpd=self)
        if values.shape != (size, size):
            raise ModelError(
                f"{self!r}: combine has a state for each pair of the child's {size} states, "
                f"({size}, {size}); found the shape {values.shape}",
                cpd=self,
            )
        wrong = ~np.isin(values, np.arange(size))
        if wrong.any():
            a, b = np.argwhere(wrong)[0]
            names = self.child.states
            raise ModelError(
                f"{self!r}: combine makes {values[a, b]:g} of {names[a]!r} and {names[b]!r}, and "
                f"the child has the states 0 to {size - 1}; a count, say, ends at its last, "
                "np.minimum(a + b, last)",
                cpd=self,
            )
        return values.astype(np.intp)

    @property
    def _entries_of_table(self) -> int:
        return math.prod(sizes((*self.given, self.child)))

    @cached_property
    def table(self) -> Array:
        """The table, (size of each parent..., size of the child), of up to 2²⁴ entries."""
        entries = self._entries_of_table
        if entries > LARGEST:
            raise ModelError(
                f"{self!r}: its table would have {entries:,} entries, {gibibytes(entries)}, "
                f"where {LARGEST:,} are the most. In a network without time pgm.compile and "
                "pgm.query take the factors of the CPD; elsewhere give it fewer parents, such as "
                "variables that each combine some",
                variable=self.child,
                cpd=self,
            )
        return frozen(self._combined(len(self.given)))

    def _combined(self, count: int) -> Array:
        """The probabilities of what the first causes amount to, (size of each..., size)."""
        found, first = self._start
        for k in range(first, count):
            found = np.tensordot(found, self._step(k), 1)
        return found

    @property
    def _start(self) -> tuple[Array, int]:
        """Where combining starts, and with which cause it goes on."""
        return (self.contributions[0], 1) if self.leak is None else (self.leak, 0)

    def _step(self, k: int) -> Array:
        """p(after | before, cause k), (size, size of the cause, size)."""
        size, own = self.child.size, self.contributions[k]
        found = np.zeros((size, size, len(own)))
        at = np.arange(size)[:, None], self.operation
        np.add.at(found, at, np.broadcast_to(own.T, (size, size, len(own))))
        return np.ascontiguousarray(found.swapaxes(1, 2))

    def _intermediate(self, taken: set[str]) -> tuple[Intermediate, ...]:
        """The intermediate variables: of the first two causes, of three, ..., of all but the last.

        There are none where the table is no larger than all factors. `taken` are names of
        variables, to which theirs are added.
        """
        if self._entries_of_table <= self._entries_of_factors:
            return ()
        found = []
        for cause in self.given[1:-1]:
            name = f"{self.child!r} up to {cause!r}"
            while name in taken:
                name += "'"
            taken.add(name)
            found.append(Intermediate(name, self.child))
        return tuple(found)

    @property
    def _entries_of_factors(self) -> int:
        size, causes = self.child.size, self.given
        steps = sum(size * v.size * size for v in causes[2:])
        return math.prod(sizes(causes[:2])) * size + steps

    def _factors(self, taken: set[str]) -> tuple[TableCPD, ...]:
        """The CPDs of the intermediate variables and of the child; this one, if there are none.

        `taken` as of `_intermediate`.
        """
        intermediate = self._intermediate(taken)
        if not intermediate:
            return (self,)
        require_memory(
            self._entries_of_factors,
            f"{self!r}: its factors",
            "give the child fewer states",
            cpd=self,
        )
        first, *others = (*intermediate, self.child)
        found = [TableCPD._made(first, self.given[:2], self._combined(2))]
        for before, after, k in zip(intermediate, others, count(2), strict=False):
            found.append(TableCPD._made(after, (before, self.given[k]), self._step(k)))
        return tuple(found)

    def _entries(self, child: Values, known: Known) -> Array:
        found, first = self._start
        given = [known.values[v] for v in self.given]
        places = [own.reshape(self._spread(own, known.lead)) for own in given]
        if first:
            found = found[places[0]]
        for k, place in list(enumerate(places))[first:]:
            step = self._step(k).swapaxes(0, 1)[place]
            found = (found[..., None, :] @ step)[..., 0, :]
        lead = np.broadcast_shapes(found.shape[:-1], np.shape(child))
        found = np.broadcast_to(found, (*lead, self.child.size))
        at = np.broadcast_to(child, lead)[..., None]
        return np.asarray(np.take_along_axis(found, at, -1)[..., 0])

    def _draw(self, known: Known, rng: np.random.Generator, size: tuple[int, ...] = ()) -> Integers:
        shape = (*size, *known.shape)
        found: Integers | None = None
        if self.leak is not None:
            found = Dense(self.leak[None]).draw(np.zeros(shape, np.intp), rng)
        for cause, own in zip(self.given, self.contributions, strict=True):
            drawn = Dense(own).draw(np.broadcast_to(known.values[cause], shape), rng)
            found = drawn if found is None else self.operation[found, drawn]
        assert found is not None
        return found

    def _parts(self) -> Sequence[str | Listing]:
        rows = []
        for cause, own in zip(self.given, self.contributions, strict=True):
            rows += [
                (f"{cause!r} {state}", *map(number, row))
                for state, row in zip(cause.states, own.tolist(), strict=True)
            ]
        if self.leak is not None:
            rows.append(("leak", *map(number, self.leak.tolist())))
        shown = [None if k is None else rows[k] for k in few(len(rows))]
        return [Listing(("contribution of", *self.child.states), shown)]
