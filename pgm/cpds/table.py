"""CPDs of discrete variables: tables of probabilities."""

from __future__ import annotations

from collections.abc import Iterable
from typing import ClassVar

import numpy as np
import numpy.typing as npt

from pgm.boundary import as_floats
from pgm.cpds.base import CPD
from pgm.cpds.values import Known, Values
from pgm.errors import ModelError
from pgm.factors.runs import unflat
from pgm.factors.scope import names
from pgm.kernels.arrays import Array, Integers, frozen
from pgm.variables import Discrete, Variable

# How far an entry of a table with six decimals may be from the number that was rounded.
ROUNDED = 5e-7


class TableCPD(CPD):
    """The probabilities of a discrete child for each combination of its parents' states.

    Parameters
    ----------
    child : Discrete
    given : Discrete or sequence of Discrete, optional
        The parents, in the order of the table's axes.
    table : array_like
        (size of each parent..., size of the child): the last axis is the child, and sums to one.
        Entries that were rounded to six decimals pass: a sum may be off by 5e-7 for each state,
        or 1e-6 where that is more. Such a table is used as it is, not rescaled.

    Raises
    ------
    ModelError
        If the shape does not fit, an entry is negative or not finite, or a column does not sum
        to one.

    Examples
    --------
    >>> from pgm.variables import Discrete
    >>> cloudy = Discrete("cloudy", states=("no", "yes"))
    >>> rain = Discrete("rain", states=("no", "yes"))
    >>> TableCPD(rain, given=(cloudy,), table=[[0.8, 0.2], [0.2, 0.8]])
    TableCPD(rain | cloudy)
    """

    discrete: ClassVar[bool] = True
    child: Discrete
    given: tuple[Discrete, ...]
    table: Array

    def __init__(
        self,
        child: Variable,
        given: Variable | Iterable[Variable] = (),
        *,
        table: npt.ArrayLike,
    ) -> None:
        self._set_scope(child, given)
        axes = (*self.given, self.child)
        due = tuple(len(v.states) for v in axes)
        array = as_floats(table, f"{self!r}: the table", cpd=self).copy()
        if array.shape != due:
            raise ModelError(
                f"{self!r}: the table has shape {array.shape}; the axes {names(axes)} need {due}, "
                "the last one for the child",
                variable=child,
                cpd=self,
            )
        if not np.isfinite(array).all() or (array < 0.0).any():
            raise ModelError(
                f"{self!r}: the table has entries that are negative, NaN or infinite",
                variable=child,
                cpd=self,
            )
        total = array.sum(axis=-1)
        error = np.abs(total - 1.0)
        if (error > _tolerance(self.child.size)).any():
            worst = np.unravel_index(error.argmax(), total.shape)
            states = ", ".join(
                f"{v!r}={v.states[k]!r}" for v, k in zip(self.given, worst, strict=True)
            )
            where = f" for {states}" if states else ""
            raise ModelError(
                f"{self!r}: the probabilities{where} sum to {total[worst]:.9g}; the last axis, "
                "the child's, must sum to one; where the ratios are right, divide the table by "
                "table.sum(-1, keepdims=True)",
                variable=child,
                cpd=self,
            )
        self._set(table=frozen(array))

    def _log_density(self, child: Values, known: Known) -> Array:
        places = (unflat(known.values[v], known.lead, 0) for v in self.given)
        with np.errstate(divide="ignore"):
            return np.asarray(np.log(self.table[(*places, child)]))

    def _draw(self, known: Known, rng: np.random.Generator, size: tuple[int, ...] = ()) -> Integers:
        shape = (*size, *known.shape)
        cumulative = np.cumsum(self.table, axis=-1)
        row = tuple(known.values[v] for v in self.given)
        # A uniform below one, times the last sum, stays below it, so that what rounding leaves of
        # the sum from one goes to no state of its own.
        level = rng.random(shape) * cumulative[(*row, -1)]
        # The first state whose cumulative sum exceeds the level, by bisection: all draws at once in
        # memory of their number alone.
        low = np.zeros(shape, dtype=np.intp)
        high = np.full(shape, self.child.size - 1)
        for _ in range((self.child.size - 1).bit_length()):
            middle = (low + high) // 2
            above = cumulative[(*row, middle)] > level
            low, high = np.where(above, low, middle + 1), np.where(above, middle, high)
        return low


def _tolerance(size: int) -> float:
    """The rounding that a sum of so many probabilities may have."""
    return max(ROUNDED * size, 1e-6) + size * float(np.finfo(float).eps)
