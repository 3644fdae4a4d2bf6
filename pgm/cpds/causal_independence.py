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
from pgm.boundary import as_floats, as_mapping, as_tuple, is_number
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
        """What is given for each cause, in their order."""
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


@public
class NoisyMax(CausalIndependence):
    r"""A graded child that is the largest of the contributions of independent causes.

    .. math:: p(y \le s \mid x) = p_0(y_0 \le s) \prod_i p_i(y_i \le s \mid x_i)

    Each cause alone brings the child to some grade with some probability, and the worst of them
    counts. `CausalIndependence` tells the rest; of a child of two states it is a `NoisyOr`.

    Parameters
    ----------
    child : Discrete
        Its states are grades, from the lowest to the highest, unless `order` says otherwise.
    given : Discrete or sequence of Discrete
        The causes.
    contributions : sequence of array_like
        Of each cause, (its size, size of the child): what it alone does. The last axis, in the
        order of the child's states, sums to one; a cause that is absent does nothing where its row
        is one at the lowest grade.
    leak : array_like, optional
        (size of the child,): the contribution of all other causes; none if not given.
    order : sequence of str, optional
        The child's states from the lowest to the highest.

    Raises
    ------
    ModelError
        See `CausalIndependence`; and if `order` does not name each state once.

    References
    ----------
    Díez (1993), Parameter adjustment in Bayes networks: the generalized noisy OR-gate. Henrion
    (1989), Some practical issues in constructing belief networks.

    Examples
    --------
    >>> flu, cold = (pgm.Discrete(name, states=("no", "yes")) for name in ("flu", "cold"))
    >>> fever = pgm.Discrete("fever", states=("none", "slight", "high"))
    >>> cpd = NoisyMax(
    ...     fever, (flu, cold), [[[1, 0, 0], [0.1, 0.3, 0.6]], [[1, 0, 0], [0.5, 0.4, 0.1]]]
    ... )
    >>> cpd.table[1, 1].round(3)
    array([0.05, 0.31, 0.64])
    """

    def __init__(
        self,
        child: Variable,
        given: Variable | Iterable[Variable],
        contributions: Sequence[npt.ArrayLike],
        leak: npt.ArrayLike | None = None,
        *,
        order: Sequence[str] | None = None,
    ) -> None:
        self._set_causes(child, given)
        grades = self._grades(order)
        self._set_contributions(contributions, leak, _larger(grades))

    def _grades(self, order: Any) -> Integers:
        """The states from the lowest to the highest, as indices."""
        if order is None:
            return np.arange(self.child.size)
        found = [self.child.index(state) for state in as_tuple(order) or (order,)]
        if sorted(found) != list(range(self.child.size)):
            raise ModelError(
                f"{self!r}: order names the states of {self.child!r}, each once, from the lowest "
                f"to the highest; found {order!r}, of {self.child.states}",
                variable=self.child,
                cpd=self,
            )
        return np.array(found)


# First states by whose names a variable is declared with what is present before what is absent.
PRESENT = {"yes", "y", "true", "t", "on", "present", "1", "positive", "pos", "active"}


