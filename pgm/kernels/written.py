"""Straight lines of Python, written by running a function over numbers that write themselves.

For one small matrix a call of NumPy takes longer than its arithmetic: a function of `step`, run
once over matrices of `Written` numbers, leaves the operations on numbers of which it is made, and
these are compiled as a function of arrays. The numbers are floats, or rows of runs where the arrays
have the runs last.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from math import log, prod, sqrt
from struct import pack
from typing import Any

import numpy as np
import numpy.typing as npt

from pgm.kernels.numbers import Matrix

# Patterns for floats, and those for rows of runs in their place.
_ALONG_RUNS = {
    "({1} if {0} else {2})": "where({0}, {1}, {2})",
    "({} and {})": "(({}) & ({}))",
    "({} or {})": "(({}) | ({}))",
}
# From matrices of arguments, what a function returns, and the truth unless which it is None.
Body = Callable[..., tuple[Sequence[Any], Any]]


class Written:
    """A number of a program: a name, or an expression in earlier numbers.

    The expression is a pattern with a place for each of its numbers.
    """

    __slots__ = ("numbers", "pattern")

    def __init__(self, pattern: str, *numbers: Any) -> None:
        self.pattern, self.numbers = pattern, numbers

    def __add__(self, other: Any) -> Written:
        return Written("({} + {})", self, other)

    def __radd__(self, other: Any) -> Written:
        return Written("({} + {})", other, self)

    def __sub__(self, other: Any) -> Written:
        return Written("({} - {})", self, other)

    def __rsub__(self, other: Any) -> Written:
        return Written("({} - {})", other, self)

    def __mul__(self, other: Any) -> Written:
        return Written("({} * {})", self, other)

    def __rmul__(self, other: Any) -> Written:
        return Written("({} * {})", other, self)

    def __truediv__(self, other: Any) -> Written:
        return Written("({} / {})", self, other)

    def __rtruediv__(self, other: Any) -> Written:
        return Written("({} / {})", other, self)

    def __neg__(self) -> Written:
        return Written("(-{})", self)

    def __abs__(self) -> Written:
        return Written("abs({})", self)

    def __lt__(self, other: Any) -> Written:
        return Written("{} < {}", self, other)

    def __gt__(self, other: Any) -> Written:
        return Written("{} > {}", self, other)

    def __eq__(self, other: object) -> Written:  # type: ignore[override]
        return Written("{} == {}", self, other)

    def __ne__(self, other: object) -> Written:  # type: ignore[override]
        return Written("{} != {}", self, other)

    __hash__ = None  # type: ignore[assignment]  # none is equal to another

    def __and__(self, other: Any) -> Written:
        return Written("({} and {})", self, other)

    def __or__(self, other: Any) -> Written:
        return Written("({} or {})", self, other)

    def apply(self, name: str) -> Written:
        """The function of this name; where floats have no such value it raises ValueError."""
        return Written(name + "({})", self)

    @staticmethod
    def choose(truth: Any, a: Any, b: Any) -> Written:
        """One number where a truth holds, else the other."""
        return Written("({1} if {0} else {2})", truth, a, b)


def array(found: Matrix, *shape: int) -> Written:
    """An array of numbers, row by row.

    It is packed, and read-only, which takes half the time of NumPy's own.
    """
    numbers = [number for row in found.rows for number in row]
    places = ", ".join(["{}"] * len(numbers))
    return Written(f"array({shape}, float, pack('{prod(shape)}d', {places}))", *numbers)


def rows(found: Matrix, *shape: int) -> Written:
    """An array of rows of runs, (*shape, runs), each a number of the matrix, row by row."""
    numbers = [number for row in found.rows for number in row]
    places = ", ".join(["{}"] * len(numbers))
    return Written(f"stack([{places}]).reshape({shape} + (-1,))", *numbers)


def function(
    shapes: Mapping[str, tuple[int, ...]], body: Body, *, along_runs: bool = False
) -> Callable[..., Any]:
    """The function of arrays of these shapes, by name, that the body describes.

    With `along_runs` the arrays have the runs as a further axis, the last.

    The body gets a matrix of numbers for each array, of one column for a vector. It returns what is
    to be returned, as a tuple if several, and a truth unless which the function returns None. None
    is also returned where a root, a logarithm or a quotient of floats has no value.
    """
    arguments, targets = _arguments(shapes)
    found, truth = body(*arguments)
    given = [name if along_runs else f"{name}.tolist()" for name in shapes]
    lines = [f"{target} = {name}" for target, name in zip(targets, given, strict=True)]
    program = _Program([truth, *found], lines, _ALONG_RUNS if along_runs else {})
    lines.append(f"if not {program.text(truth)}: return None")
    lines.append(f"return {', '.join([program.text(number) for number in found])}")
    return _compiled(shapes, lines, _OF_RUNS if along_runs else _OF_FLOATS)


def each(shapes: Mapping[str, tuple[int, ...]], body: Body) -> Callable[..., Any]:
    """The function of arrays of these shapes in several runs, one after another, in floats.

    The arrays have the runs as a further axis, the last, of length one where all have the same; the
    first array has all. The body returns numbers, tuples of n numbers and matrices (m, n); the
    function an array of each, (runs,), (n, runs) or (m, n, runs), or None where that is returned of
    any run. See `function`.
    """
    arguments = [_argument(name, *shape) for name, shape in shapes.items()]
    targets = [_tuple(number.pattern for row in each.rows for number in row) for each in arguments]
    found, truth = body(*arguments)
    every: list[Any] = []
    views: list[str] = []
    for part in found:
        begin, axes = len(every), "runs"
        if isinstance(part, Matrix):
            every += [number for row in part.rows for number in row]
            axes = f"{len(part.rows)}, {part.width}, runs"
        elif isinstance(part, tuple):
            every += part
            axes = f"{len(part)}, runs"
        else:
            every.append(part)
        views.append(f"whole[{begin}:{len(every)}].reshape({axes})")
    lines: list[str] = []
    program = _Program([truth, *every], lines, {})
    lines.append(f"if not {program.text(truth)}: return None")
    lines.append(f"found += {_tuple([program.text(number) for number in every])}")
    first, *_ = shapes
    runs, size = ", ".join([f"by_run({name}, runs)" for name in shapes]), len(every)
    head = [f"runs, found = {first}.shape[-1], []", f"for {_tuple(targets)} in zip({runs}):"]
    # Contiguous along the runs, as arrays that have these last mostly are.
    whole = f"whole = array((runs, {size}), float, pack(f'{{runs * {size}}}d', *found)).T.copy()"
    last = f"return {_tuple(views)}"
    return _compiled(shapes, [*head, *(f" {line}" for line in lines), whole, last], _OF_FLOATS)


def _compiled(
    names: Iterable[str], lines: Iterable[str], scope: Mapping[str, Any]
) -> Callable[..., Any]:
    """The function of these lines, which returns None where a float has no value."""
    source = f"def function({', '.join(names)}):\n try:\n  " + "\n  ".join(lines)
    source += "\n except (ValueError, ZeroDivisionError):\n  return None"
    own = dict(scope)
    exec(source, own)
    compiled: Callable[..., Any] = own["function"]
    return compiled


def _arguments(shapes: Mapping[str, tuple[int, ...]]) -> tuple[list[Matrix], list[str]]:
    """The matrices of arguments, and the tuples of names that their lists are assigned to."""
    arguments = [_argument(name, *shape) for name, shape in shapes.items()]
    targets = []
    for argument, shape in zip(arguments, shapes.values(), strict=True):
        names = [[number.pattern for number in row] for row in argument.rows]
        targets.append(_tuple([_tuple(row) if len(shape) > 1 else row[0] for row in names]))
    return arguments, targets


def _argument(name: str, height: int, width: int = 1) -> Matrix:
    return Matrix([Written(f"{name}{i}_{j}") for j in range(width)] for i in range(height))


def _tuple(texts: Iterable[str]) -> str:
    return f"({''.join(text + ', ' for text in texts)})"


def _by_run(array: npt.NDArray[np.float64], runs: int) -> list[Any]:
    """The numbers of an array (*shape, runs or 1) by run, as a list each."""
    numbers: list[Any] = array.reshape(-1, array.shape[-1]).T.tolist()
    return numbers if len(numbers) == runs else numbers * runs


# The names in programs.
_OF_FLOATS = {
    "array": np.ndarray,
    "by_run": _by_run,
    "pack": pack,
    "sqrt": sqrt,
    "log": log,
    "rint": round,
}
_OF_RUNS = {"stack": np.array, "sqrt": np.sqrt, "log": np.log, "rint": np.rint, "where": np.where}


class _Program:
    """The lines of a function, of which each names a number that is used more than once."""

    def __init__(
        self, results: Sequence[Any], lines: list[str], patterns: Mapping[str, str]
    ) -> None:
        self._patterns = patterns
        # By the identities of numbers, which live as long as the results that they are part of.
        self.lines, self._uses = lines, Counter[int]()
        self._names: dict[int, str] = {}
        left = list(results)
        while left:
            number = left.pop()
            if isinstance(number, Written):
                if not self._uses[id(number)]:
                    left += number.numbers
                self._uses[id(number)] += 1

    def text(self, number: Any) -> str:
        """The expression or the name of a number; its line is added where it has none yet."""
        if not isinstance(number, Written):
            return repr(number)
        if id(number) in self._names:
            return self._names[id(number)]
        pattern = self._patterns.get(number.pattern, number.pattern)
        text = pattern.format(*[self.text(each) for each in number.numbers])
        if not number.numbers or self._uses[id(number)] == 1:
            return text
        name = self._names[id(number)] = f"_{len(self._names)}"
        self.lines.append(f"{name} = {text}")
        return name
