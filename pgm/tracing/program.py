"""Programs made of traces: a value and its derivative, as code for batches and for scalars."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any

import numpy as np

from pgm.kernels.arrays import Array
from pgm.tracing.derivatives import derivatives
from pgm.tracing.operations import BATCH, PYTHON, SCALAR, SMOOTH
from pgm.tracing.traced import Recorder

_PART = 4096
# An argument, and a component of it.
Column = tuple[int, int]


@dataclass(frozen=True, eq=False)
class Program:
    """Scalar operations that compute a value (d,) and its derivative (d, n).

    Attributes
    ----------
    graph : Recorder
    widths : tuple of int
        Components of each argument.
    value : tuple of int
        Numbers of operations: d of them.
    columns : tuple of (int, int)
        For each hidden component, stacked: the argument, and its component there.
    slope : tuple of (int or None)
        d n of them, row by row; None is zero.
    cast : bool
        Whether the function made floats of traced numbers: by them it may decide unseen.
    """

    graph: Recorder
    widths: tuple[int, ...]
    value: tuple[int, ...]
    columns: tuple[Column, ...] = ()
    slope: tuple[int | None, ...] = ()
    cast: bool = False

    def __getstate__(self) -> dict[str, Any]:
        return {field.name: self.__dict__[field.name] for field in fields(self)}

    @cached_property
    def _by(self) -> dict[tuple[tuple[Column, ...], int], Program]:
        return {}

    def by(self, columns: tuple[Column, ...], height: int | None = None) -> Program:
        """The same value, or its first components, with its derivative by some arguments."""
        value = self.value[:height]
        found = self._by.get((columns, len(value)))
        if found is None:
            graph = self.graph.copy()
            rows = derivatives(graph, value, [graph.input(*column) for column in columns])
            slope = tuple(row.get(j) for row in rows for j in range(len(columns)))
            found = replace(self, graph=graph, value=value, columns=columns, slope=slope)
            self._by[columns, len(value)] = found
        return found

    @cached_property
    def smooth(self) -> bool:
        """Whether the derivative is right wherever it is finite, as the operations show.

        That of sums, products, waves and exponentials is: it has no terms that grow as they cancel,
        as a quotient's has, and is of no branch that the function took by a comparison.
        """
        operations = [self.graph.operations[k] for k in self.graph.reachable(self.value)]
        return not self.cast and all(self._is_smooth(*operation) for operation in operations)

    def _is_smooth(self, name: str, *operands: Any) -> bool:
        if name not in ("divide", "remainder", "power"):
            return name in SMOOTH
        constant = self.graph.value(operands[1])
        return constant is not None and (name != "power" or constant in range(1, 100))

    @property
    def _components(self) -> list[Column]:
        return [(a, i) for a, width in enumerate(self.widths) for i in range(width)]

    @property
    def batch_source(self) -> str:
        """Code of a function of arguments (*batch, width) each.

        It writes to a value (d, *batch) and a derivative (d, n, *batch), components first.
        """
        arguments = ", ".join([*(f"a{a}" for a in range(len(self.widths))), "value", "slope"])
        inputs = {(a, i): f"a{a}[..., {i}]" for a, i in self._components}
        value = [f"value[{i}, ...]" for i in range(len(self.value))]
        slope = [
            f"slope[{i}, {j}, ...]" for i in range(len(value)) for j in range(len(self.columns))
        ]
        return self._printed(f"def batch({arguments}):", inputs, [*value, *slope], None)

    @property
    def scalar_source(self) -> str:
        """Code of a function of all components, in the order of the arguments, to a flat tuple."""
        inputs = {(a, i): f"a{a}_{i}" for a, i in self._components}
        return self._printed(f"def scalar({', '.join(inputs.values())}):", inputs, [], SCALAR)

    def _printed(
        self, head: str, inputs: dict[Column, str], cells: list[str], words: dict[str, str] | None
    ) -> str:
        """Code that writes to cells, or returns a tuple; without words, of NumPy's functions."""
        outputs = (*self.value, *self.slope)
        names: dict[int | None, str] = {None: "0.0"}
        lines, written = [head], set()
        # The first cell of each operation, which a ufunc writes to by itself.
        first = {} if words else dict(zip(reversed(outputs), reversed(cells), strict=True))
        for number in self.graph.reachable(k for k in outputs if k is not None):
            name, *operands = self.graph.operations[number]
            names[number] = f"t{number}"
            if name == "constant":
                names[number] = repr(operands[0])  # "nan" and "inf" are named in `made`
                continue
            if name == "input":
                text = inputs[operands[0], operands[1]]
                if text.isidentifier():
                    names[number] = text
                    continue
            elif words:
                text = words[name].format(*(names[k] for k in operands))
            else:
                known = [names[k] for k in operands]
                if number in first and name != "where":
                    known.append(f"out={first[number]}")
                    written.add(first[number])
                text = f"{name}({', '.join(known)})"
            lines.append(f"t{number} = {text}")
        results = [names[k] for k in outputs]
        if not cells:
            lines.append(f"return ({', '.join(results)},)")
        pairs = zip(cells, results, strict=False)
        lines += [f"{cell} = {found}" for cell, found in pairs if cell not in written]
        return "\n    ".join(lines)

    @cached_property
    def _batch(self) -> Callable[..., None]:
        return made(self.batch_source, "batch", BATCH)

    @cached_property
    def _scalar(self) -> Callable[..., tuple[float, ...]]:
        return made(self.scalar_source, "scalar", PYTHON)

    def batch(self, arguments: Sequence[Array], shape: tuple[int, ...]) -> tuple[Array, Array]:
        """The value (d, *shape) and the derivative (d, n, *shape) at arguments (*shape, width)."""
        height = len(self.value)
        value = np.empty((height, *shape))
        slope = np.empty((height, len(self.columns), *shape))
        with np.errstate(all="ignore"):
            for cut in _cuts(shape):
                parts = [argument[cut] for argument in arguments]
                self._batch(*parts, value[:, *cut], slope[:, :, *cut])
        return value, slope

    def numbers(self, components: Sequence[float]) -> tuple[float, ...] | None:
        """The value and the derivative, row by row, at all components of the arguments.

        None where Python raises what NumPy makes infinities and NaNs of.
        """
        try:
            return self._scalar(*components)
        except (ArithmeticError, ValueError):
            return None

    def single(self, arguments: Sequence[Array]) -> tuple[Array, Array, bool]:
        """The value (d,), the derivative (d, n), and whether they are finite, at (width,) each."""
        found = self.numbers([c for argument in arguments for c in argument.tolist()])
        if found is None:
            value, slope = self.batch(arguments, ())
            return value, slope, bool(np.isfinite(value).all() and np.isfinite(slope).all())
        every, height = np.array(found, dtype=float), len(self.value)
        return every[:height], every[height:].reshape(height, -1), math.isfinite(sum(found))


def _cuts(shape: tuple[int, ...]) -> Iterator[tuple[slice, ...]]:
    """Parts of a batch, along its longest axis, whose intermediate results stay in the cache."""
    count, longest = math.prod(shape), max(shape, default=1)
    if count <= _PART:
        yield ()
        return
    axis, step = shape.index(longest), max(_PART * longest // count, 1)
    for first in range(0, longest, step):
        yield (*(slice(None),) * axis, slice(first, first + step))


def made(source: str, name: str, names: dict[str, Any]) -> Callable[..., Any]:
    """The function that a printer wrote."""
    found: dict[str, Any] = {**names, "nan": np.nan, "inf": np.inf}
    exec(compile(source, f"<traced {name}>", "exec"), found)
    made: Callable[..., Any] = found[name]
    return made
