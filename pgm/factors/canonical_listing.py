"""Canonical forms as text: g, and h beside K, of the first run."""

from __future__ import annotations

from pgm.display import Summary, named_matrix, number
from pgm.factors.scope import Scope, components
from pgm.kernels.arrays import Array


def summary(title: str, scope: Scope, K: Array, h: Array, g: Array) -> Summary:
    """The first of the forms: its log-scale, vector and matrix."""
    if not g.size:
        return Summary(title)
    first, heads = (0,) * g.ndim, components(scope)
    scale = f"g = {number(g[first], 6)}"
    if first:
        scale = f"run {', '.join(map(str, first))}: {scale}"
    if not heads:
        return Summary(title, [scale])
    return Summary(title, [scale, named_matrix(heads, heads, K[first], "K", [("h", h[first])])])
