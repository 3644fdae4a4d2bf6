"""Programs made of traces: a value and its derivative, as code for batches, scalars and Numba."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from pgm.kernels.arrays import Array
from pgm.tracing.graph import Graph
from pgm.tracing.operations import BATCH, MACHINE, PYTHON, SCALAR

_PART = 4096
# An argument, and a component of it.
Column = tuple[int, int]


@dataclass(frozen=True, eq=False)
class Program:
    """Scalar operations that compute a value (d,) and its derivative (d, n).

    Attributes
    ----------
    graph : Graph
    widths : tuple of int
        Components of each argument.
    columns : tuple of (int, int)
        Of each hidden component, stacked: the argument, and its component there.
    value : tuple of int
        Numbers of operations: d of them.
    slope : tuple of (int or None)
        d n of them, row by row; None is zero.
    """

    graph: Graph
    widths: tuple[int, ...]
    columns: tuple[Column, ...]
    value: tuple[int, ...]
    slope: tuple[int | None, ...]

    def __getstate__(self) -> dict[str, Any]:
        keep = ("graph", "widths", "columns", "value", "slope")
        return {name: self.__dict__[name] for name in keep}

    @property
    def observed(self) -> list[Column]:
        """The components of observed arguments, in the order in which they are stacked."""
        taken = set(self.columns)
        every = [(a, i) for a, width in enumerate(self.widths) for i in range(width)]
        return [component for component in every if component not in taken]

    @property
    def _outputs(self) -> list[int]:
        return [*self.value, *(k for k in self.slope if k is not None)]

    @property
    def batch_source(self) -> str:
        """Code of a function of arguments (*batch, width) each.

        It writes to a value (d, *batch) and a derivative (d, n, *batch), components first.
        """
        inputs = {
            (a, i): f"a{a}[..., {i}]" for a, width in enumerate(self.widths) for i in range(width)
        }
        arguments = ", ".join([*(f"a{a}" for a in range(len(self.widths))), "value", "slope"])
        n = len(self.columns)
        cells = [
            *((k, f"value[{i}, ...]") for i, k in enumerate(self.value)),
            *((k, f"slope[{s // n}, {s % n}, ...]") for s, k in enumerate(self.slope)),
        ]
        return self._printed(f"def batch({arguments}):", inputs, cells, batch=True)

    @property
    def scalar_source(self) -> str:
        """Code of a function of all components, in the order of the arguments, to a flat tuple."""
        inputs = {(a, i): f"a{a}_{i}" for a, width in enumerate(self.widths) for i in range(width)}
        cells = [(k, None) for k in (*self.value, *self.slope)]
        return self._printed(f"def scalar({', '.join(inputs.values())}):", inputs, cells)

    @property
    def pointer_source(self) -> str:
        """Code of a function of pointers, for Numba: hidden components x, observed ones u.

        It writes to a value (d,) and a derivative (d n,), row by row, of a run, or of a pack of
        runs, whose observed components lie `apart` from each other.
        """
        inputs = {column: f"x[{k}]" for k, column in enumerate(self.columns)}
        inputs |= {
            component: f"take(u, {k}, apart, x)" for k, component in enumerate(self.observed)
        }
        cells = [
            *((k, f"value[{i}]") for i, k in enumerate(self.value)),
            *((k, f"slope[{s}]") for s, k in enumerate(self.slope)),
        ]
        head = "def pointer(x, u, apart, value, slope):"
        return self._printed(head, inputs, cells, words=MACHINE)

    def _printed(
        self,
        head: str,
        inputs: dict[Column, str],
        cells: Sequence[tuple[int | None, str | None]],
        *,
        batch: bool = False,
        words: dict[str, str] = SCALAR,
    ) -> str:
        names: dict[int | None, str] = {None: "0.0"}
        lines, results = [head], []
        # The first cell of each operation, which a ufunc writes to by itself.
        first = dict(reversed(cells)) if batch else {}
        taken = set()
        for number in self.graph.reachable(self._outputs):
            name, *operands = self.graph.operations[number]
            if name == "constant":
                names[number] = _literal(operands[0])
                continue
            names[number] = f"t{number}"
            if name == "input":
                text = inputs[operands[0], operands[1]]
                if text.isidentifier():
                    names[number] = text
                    continue
            else:
                known = [names[k] for k in operands]
                text = words[name].format(*known)
                if batch:
                    if number in first and name != "where":
                        known.append(f"out={first[number]}")
                        taken.add(first[number])
                    text = f"{name}({', '.join(known)})"
            lines.append(f"t{number} = {text}")
        for k, cell in cells:
            if cell is None:
                results.append(names[k])
            elif not batch or cell not in taken:
                lines.append(f"{cell} = {names[k]}")
        if results:
            lines.append(f"return ({', '.join(results)},)")
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

    def single(self, arguments: Sequence[Array]) -> tuple[Array, Array, bool]:
        """The value (d,), the derivative (d, n), and whether they are finite, at (width,) each."""
        height = len(self.value)
        try:
            found = self._scalar(*[c for argument in arguments for c in argument.tolist()])
            finite = math.isfinite(sum(found))
        except (ArithmeticError, ValueError):  # where NumPy has infinities and NaNs
            value, slope = self.batch(arguments, ())
            return value, slope, bool(np.isfinite(value).all() and np.isfinite(slope).all())
        every = np.array(found, dtype=float)
        return every[:height], every[height:].reshape(height, -1), finite


def _cuts(shape: tuple[int, ...]) -> Iterator[tuple[slice, ...]]:
    """Parts of a batch, along its longest axis, whose intermediate results stay in the cache."""
    count, longest = math.prod(shape), max(shape, default=1)
    if count <= _PART:
        yield ()
        return
    axis, step = shape.index(longest), max(_PART * longest // count, 1)
    for first in range(0, longest, step):
        yield (*(slice(None),) * axis, slice(first, first + step))


def _literal(value: float | bool) -> str:
    if value != value:
        return "nan"
    return repr(value) if value not in (np.inf, -np.inf) else ("inf" if value > 0 else "-inf")


def made(source: str, name: str, names: dict[str, Any]) -> Callable[..., Any]:
    """The function that a printer wrote."""
    found: dict[str, Any] = {**names, "nan": np.nan, "inf": np.inf}
    exec(compile(source, f"<traced {name}>", "exec"), found)
    made: Callable[..., Any] = found[name]
    return made
