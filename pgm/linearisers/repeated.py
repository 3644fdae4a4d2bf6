"""A CPD's function at one row after another, with its evidence laid out once."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from pgm.immutable import set_writeable
from pgm.kernels.arrays import Array
from pgm.linearisers.function import FEW, BoundFunction, is_due
from pgm.linearisers.template import FunctionTemplate


class Repeated:
    """A CPD's function at one of its rows after another, at points of one shape.

    It calls the function as the `BoundFunction` of a row does. That one takes longer to make than
    many a function to answer, and is made for errors alone.

    Parameters
    ----------
    template : FunctionTemplate
    inputs : sequence of ndarray or None
        Values of the parents with evidence, (rows, *lead, d) each, None for the hidden ones.
    lead, more : tuple of int
        The leading axes of a belief, and those of points behind them.
    bind : callable
        From the number of a row to its `BoundFunction`.
    """

    def __init__(
        self,
        template: FunctionTemplate,
        inputs: Sequence[Array | None],
        lead: tuple[int, ...],
        more: tuple[int, ...],
        bind: Callable[[int], BoundFunction],
    ) -> None:
        self._function, self._bind = template.function, bind
        self._due = *lead, *more, template.height
        places = [None] * len(inputs) if template.undivided else template.places
        self._arguments = [
            (place, None if values is None else _wide(values, lead, more))
            for place, values in zip(places, inputs, strict=True)
        ]
        # A row's evidence is repeated for its points in memory of its own where that is small.
        self._copied = bool(more) and all(
            values is None or values[:1].size <= FEW for _, values in self._arguments
        )

    def __call__(self, row: int, x: Array) -> Array:
        """The values (*lead, *more, d) at points (*lead, *more, n), which are sealed."""
        set_writeable(x, False)
        arguments = [
            (x if place is None else x[..., place])
            if values is None
            else (values[row].copy() if self._copied else values[row])
            for place, values in self._arguments
        ]
        try:
            value = self._function(*arguments)
        except Exception as error:
            raise self._bind(row)._failure(x, arguments, error) from error
        return value if is_due(value, self._due) else self._bind(row)._array(x, arguments, value)


def _wide(values: Array, lead: tuple[int, ...], more: tuple[int, ...]) -> Array:
    """Evidence (rows, *lead, d) as a read-only view that is the same at all points."""
    rows, *runs, size = values.shape
    alike = values.reshape(rows, *runs, *(1 for _ in more), size)
    return np.broadcast_to(alike, (rows, *lead, *more, size))
