"""NumPy's functions that are not made of ufuncs, for traced arrays."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import numpy as np

from pgm.tracing.traced import OWN, Traced, bare, elementwise, wrapped


def traced(elements: Iterable[Any]) -> Traced:
    """A read-only vector of traced numbers."""
    each = list(elements)
    found = np.empty(len(each), dtype=object)
    found[:] = each
    found.flags.writeable = False
    return found.view(Traced)


def _where(condition: Any, *values: Any) -> Any:
    if not values:
        raise bare(condition).view(Traced)._refuse("it looks for places of values")
    return elementwise("where", condition, *values)


def _filled(value: Any) -> Callable[..., Any]:
    def like(array: Any, *fill: Any, dtype: Any = None, shape: Any = None, **_: Any) -> Any:
        found = np.empty(array.shape if shape is None else shape, dtype=object)
        found[...] = bare(fill[0]) if fill else value
        return found.view(Traced)

    return like


def _norm(x: Any, ord: Any = None, axis: Any = None, keepdims: bool = False) -> Any:
    x = wrapped(bare(x))
    if ord not in (None, 2) or isinstance(axis, tuple) or (axis is None and x.ndim != 1 and ord):
        raise x._refuse("np.linalg.norm of that kind is not traced")
    return np.sqrt((x * x).sum(axis=axis, keepdims=keepdims))


def _select(conditions: Any, choices: Any, default: Any = 0.0) -> Any:
    found = default
    for condition, choice in zip(reversed(conditions), reversed(choices), strict=True):
        found = elementwise("where", condition, choice, found)
    return found


def _nan_to_num(
    x: Any, copy: bool = True, nan: float = 0.0, posinf: Any = None, neginf: Any = None
) -> Any:
    big = np.finfo(float).max
    found = elementwise("where", np.isnan(x), nan, x)
    found = elementwise("where", np.equal(x, np.inf), big if posinf is None else posinf, found)
    return elementwise("where", np.equal(x, -np.inf), -big if neginf is None else neginf, found)


OWN |= {
    np.where: _where,
    np.zeros_like: _filled(0.0),
    np.ones_like: _filled(1.0),
    np.empty_like: _filled(None),
    np.full_like: _filled(None),
    np.linalg.norm: _norm,
    np.select: _select,
    np.nan_to_num: _nan_to_num,
}
