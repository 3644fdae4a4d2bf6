"""A small Gaussian predicted and updated number by number, in straight lines of Python.

They are written once for each size, and take a fraction of the time of calls of NumPy and LAPACK.
Covariances are exactly symmetric.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import lru_cache
from math import log, prod, sqrt
from struct import pack
from typing import Any

import numpy as np

from pgm.kernels.arrays import LOG_2PI, Array

# Of n components and d others, beyond n d (n + d) of this size LAPACK is the quicker.
MOST = 90

# Arguments and results as of `predict`, `update_one` and `is_moderate` in `gaussian`.
Predict = Callable[[Array, Array, Array], Array]
Update = Callable[[Array, Array, Array, Array, Array], tuple[Array, Array, float] | None]
Check = Callable[[Array, Array, Array], bool]


@lru_cache(maxsize=64)
def updating(size: int, height: int, least: float) -> Update | None:
    """The update of n components by d measurements, None of a pivot below `least`; or too large."""
    if not 0 < size * height * (size + height) <= MOST:
        return None
    names = {"least": least, "constant": 0.5 * height * LOG_2PI}
    lines = _update(size, height)
    update: Update = _function("mean, cov, matrix, residual, noise", lines, names)
    return update


@lru_cache(maxsize=64)
def predicting(height: int, size: int) -> Predict | None:
    """The prediction of d components from n; None where that is too large."""
    if not 0 < size * height * (size + height) <= MOST:
        return None
    predict: Predict = _function("cov, matrix, noise", _predict(height, size), {})
    return predict


@lru_cache(maxsize=64)
def checking(size: int, least: float, far: float) -> Check | None:
    """Whether moments are moderate beside an earlier covariance; None where that is too large."""
    if not 0 < size**3 <= MOST:
        return None
    names = {"least": least, "far": far}
    check: Check = _function("mean, cov, before", _check(size), names)
    return check


def _function(arguments: str, lines: list[str], names: dict[str, float]) -> Any:
    scope: dict[str, Any] = {"array": np.ndarray, "pack": pack, "sqrt": sqrt, "log": log, **names}
    exec(f"def function({arguments}):\n    " + "\n    ".join(lines), scope)
    return scope["function"]


def _predict(height: int, size: int) -> list[str]:
    """F P Fᵀ + N, with C = F P."""
    states, after = range(size), range(height)
    lines = [
        f"{_matrix('p', states, states)} = cov.tolist()",
        f"{_matrix('f', after, states)} = matrix.tolist()",
        f"{_matrix('n', after, after)} = noise.tolist()",
    ]
    for i in after:
        for j in states:
            lines.append(f"c{i}{j} = {_sum(f'f{i}{k} * p{k}{j}' for k in states)}")
        for j in range(i + 1):
            moved = _sum(f"c{i}{k} * f{j}{k}" for k in states)
            lines.append(f"q{i}{j} = q{j}{i} = n{i}{j} + {moved}")
    return [*lines, f"return {_array((f'q{i}{j}' for i in after for j in after), height, height)}"]


def _update(size: int, height: int) -> list[str]:
    """With C = H P, S = C Hᵀ + N = L Lᵀ, G = Cᵀ S⁻¹ and K = I − G H: K P Kᵀ + G N Gᵀ."""
    states, seen = range(size), range(height)
    lines = [
        f"{_matrix('p', states, states)} = cov.tolist()",
        f"{_matrix('h', seen, states)} = matrix.tolist()",
        f"{_matrix('n', seen, seen)} = noise.tolist()",
        f"{_vector('m', states)} = mean.tolist()",
        f"{_vector('z', seen)} = residual.tolist()",
    ]
    for i in seen:
        for j in states:
            lines.append(f"c{i}{j} = {_sum(f'h{i}{k} * p{k}{j}' for k in states)}")
    for i in seen:
        for j in range(i + 1):
            lines.append(f"s = n{i}{j} + {_sum(f'c{i}{k} * h{j}{k}' for k in states)}")
            rest = f"s{_less(f'l{i}{k} * l{j}{k}' for k in range(j))}"
            if j < i:
                lines.append(f"l{i}{j} = ({rest}) / l{j}{j}")
        lines.append(f"rest = {rest}")
        lines.append("if not rest > least * s: return None")
        lines.append(f"l{i}{i} = sqrt(rest)")
    lines += _white("z", seen)
    square = _sum(f"w{i} * w{i}" for i in seen)
    volume = _less(f"log(l{i}{i})" for i in seen)
    lines.append(f"log_density = -0.5 * ({square}){volume} - constant")
    for j in states:
        lines += _white("c", seen, str(j))
        for i in reversed(seen):
            rest = f"w{i}{_less(f'l{k}{i} * g{j}{k}' for k in range(i + 1, height))}"
            lines.append(f"g{j}{i} = ({rest}) / l{i}{i}")
    for i in states:
        for j in states:
            lines.append(f"k{i}{j} = {int(i == j)}.0{_less(f'g{i}{k} * h{k}{j}' for k in seen)}")
        for j in states:
            lines.append(f"a{i}{j} = {_sum(f'k{i}{k} * p{k}{j}' for k in states)}")
        for j in seen:
            lines.append(f"b{i}{j} = {_sum(f'g{i}{k} * n{k}{j}' for k in seen)}")
        for j in range(i + 1):
            before = _sum(f"a{i}{k} * k{j}{k}" for k in states)
            lines.append(
                f"q{i}{j} = q{j}{i} = {before} + {_sum(f'b{i}{k} * g{j}{k}' for k in seen)}"
            )
    moved = _array((f"m{i} + {_sum(f'g{i}{k} * z{k}' for k in seen)}" for i in states), size)
    spread = _array((f"q{i}{j}" for i in states for j in states), size, size)
    return [*lines, f"return {moved}, {spread}, log_density"]


def _check(size: int) -> list[str]:
    """The pivots d of Q, beside its own diagonal and that of B; and the mean m beside Q."""
    states = range(size)
    lines = [
        f"{_vector('m', states)} = mean.tolist()",
        f"{_matrix('q', states, states)} = cov.tolist()",
        f"{_matrix('b', states, states)} = before.tolist()",
    ]
    for i in states:
        for k in range(i):
            rest = f"q{i}{k}{_less(f'l{i}{m} * u{k}{m}' for m in range(k))}"
            lines += [f"u{i}{k} = {rest}", f"l{i}{k} = u{i}{k} / d{k}"]
        lines.append(f"d{i} = q{i}{i}{_less(f'l{i}{k} * u{i}{k}' for k in range(i))}")
        regular = f"d{i} > least * q{i}{i} and q{i}{i} > least * b{i}{i}"
        lines.append(f"if not ({regular} and m{i} * m{i} < far * q{i}{i}): return False")
    return [*lines, "return True"]


def _white(name: str, rows: range, column: str = "") -> list[str]:
    return [
        f"w{i} = ({name}{i}{column}{_less(f'l{i}{k} * w{k}' for k in range(i))}) / l{i}{i}"
        for i in rows
    ]


def _sum(terms: Iterable[str]) -> str:
    return " + ".join(terms)


def _less(terms: Iterable[str]) -> str:
    return "".join(f" - {term}" for term in terms)


def _array(numbers: Iterable[str], *shape: int) -> str:
    """An array of packed numbers, read-only, which takes half the time of NumPy's own."""
    return f"array({shape}, float, pack('{prod(shape)}d', {', '.join(numbers)}))"


def _vector(name: str, places: Iterable[object]) -> str:
    return f"({''.join(f'{name}{k}, ' for k in places)})"


def _matrix(name: str, rows: range, columns: range) -> str:
    return f"({''.join(_vector(f'{name}{i}', columns) + ', ' for i in rows)})"
