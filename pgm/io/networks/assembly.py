"""The network that a file describes, put together and checked with the file's own lines."""

import math
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from pgm.cpds import TableCPD
from pgm.errors import FileError, ModelError
from pgm.factors.scope import MOST
from pgm.io.networks.cursor import shown
from pgm.kernels.arrays import Array
from pgm.networks import BayesianNetwork
from pgm.variables import Discrete

# Axes of a table that NumPy can hold.
AXES = 64
# Bytes of a file's limit for each entry of a table, and for each variable or state, of which there
# may be some in any case.
ENTRY, NAME, SOME = 4, 128, 2**10
# How far an entry of a table with two decimals may be from the number that was rounded.
ROUNDED = 5e-3

Fail = Callable[[str, int | None], FileError]


@dataclass(frozen=True, slots=True)
class Family:
    """A child and its parents, before their table is known."""

    child: Discrete
    given: tuple[Discrete, ...]
    at: int

    @property
    def rows(self) -> int:
        """Number of combinations of the parents' states."""
        return math.prod(v.size for v in self.given)

    def row(self, index: int) -> str:
        """The parents' states of a row, for messages."""
        named: list[str] = []
        for variable in reversed(self.given):
            index, state = divmod(index, variable.size)
            named.insert(0, f"{shown(variable.name)}={shown(variable.states[state])}")
        return f" given {', '.join(named)}" if named else ""

    def __repr__(self) -> str:
        return shown(self.child.name)


class Assembly:
    """A network under construction from a file; `fail` names the line of a fault.

    fail: Makes the error of a message and a place.
    normalise: Whether columns that do not quite sum to one are divided by their sums.
    limit: How many bytes the file may hold, in proportion to which what is made of it is bounded.
    """

    def __init__(self, fail: Fail, *, normalise: bool, limit: int) -> None:
        self._fail, self._normalise = fail, normalise
        self._entries, self._names = limit // ENTRY, max(SOME, limit // NAME)
        self.variables: dict[str, Discrete] = {}
        self._cpds: dict[str, TableCPD | None] = {}
        self._declared: dict[str, int] = {}

    def declare(self, name: str, states: Sequence[str], at: int) -> None:
        """Add a variable."""
        if not name:
            raise self._fail("a variable has an empty name; give it one", at)
        if name in self.variables:
            raise self._fail(f"the variable {shown(name)} is declared a second time; keep one", at)
        if not states:
            raise self._fail(f"the variable {shown(name)} has no states; list them", at)
        if len(set(states)) < len(states):
            ((twice, _),) = Counter(states).most_common(1)
            raise self._fail(
                f"two states of {shown(name)} are called {shown(twice)}; give each its own name", at
            )
        self.expect(1 + len(states), at)
        self._names -= 1 + len(states)
        self.variables[name] = Discrete(name, states)
        self._declared[name] = at

    def expect(self, names: int, at: int) -> None:
        """Refuse variables and states before there is memory for them, if they are too many."""
        if names > self._names:
            raise self._fail(
                "its variables and states are more than the limit leaves room for; where that is "
                "meant, raise the limit (limit=)",
                at,
            )

    def family(self, child: str, given: Sequence[str], at: int) -> Family:
        """The variables of a table."""
        for name in (child, *given):
            if name not in self.variables:
                raise self._fail(
                    f"the variable {shown(name)} is not declared; declare it, or correct the name",
                    at,
                )
        if child in self._cpds:
            raise self._fail(
                f"the probabilities of {shown(child)} are given a second time; keep one", at
            )
        if child in given:
            raise self._fail(f"{shown(child)} is given as its own parent; leave it out", at)
        if len(set(given)) < len(given):
            raise self._fail(f"a parent of {shown(child)} is named twice; name each once", at)
        if len(given) >= AXES:
            raise self._fail(
                f"{shown(child)} has {len(given)} parents; a table has room for {AXES - 1}; divide "
                "them among variables in between",
                at,
            )
        self._cpds[child] = None
        return Family(self.variables[child], tuple(self.variables[name] for name in given), at)

    def reserve(self, family: Family) -> None:
        """Refuse a table before there is memory for it, if all tables would be too large."""
        entries = family.rows * family.child.size
        self._entries -= entries
        if self._entries < 0:
            raise self._fail(
                f"the table of {family!r} has {entries:,} entries, which is more than the limit "
                "leaves for it; where that is meant, raise the limit (limit=)",
                family.at,
            )

    def table(self, family: Family, rows: Array, place: Callable[[int], int]) -> None:
        """Add the table of a family: a row for each combination of parents' states, in order."""
        right = (rows >= 0.0) & (rows <= 2.0)  # the sums tell about those just above one
        if not right.all():
            index, state = map(int, np.argwhere(~right)[0])
            raise self._fail(
                f"{rows[index, state]:.9g} is no probability, of {family!r}{family.row(index)}; "
                "correct it",
                place(index),
            )
        if self._normalise:
            rows = self._normalised(family, rows, place)
        shape = (*(v.size for v in family.given), family.child.size)
        try:
            cpd = TableCPD(family.child, family.given, table=rows.reshape(shape))
        except ModelError:
            index, total = _worst(rows)
            raise self._fail(
                f"the probabilities of {family!r}{family.row(index)} sum to {total:.9g}, not to "
                "one; correct them, or read with normalise=True, which divides by sums that "
                "rounding explains",
                place(index),
            ) from None
        self._cpds[family.child.name] = cpd

    def network(self) -> BayesianNetwork:
        """The network, its variables in the order of their declarations."""
        if not self.variables:
            raise self._fail("it declares no variable", None)
        missing = [name for name in self.variables if self._cpds.get(name) is None]
        if missing:
            names = ", ".join(map(shown, missing[:MOST])) + ", ..." * (len(missing) > MOST)
            raise self._fail(
                f"no probabilities are given for {names}; add them", self._declared[missing[0]]
            )
        try:
            return BayesianNetwork(cpd for name in self.variables if (cpd := self._cpds[name]))
        except ModelError as error:
            at = self._declared[error.variable.name] if error.variable else None
            raise self._fail(str(error), at) from None

    def _normalised(self, family: Family, rows: Array, place: Callable[[int], int]) -> Array:
        totals = rows.sum(axis=-1)
        size = family.child.size
        error = np.abs(totals - 1.0)
        exact = size * np.finfo(float).eps
        if (error > max(ROUNDED * size, 2.0 * ROUNDED) + exact).any():
            index, total = _worst(rows)
            raise self._fail(
                f"the probabilities of {family!r}{family.row(index)} sum to {total:.9g}, which is "
                "further from one than rounding to two decimals explains; correct them",
                place(index),
            )
        return rows / np.where(error > exact, totals, 1.0)[:, None]


def _worst(rows: Array) -> tuple[int, float]:
    totals = rows.sum(axis=-1)
    index = int(np.abs(totals - 1.0).argmax())
    return index, float(totals[index])
