"""The sizes of clusters and the work they make, known before anything runs."""

from __future__ import annotations

import math
from collections.abc import Iterable

from pgm.factors.scope import Scope, dimension
from pgm.variables import Discrete, Variable


def extent(variable: Variable) -> int:
    """Number of states of a discrete variable, of components of a continuous one."""
    return variable.size if isinstance(variable, Discrete) else variable.dimension


def size(scope: Scope) -> int:
    """Entries of a table over discrete variables, or components of continuous ones."""
    if is_discrete(scope):
        return math.prod(map(extent, scope))
    return dimension(scope)


def work(scope: Scope) -> int:
    """Entries of a table, or the cube of the components, as of a Cholesky factor."""
    return size(scope) if is_discrete(scope) else size(scope) ** 3


def is_discrete(scope: Iterable[Variable]) -> bool:
    """Whether a factor over these variables is a table."""
    return any(isinstance(variable, Discrete) for variable in scope)


def amount(number: int) -> str:
    """A number for messages: a power of ten, where its digits would not be read."""
    return str(number) if number < 10**9 else f"10^{math.log10(number):.1f}"