@public
class NoisyOr(NoisyMax):
    r"""A child of two states that any of its causes turns on, each with a probability of its own.

    .. math:: p(\text{off} \mid x) = (1 - \ell) \prod_{i \text{ on}} (1 - p_i)

    Thirty causes take thirty numbers, and as few operations (see `CausalIndependence`).

    Parameters
    ----------
    child : Discrete
        Of two states, the last of which is *on*, as of ``states=("no", "yes")``.
    given : Discrete or sequence of Discrete
        The causes; of those of two states the last one is on.
    probabilities : sequence of float or array_like
        Of each cause p, with which it alone turns the child on; or one for each of its states, (its
        size,), which causes of more than two states need.
    leak : float
        ℓ, the probability that the child is on without any cause.
    present : mapping of Discrete to str, optional
        The state that is on, of those variables of which it is the first: ``{rain: "yes"}`` of
        ``states=("yes", "no")``. A variable whose first state has such a name is refused without.

    Attributes
    ----------
    probabilities : tuple of ndarray
        Of each cause those by state.

    Raises
    ------
    ModelError
        If the child has not two states, a probability is not between 0 and 1, or it is not clear
        which state is on.

    References
    ----------
    Pearl (1988), Probabilistic Reasoning in Intelligent Systems, section 4.3.2. Shwe and others
    (1991), Probabilistic diagnosis using a reformulation of the INTERNIST-1/QMR knowledge base.

    Examples
    --------
    >>> names = ("flu", "cold", "fever")
    >>> flu, cold, fever = (pgm.Discrete(name, states=("no", "yes")) for name in names)
    >>> cpd = NoisyOr(fever, (flu, cold), [0.9, 0.5], leak=0.01)
    >>> cpd
    NoisyOr(fever | flu, cold)
    >>> cpd.table[..., 1].round(4)
    array([[0.01  , 0.505 ],
           [0.901 , 0.9505]])
    """

    probabilities: tuple[Array, ...]

    def __init__(
        self,
        child: Variable,
        given: Variable | Iterable[Variable],
        probabilities: Sequence[npt.ArrayLike],
        leak: float = 0.0,
        *,
        present: Mapping[Variable, str] | None = None,
    ) -> None:
        self._set_causes(child, given)
        if self.child.size != 2:
            raise ModelError(
                f"{self!r}: {child!r} has {self.child.size} states, and a noisy-or is of two; a "
                "child of more grades takes pgm.NoisyMax",
                variable=child,
                cpd=self,
            )
        named = as_mapping(present or {}, f"{self!r}: present", ModelError, cpd=self)
        for variable in named:
            if variable not in self.scope:
                raise ModelError(
                    f"{self!r}: present names {variable!r}, which is none of its variables "
                    f"({listed(self.scope)})",
                    cpd=self,
                )
        each = self._each(probabilities, "probabilities")
        found = [
            self._by_state(cause, own, named) for cause, own in zip(self.given, each, strict=True)
        ]
        if not is_number(leak) or not 0.0 <= leak <= 1.0:
            raise ModelError(f"{self!r}: leak is a probability, from 0 to 1; found {leak!r}")
        on = self._on(self.child, named)
        self._set(probabilities=tuple(map(frozen, found)))
        self._set_contributions(
            [_either(own, on) for own in found],
            _either(np.array(float(leak)), on),
            _larger(np.array([1 - on, on])),
        )

    def _by_state(self, cause: Discrete, given: Any, named: Mapping[Any, Any]) -> Array:
        """The probabilities with which the states of a cause turn the child on, (size,)."""
        found = as_floats(given, f"{self!r}: the probability of {cause!r}", cpd=self)
        if not ((found >= 0.0) & (found <= 1.0)).all():
            raise ModelError(
                f"{self!r}: probabilities are from 0 to 1; found {given!r} of {cause!r}",
                variable=cause,
                cpd=self,
            )
        if found.shape == (cause.size,):
            return found.copy()
        if found.shape != () or cause.size != 2:
            due = "a probability, or " * (cause.size == 2) + "one of each of its states"
            raise ModelError(
                f"{self!r}: {cause!r} takes {due}, ({', '.join(cause.states)}); found {given!r}",
                variable=cause,
                cpd=self,
            )
        return np.where(np.arange(2) == self._on(cause, named), found, 0.0)

    def _on(self, variable: Discrete, named: Mapping[Any, Any]) -> int:
        """The index of the state of a variable of two that is on."""
        if variable in named:
            return variable.index(named[variable])
        first = variable.states[0]
        if first.lower() in PRESENT:
            raise ModelError(
                f"{self!r}: the last state of a variable is on, which of {variable!r} is "
                f"{variable.states[1]!r}; declare it with {first!r} last, or say which is on, "
                f"present={{{variable.name}: {first!r}}}",
                variable=variable,
                cpd=self,
            )
        return 1

    def _parts(self) -> Sequence[str | Listing]:
        rows = [
            (f"{cause!r} {state}", number(p))
            for cause, own in zip(self.given, self.probabilities, strict=True)
            for state, p in zip(cause.states, own.tolist(), strict=True)
            if p or cause.size > 2
        ]
        on = int(self.operation[0, 1])
        assert self.leak is not None
        rows.append(("leak", number(float(self.leak[on]))))
        shown = [None if k is None else rows[k] for k in few(len(rows))]
        return [Listing(("cause", f"{self.child!r} {self.child.states[on]}"), shown)]


def _larger(grades: Integers) -> Integers:
    """The larger of two states, of states that are given from the lowest to the highest."""
    rank = np.argsort(grades)
    return np.asarray(grades[np.maximum(rank[:, None], rank[None, :])])


def _either(probability: Array, on: int) -> Array:
    """The distribution, over two states, of the one that is on with a probability."""
    table = np.stack([1.0 - probability, probability], axis=-1)
    return table if on else table[..., ::-1]
