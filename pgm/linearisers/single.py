"""The library's linearisers at one belief, (n,) and (n, n), without the axes of many.

A filter of a single robot spends most of its time on what surrounds a few small products, so
everything that does not change from step to step is prepared once here. What is out of the
ordinary is left to the general way: it is raised as `Special`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any

import numpy as np

from pgm.kernels import single
from pgm.kernels.arrays import Array
from pgm.linearisers.function import FunctionTemplate

# Values of the parents with evidence, (d,), or (M, d) of several sightings.
Rows = list[Array]
_FLOAT = np.dtype(np.float64)


class Special(Exception):
    """A case that the general linearisers are for."""


# What became of a function, y = v + F (x − μ) + n, n ~ N(0, error): F (D, n), v (D,), and error
# (D, D) with the covariances between sightings, or None; D = d times their number. F and v may be
# arrays that a function of the user keeps.
Line = tuple[Array, Array, Array | None]


class SingleLineariser(ABC):
    """A function and how it is linearised, prepared for one belief at a time.

    Parameters
    ----------
    template : FunctionTemplate
    given : list of int or None
        Of each argument of the function, which of the rows are its values; None for hidden ones.
    """

    def __init__(self, template: FunctionTemplate, given: Sequence[int | None]) -> None:
        everything = slice(0, template.size)
        self.template, self.function = template, template.function
        # None for a parent that is all there is, which need not be cut out.
        places = [None if place == everything else place for place in template.places]
        self.arguments = list(zip(given, places, strict=True))
        self.arity = len(self.arguments)
        self.given = [(place, row) for place, row in enumerate(given) if row is not None]
        self.cut = [
            (k, places[k]) for k, row in enumerate(given) if row is None and places[k] is not None
        ]
        self.height = template.child.dimension
        self.angles = np.flatnonzero(template.angles).tolist()
        self.value_shape = (self.height,)
        self.slope_shape = (self.height, template.size)
        # Of a single hidden parent the derivative is all of the Jacobian.
        derivatives = [
            derivative
            for row, derivative in zip(given, template.jacobians, strict=True)
            if row is None
        ]
        self.derivative = derivatives[0] if len(derivatives) == 1 else None

    @abstractmethod
    def linearise(self, rows: Rows, count: int, step: int, mean: Array, cov: Array) -> Line:
        """Linearise at a belief; a method, since Python calls objects more slowly.

        Parameters
        ----------
        rows : list of ndarray
            What is given.
        count : int
            Sightings, which are linearised as one.
        step : int
        mean, cov : ndarray
            (n,) and (n, n).
        """

    def here(self, mean: Array, rows: Rows, count: int) -> list[Array]:
        """What the function is called with at the mean: (d,) or (count, d) each."""
        arguments = [mean] * self.arity
        for place, part in self.cut:
            arguments[place] = mean[part]
        if count > 1:
            arguments = [np.broadcast_to(value, (count, len(value))) for value in arguments]
        for place, row in self.given:
            arguments[place] = rows[row]
        return arguments

    def around(self, x: Array, rows: Rows, count: int) -> list[Array]:
        """What the function is called with at points (N, n): (N, d) or (N, count, d) each."""
        arguments = []
        many = len(x)
        for row, place in self.arguments:
            if row is None:
                value = x if place is None else x[:, place]
                if count > 1:
                    value = np.broadcast_to(value[:, None], (many, count, value.shape[1]))
            else:
                # As broadcast_to makes it, at a fraction of the cost, and as read-only.
                given = np.ascontiguousarray(rows[row])
                value = np.ndarray((many, *given.shape), _FLOAT, given, 0, (0, *given.strides))
            arguments.append(value)
        return arguments

    def values(self, x: Array, rows: Rows, count: int) -> Array:
        """The function's values at points (N, n), (N, D)."""
        many = len(x)
        value = self.function(*self.around(x, rows, count))
        if count == 1:
            return checked(value, (many, self.height))
        return checked(value, (many, count, self.height)).reshape(many, -1)

    def slope(
        self, arguments: list[Array], rows: Rows, count: int, mean: Array, cov: Array
    ) -> Array:
        """The Jacobian at the mean, (D, n), where the arguments are."""
        template = self.template
        numerical = None
        if template.numerical:
            points, steps = single.difference_points(mean, cov)
            values = self.values(points, rows, count)
            numerical = single.differences(values, steps, self.angles_of(count))
            if len(template.numerical) == template.size:
                return numerical
        lead = () if count == 1 else (count,)
        parts = []
        for parent, place, derivative in zip(
            template.given, template.places, template.jacobians, strict=True
        ):
            if place is None:
                continue
            if derivative is None:
                assert numerical is not None
                parts.append(numerical[:, place])
                continue
            width = parent.dimension
            part = checked(derivative(*arguments), (*lead, self.height, width))
            parts.append(part.reshape(-1, width))
        return parts[0] if len(parts) == 1 else np.concatenate(parts, axis=1)

    def angles_of(self, count: int) -> list[int]:
        """Which components of a value are angles."""
        if count == 1 or not self.angles:
            return self.angles
        return [k * self.height + angle for k in range(count) for angle in self.angles]


def checked(value: Any, due: tuple[int, ...]) -> Array:
    """What a user's function returned; what is not as it should be is left to the general way."""
    if type(value) is np.ndarray and value.dtype is _FLOAT and value.shape == due:
        return value
    array = np.asanyarray(value)
    if type(array) is not np.ndarray or array.shape != due or array.dtype.kind not in "fiub":
        raise Special
    return array.astype(np.float64)
