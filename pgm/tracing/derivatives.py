"""Forward-mode derivatives of graphs, sparse: what is known to be zero is not computed."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

from pgm.tracing.traced import Node, Recorder, scalar


def derivatives(
    graph: Recorder, outputs: Sequence[int], inputs: Sequence[int]
) -> list[dict[int, int]]:
    """The derivatives of outputs by inputs, recorded in their graph.

    `where` chooses between the derivatives of its two values, so that one of them that is
    infinite or NaN does no harm where the other is chosen. At a kink they are the mean of those on
    both sides, as central differences have it: 0 of |a| at 0, half of each of a maximum of
    equals. The derivative of a step is zero.

    Returns
    -------
    list of dict
        For each output, the node numbers of its derivatives by input; zeros are left out.
    """
    rows: dict[int, dict[int, Any]] = {}
    for column, number in enumerate(inputs):
        rows.setdefault(number, {})[column] = Node(graph, graph.constant(1.0))
    for number in graph.reachable(outputs):
        name, *operands = graph.operations[number]
        parts = [rows.get(k, {}) for k in operands]
        if name in _CHOICES and (parts[-2] or parts[-1]):
            nodes = [Node(graph, k) for k in operands]
            found = {
                j: _CHOICES[name](*nodes, parts[-2].get(j, 0.0), parts[-1].get(j, 0.0))
                for j in {**parts[-2], **parts[-1]}
            }
        elif name in _PARTIALS and any(parts):
            partials = _PARTIALS[name](*(Node(graph, k) for k in (*operands, number)))
            found = {}
            for partial, part in zip(partials, parts, strict=True):
                for j, slope in part.items() if not _zero(partial) else ():
                    term = partial * slope
                    found[j] = found[j] + term if j in found else term
        else:
            continue
        rows[number] = {j: slope for j, slope in found.items() if not _zero(slope)}
    return [{j: d.number for j, d in rows.get(k, {}).items()} for k in outputs]


def _zero(value: Any) -> bool:
    return (value.graph.value(value.number) if isinstance(value, Node) else value) == 0.0


def _extreme(beyond: str, a: Any, b: Any, by_a: Any, by_b: Any) -> Any:
    """The derivative of whichever lies beyond the other, or the mean of both where they tie."""
    if _zero(by_a):
        a, b, by_a, by_b = b, a, by_b, by_a
    lesser, larger = scalar(beyond, b, a), scalar(beyond, a, b)
    if _zero(by_b):  # the share is that of all columns
        return scalar("where", larger, 1.0, scalar("where", lesser, 0.0, 0.5)) * by_a
    otherwise = scalar("where", lesser, by_b, 0.5 * (by_a + by_b))
    return scalar("where", larger, by_a, otherwise)


def _divided(a: Any, b: Any, n: Any) -> tuple[Any, Any]:
    if a.graph.operations[a.number] == ("sin", b.number):
        # Of sin b / b the quotient's rule cancels near 0; there it is a series.
        s, series = b * b, 1.0
        for divisor in (88.0, 54.0, 28.0, 10.0):
            series = 1.0 - s / divisor * series
        near = abs(b) < 0.25
        return 0.0, scalar("where", near, b / -3.0 * series, (b.cos() - n) / b)
    inverse = 1.0 / b
    return inverse, -(n * inverse)


def _angle(a: Any, b: Any, n: Any) -> tuple[Any, Any]:
    square = a * a + b * b
    return b / square, -(a / square)


def _power(a: Any, b: Any, n: Any) -> tuple[Any, Any]:
    return b * a ** (b - 1.0), scalar("where", n == 0.0, 0.0, n * a.log())


_CHOICES: dict[str, Callable[..., Any]] = {
    "where": lambda c, a, b, by_a, by_b: scalar("where", c, by_a, by_b),
    "maximum": lambda *at: _extreme("greater", *at),
    "minimum": lambda *at: _extreme("less", *at),
}
_LN2, _LN10 = math.log(2.0), math.log(10.0)
# By each operand, of the operands and the operation itself; what is not here is a step.
_PARTIALS: dict[str, Callable[..., tuple[Any, ...]]] = {
    "add": lambda a, b, n: (1.0, 1.0),
    "subtract": lambda a, b, n: (1.0, -1.0),
    "multiply": lambda a, b, n: (b, a),
    "divide": _divided,
    "hypot": lambda a, b, n: (a / n, b / n),
    "arctan2": _angle,
    "power": _power,
    "remainder": lambda a, b, n: (1.0, -(a / b).floor()),
    "fmod": lambda a, b, n: (1.0, -(a / b).trunc()),
    "copysign": lambda a, b, n: (scalar("where", a == n, 1.0, -1.0), 0.0),
    "negative": lambda a, n: (-1.0,),
    "absolute": lambda a, n: (a.sign(),),
    "sin": lambda a, n: (a.cos(),),
    "cos": lambda a, n: (-a.sin(),),
    "tan": lambda a, n: (1.0 + n * n,),
    "arcsin": lambda a, n: (1.0 / ((1.0 - a) * (1.0 + a)).sqrt(),),
    "arccos": lambda a, n: (-1.0 / ((1.0 - a) * (1.0 + a)).sqrt(),),
    "arctan": lambda a, n: (1.0 / (1.0 + a * a),),
    "sinh": lambda a, n: (a.cosh(),),
    "cosh": lambda a, n: (a.sinh(),),
    "tanh": lambda a, n: ((1.0 / a.cosh()) ** 2.0,),
    "arcsinh": lambda a, n: (1.0 / a.hypot(1.0),),
    "arccosh": lambda a, n: (1.0 / ((a - 1.0).sqrt() * (a + 1.0).sqrt()),),
    "arctanh": lambda a, n: (1.0 / ((1.0 - a) * (1.0 + a)),),
    "exp": lambda a, n: (n,),
    "exp2": lambda a, n: (n * _LN2,),
    "expm1": lambda a, n: (a.exp(),),
    "log": lambda a, n: (1.0 / a,),
    "log2": lambda a, n: (1.0 / _LN2 / a,),
    "log10": lambda a, n: (1.0 / _LN10 / a,),
    "log1p": lambda a, n: (1.0 / (1.0 + a),),
    "sqrt": lambda a, n: (0.5 / n,),
    "cbrt": lambda a, n: (1.0 / 3.0 / (n * n),),
}
