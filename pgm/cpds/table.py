"""CPDs of discrete variables: tables of probabilities."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cached_property
from types import MappingProxyType
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from pgm.arguments import public
from pgm.boundary import as_floats
from pgm.cpds.base import CPD, Known, Moved, Values, of_case
from pgm.cpds.structured import as_transition, is_structured, rounding
from pgm.display import Listing, called, count
from pgm.errors import ModelError
from pgm.factors.listing import shown
from pgm.factors.scope import Scope, as_scope, listed, names
from pgm.factors.table import Potential
from pgm.kernels.arrays import Array, Integers, frozen
from pgm.kernels.stochastic import Dense, Transition
from pgm.resources import require_memory
from pgm.variables import Discrete, Variable

# The table of a function of inputs: values of each, (..., d) or states (...), to (..., sizes).
TableFunction = Callable[..., npt.ArrayLike]


@public
class TableCPD(CPD):
    """The probabilities of a discrete child for each combination of its parents' states.

    Parameters
    ----------
    child : Discrete
    given : Discrete or sequence of Discrete, optional
        The parents, in the order of the table's axes.
    table : array_like, sparse matrix, Kronecker, mapping or callable
        (size of each parent..., size of the child): the last axis is the child, and sums to one.
        Entries that were rounded to six decimals pass: a sum may be off by 5e-7 for each state,
        or 1e-6 where that is more. Such a table is used as it is, not rescaled.

        Of one parent it may be a sparse matrix of SciPy, as `shifts` makes them, or a `Kronecker`
        product of axes. Of two, a mapping from each state of the second, an input such as a
        command, to a matrix of one of these kinds.

        With `inputs`, a function of their values that returns the table: of a value (..., d) of
        each, or of indices of states (...), it returns (..., size of each parent..., size).
    inputs : Variable or sequence of Variable, optional
        Parents of which a table is a function, continuous or discrete: always observed, so that
        such a CPD is for dynamic networks.

    Raises
    ------
    ModelError
        If the shape does not fit, an entry is negative or not finite, or a column does not sum
        to one; of a structured table also if all its entries are asked for and would not fit.

    Examples
    --------
    >>> cloudy, rain = (pgm.Discrete(name, states=("no", "yes")) for name in ("cloudy", "rain"))
    >>> TableCPD(rain, given=(cloudy,), table=[[0.8, 0.2], [0.2, 0.8]])
    TableCPD(rain | cloudy)
    """

    discrete: ClassVar[bool] = True
    child: Discrete
    given: tuple[Discrete, ...]
    inputs: Scope = ()
    function: TableFunction | None = None
    # Of a structured table its matrix, by the state of the second parent if there is one.
    _maps: Mapping[int | None, Transition] = MappingProxyType({})
    _table: Array | None = None

    def __init__(
        self,
        child: Variable,
        given: Variable | Iterable[Variable] = (),
        *,
        table: npt.ArrayLike | Any,
        inputs: Variable | Iterable[Variable] = (),
    ) -> None:
        self._set_scope(child, given)
        if callable(table) or inputs != ():
            self._set(inputs=as_scope(inputs, f"{self!r}: inputs"))
            self._check_inputs(table)
            self._set(function=table)
        elif is_structured(table) or isinstance(table, Mapping):
            self._set(_maps=self._structured(table))
        else:
            array = as_floats(table, f"{self!r}: the table", cpd=self).copy()
            self._require_shape(array.shape)
            self._require_probabilities(array)
            self._set(_table=frozen(array))

    @classmethod
    def _made(cls, child: Discrete, given: Sequence[Discrete], table: Array) -> TableCPD:
        """A CPD of a table that is right by its making: it is not checked."""
        found = object.__new__(cls)
        found._set(child=child, given=tuple(given), _table=frozen(table))
        return found

    def _check_inputs(self, table: Any) -> None:
        for variable in self.inputs:
            if variable in (self.child, *self.given):
                raise ModelError(
                    f"{self!r}: {variable!r} is an input of the table's function, and stands in "
                    "the table too; name it once",
                    variable=variable,
                    cpd=self,
                )
        if callable(table) != bool(self.inputs):
            found = "a function" if self.inputs else "inputs= of it"
            raise ModelError(
                f"{self!r}: a table that is a function of inputs takes both, table=function and "
                f"inputs=(u,); {found} is missing",
                cpd=self,
            )

    def _structured(self, table: Any) -> dict[int | None, Transition]:
        what = f"{self!r}: the table"
        if is_structured(table):  # a sparse matrix that is a dictionary of its entries too
            if len(self.given) != 1:
                raise ModelError(
                    f"{what} is a matrix, of one parent, where there are {len(self.given)}; of a "
                    "second one, an input, give a mapping of its states to matrices",
                    cpd=self,
                )
            return {None: self._as_map(table, what)}
        if len(self.given) != 2:
            raise ModelError(
                f"{what} is a mapping, from the states of the second of two parents to matrices; "
                f"there are {len(self.given)}",
                cpd=self,
            )
        second = self.given[1]
        found = {second.index(state): matrix for state, matrix in table.items()}
        if len(found) < len(table):
            raise ModelError(
                f"{what} maps states of {second!r} to matrices, {listed(table)}, one of them by "
                "its name and its index; give each once",
                variable=second,
                cpd=self,
            )
        missing = [state for k, state in enumerate(second.states) if k not in found]
        if missing:
            raise ModelError(
                f"{what} lacks a matrix for {second!r}={missing[0]!r}; give one for each of its "
                f"states ({listed(second.states)})",
                variable=second,
                cpd=self,
            )
        return {k: self._as_map(m, f"{what} for {second!r}={k}") for k, m in found.items()}

    def _as_map(self, matrix: Any, what: str) -> Transition:
        found = as_transition(matrix, what, cpd=self)
        due = self.given[0].size, self.child.size
        if found.shape != due:
            raise ModelError(
                f"{what} has shape {found.shape}; {self.given[0]!r} before and {self.child!r} "
                f"after need {due}",
                cpd=self,
            )
        return found

    def _require_shape(
        self, shape: tuple[int, ...], lead: tuple[int, ...] = (), step: int | None = None
    ) -> None:
        axes = (*self.given, self.child)
        due = (*lead, *(v.size for v in axes))
        if shape != due:
            raise ModelError(
                f"{self!r}: the table{_at(step)} has shape {shape}; the axes {names(axes)} need "
                f"{due}, the last one for the child",
                variable=self.child,
                cpd=self,
                step=step,
            )

    def _require_probabilities(self, array: Array, step: int | None = None) -> None:
        if not np.isfinite(array).all() or (array < 0.0).any():
            raise ModelError(
                f"{self!r}: the table{_at(step)} has entries that are negative, NaN or infinite",
                variable=self.child,
                cpd=self,
                step=step,
            )
        total = array.sum(axis=-1)
        error = np.abs(total - 1.0)
        if (error > rounding(self.child.size)).any():
            worst = np.unravel_index(error.argmax(), total.shape)
            own = worst[total.ndim - len(self.given) :]
            states = ", ".join(
                f"{v!r}={v.states[k]!r}" for v, k in zip(self.given, own, strict=True)
            )
            where = f" for {states}" if states else ""
            raise ModelError(
                f"{self!r}: the probabilities{where}{_at(step)} sum to {total[worst]:.9g}; the "
                "last axis, the child's, must sum to one; where the ratios are right, divide the "
                "table by table.sum(-1, keepdims=True)",
                variable=self.child,
                cpd=self,
                step=step,
            )

    @cached_property
    def _positive(self) -> bool:
        """Whether the table has no zero."""
        return bool(self.table.all())

    @property
    def _potential(self) -> Potential:
        return Potential((*self.given, self.child), self.table, 0.0)

    @property
    def parents(self) -> Scope:
        """All parents: first the table's axes, then the inputs of its function."""
        return (*self.given, *self.inputs)

    @cached_property
    def table(self) -> Array:
        """The table, (size of each parent..., size of the child)."""
        if self._table is not None:
            return self._table
        if self.function is not None:
            raise ModelError(
                f"{self!r} has a table for each value of {names(self.inputs)}, which dynamic "
                "networks alone take; there is no single one",
                cpd=self,
            )
        size = self.child.size
        for parent in self.given:
            size *= parent.size
        require_memory(size, f"{self!r}: all entries of its table", "keep to its structure")
        if None in self._maps:
            return frozen(self._maps[None].dense())
        matrices = [self._maps[k].dense() for k in range(self.given[1].size)]
        return frozen(np.stack(matrices, axis=1))

    def _parts(self) -> Sequence[str | Listing]:
        if self.function is not None:
            return [f"table: {called(self.function)} of ({listed(self.inputs)})"]
        if self._table is not None:
            return shown((*self.given, self.child), self._table)
        kind = type(next(iter(self._maps.values()))).__name__.lower()
        by = "" if None in self._maps else f" for each state of {self.given[1]!r}"
        return [f"table: {kind}{by}, of {count(self.child.size, 'state')}"]

    @public
    def at_inputs(
        self,
        values: Mapping[Variable, Any],
        lead: tuple[int, ...] = (),
        *,
        step: int | None = None,
    ) -> Array:
        """The table of a function at values (*lead, d) of its inputs, or states, checked.

        It is (*lead, size of each parent..., size of the child); the step is for messages.
        """
        assert self.function is not None
        at = _at(step)
        try:
            found = self.function(*(values[v] for v in self.inputs))
        except Exception as error:
            raise ModelError(
                f"{self!r}: the function of the table failed{at}: {type(error).__name__}: {error}",
                cpd=self,
                step=step,
            ) from error
        what = f"{self!r}: the function of the table{at}"
        array = as_floats(found, what, cpd=self, step=step, verb="return")
        if array.ndim == len(self.given) + 1 and lead:  # one table for all
            self._require_shape(array.shape, (), step)
            axes = tuple(v.size for v in (*self.given, self.child))
            array = np.broadcast_to(array, (*lead, *axes))
        self._require_shape(array.shape, lead, step)
        self._require_probabilities(array, step)
        return array

    def _log_density(self, child: Values, known: Known) -> Array:
        with np.errstate(divide="ignore"):
            return np.asarray(np.log(self._entries(child, known)))

    def _entries(self, child: Values, known: Known) -> Array:
        lead = known.lead
        places = [known.values[v].reshape(self._spread(known.values[v], lead)) for v in self.given]
        if self.function is not None:
            tables = self.at_inputs(self._inputs_of(known), known.shape)
            tables = tables.reshape(*lead, *tables.shape[len(known.shape) :])
            shape = np.broadcast_shapes(lead, np.shape(child))
            own = np.ix_(*(np.arange(size) for size in lead)) if lead else ()
            place = tuple(np.broadcast_to(each, shape) for each in (*own, *places, child))
            return np.asarray(tables[place])
        if self._maps:
            return np.asarray(self._by_map(known, places, child, "entries"))
        return np.asarray(self.table[(*places, child)])

    @staticmethod
    def _spread(values: Values, lead: tuple[int, ...]) -> tuple[int, ...]:
        return lead if values.size > 1 or not lead else (1,) * len(lead)

    def _inputs_of(self, known: Known) -> dict[Variable, Any]:
        found = {}
        for v in self.inputs:
            own = known.values[v].shape[-1:] if not isinstance(v, Discrete) else ()
            found[v] = np.broadcast_to(known.values[v], (*known.shape, *own))
        return found

    def _by_map(self, known: Known, places: Any, last: Any, method: str) -> Any:
        if None in self._maps:
            return getattr(self._maps[None], method)(places[0], last)
        if method == "draw":
            places = np.broadcast_arrays(*places)
            found = np.empty(places[0].shape, dtype=np.intp)
            for k in np.unique(places[1]):
                here = places[1] == k
                by = of_case(last, int(k), np.flatnonzero(here))
                found[here] = self._maps[int(k)].draw(places[0][here], by)
            return found
        first, second, child = np.broadcast_arrays(*places, last)
        entries = np.empty(first.shape)
        for k in np.unique(second):
            here = second == k
            entries[here] = self._maps[int(k)].entries(first[here], child[here])
        return entries

    @cached_property
    def _rows(self) -> Dense:
        return Dense(self.table.reshape(-1, self.child.size))

    def _draw(self, known: Known, rng: np.random.Generator, size: tuple[int, ...] = ()) -> Integers:
        shape = (*size, *known.shape)
        places = [np.broadcast_to(known.values[v], shape) for v in self.given]
        if self._maps:
            found: Integers = self._by_map(known, places, rng, "draw")
            return found
        if self.function is not None:
            tables = self.at_inputs(self._inputs_of(known), known.shape)
            rows = tables.reshape(-1, *tables.shape[len(known.shape) :])
            flat = np.broadcast_to(np.arange(len(rows)).reshape(known.shape), shape)
            matrix = rows.reshape(-1, self.child.size)
            sizes = (len(rows), *(v.size for v in self.given))
            return Dense(matrix).draw(np.ravel_multi_index((flat, *places), sizes), rng)
        sizes = tuple(v.size for v in self.given)
        row = np.ravel_multi_index(tuple(places), sizes) if sizes else np.zeros(shape, np.intp)
        return self._rows.draw(row, rng)

    def _over(self, moved: Moved) -> dict[str, Any]:
        return super()._over(moved) | {"inputs": tuple(map(moved, self.inputs))}


def _at(step: int | None) -> str:
    return "" if step is None else f" at step {step}"
