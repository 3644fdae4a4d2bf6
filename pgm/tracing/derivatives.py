"""Forward-mode derivatives of graphs, sparse: what is known to be zero is not computed."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence

from pgm.tracing.graph import Graph
from pgm.tracing.operations import BOOLEAN

# By input component: the number of a derivative. One that is not there is zero.
Row = dict[int, int]

# Derivatives are zero wherever there are any.
_STEPS = {*BOOLEAN, "sign", "floor", "ceil", "trunc", "rint", "floor_divide"}


def derivatives(graph: Graph, outputs: Sequence[int], inputs: Sequence[int]) -> list[Row]:
    """The derivatives of outputs by inputs, recorded in their graph.

    `where` chooses between the derivatives of its two values, so that one of them that is
    infinite or NaN does no harm where the other is chosen. At a kink they are the mean of those on
    both sides, as central differences have it: 0 of |a| at 0, half of each of a maximum of
    equals. The derivative of a step is zero.

    Parameters
    ----------
    graph : Graph
    outputs, inputs : sequence of int
        Numbers of operations.

    Returns
    -------
    list of dict
        Of each output: by the places of inputs, numbers of operations; zeros are left out.
    """
    needed = reachable(graph, outputs)
    rows: dict[int, Row] = {}
    for column, number in enumerate(inputs):
        rows.setdefault(number, {})[column] = graph.constant(1.0)
    rule = _Rules(graph)
    for number in needed:
        name, *operands = graph.operations[number]
        if name in ("constant", "input") or name in _STEPS:
            continue
        parts = [rows.get(k, {}) for k in operands]
        columns = sorted(set().union(*parts[1:] if name == "where" else parts))
        if columns:
            row = rule.row(number, name, operands, parts, columns)
            rows[number] = {j: k for j, k in row.items() if graph.value(k) != 0.0}
    return [rows.get(number, {}) for number in outputs]


def reachable(graph: Graph, outputs: Iterable[int]) -> list[int]:
    """The operations that outputs are made of, in order."""
    needed: set[int] = set()
    stack = list(outputs)
    while stack:
        number = stack.pop()
        if number not in needed:
            needed.add(number)
            name, *operands = graph.operations[number]
            if name not in ("constant", "input"):
                stack += operands
    return sorted(needed)


class _Rules:
    """The derivatives of single operations."""

    def __init__(self, graph: Graph) -> None:
        self.graph = graph

    def row(
        self, number: int, name: str, operands: list[int], parts: list[Row], columns: list[int]
    ) -> Row:
        g = self.graph
        if name in ("where", "maximum", "minimum"):
            zero = g.constant(0.0)
            *_, first, last = parts
            pairs = {j: (first.get(j, zero), last.get(j, zero)) for j in columns}
            if name == "where":
                return {j: g.add("where", operands[0], *pair) for j, pair in pairs.items()}
            return {j: self._extreme(name, operands, *pair) for j, pair in pairs.items()}
        if name == "divide" and g.operations[operands[0]] == ("sin", operands[1]):
            slope = self._sinc_slope(operands[1], number)
            return {j: self._times(slope, parts[1][j]) for j in columns}
        partials: list[int | None] = [None, None]
        row: Row = {}
        for j in columns:
            for i, part in enumerate(parts):
                if j not in part:
                    continue
                partial = partials[i]
                if partial is None:
                    partial = partials[i] = self._partial(number, name, operands, i)
                term = self._times(partial, part[j])
                row[j] = g.add("add", row[j], term) if j in row else term
        return row

    def _times(self, partial: int, slope: int) -> int:
        g = self.graph
        return g.constant(0.0) if g.value(partial) == 0.0 else g.add("multiply", partial, slope)

    def _extreme(self, name: str, operands: list[int], a: int, b: int) -> int:
        g, (first, last) = self.graph, operands
        beyond = "greater" if name == "maximum" else "less"
        half = g.add("multiply", g.constant(0.5), g.add("add", a, b))
        otherwise = g.add("where", g.add(beyond, last, first), b, half)
        return g.add("where", g.add(beyond, first, last), a, otherwise)

    def _sinc_slope(self, a: int, sinc: int) -> int:
        """The derivative of sin a / a: its series below 1/4, where the quotient cancels."""
        add, c = self.graph.add, self.graph.constant
        square, series = add("multiply", a, a), c(1.0)
        for divisor in (88.0, 54.0, 28.0, 10.0):
            part = add("divide", square, c(divisor))
            series = add("subtract", c(1.0), add("multiply", part, series))
        series = add("multiply", add("divide", a, c(-3.0)), series)
        quotient = add("divide", add("subtract", add("cos", a), sinc), a)
        return add("where", add("less", add("absolute", a), c(0.25)), series, quotient)

    def _partial(self, number: int, name: str, operands: list[int], i: int) -> int:
        """The derivative by operand i."""
        g, add, c = self.graph, self.graph.add, self.graph.constant
        a, b = operands[0], operands[-1]
        if len(operands) == 1:
            return _UNARY[name](g, a, number)
        if name == "add":
            return c(1.0)
        if name == "subtract":
            return c((1.0, -1.0)[i])
        if name == "multiply":
            return (b, a)[i]
        if name == "divide":
            inverse = add("divide", c(1.0), b)
            return inverse if i == 0 else add("negative", add("multiply", number, inverse))
        if name == "hypot":
            return add("divide", operands[i], number)
        if name == "arctan2":
            square = add("add", add("multiply", a, a), add("multiply", b, b))
            return add("divide", b if i == 0 else add("negative", a), square)
        if name == "power":
            if i == 0:
                less = add("power", a, add("subtract", b, c(1.0)))
                return add("multiply", b, less)
            log = add("multiply", number, add("log", a))
            return add("where", add("equal", number, c(0.0)), c(0.0), log)
        if name in ("remainder", "fmod"):
            whole = "floor" if name == "remainder" else "trunc"
            return c(1.0) if i == 0 else add("negative", add(whole, add("divide", a, b)))
        assert name == "copysign"
        if i == 1:
            return c(0.0)
        return add("where", add("equal", a, number), c(1.0), c(-1.0))


def _over(g: Graph, above: float, below: int) -> int:
    return g.add("divide", g.constant(above), below)


def _one_and(g: Graph, name: str, a: int, b: int) -> int:
    return g.add(name, g.constant(1.0), g.add("multiply", a, b))


def _circle(g: Graph, a: int) -> int:
    """1 − a², without cancellation."""
    one = g.constant(1.0)
    return g.add("multiply", g.add("subtract", one, a), g.add("add", one, a))


def _arccosh(g: Graph, a: int) -> int:
    one = g.constant(1.0)
    both = [g.add("sqrt", g.add(name, a, one)) for name in ("subtract", "add")]
    return _over(g, 1.0, g.add("multiply", *both))


def _sech_square(g: Graph, a: int) -> int:
    sech = _over(g, 1.0, g.add("cosh", a))
    return g.add("multiply", sech, sech)


_LN2, _LN10 = math.log(2.0), math.log(10.0)
# Of the graph, the operand and the operation itself.
_UNARY: dict[str, Callable[[Graph, int, int], int]] = {
    "negative": lambda g, a, n: g.constant(-1.0),
    "absolute": lambda g, a, n: g.add("sign", a),
    "sin": lambda g, a, n: g.add("cos", a),
    "cos": lambda g, a, n: g.add("negative", g.add("sin", a)),
    "tan": lambda g, a, n: _one_and(g, "add", n, n),
    "arcsin": lambda g, a, n: _over(g, 1.0, g.add("sqrt", _circle(g, a))),
    "arccos": lambda g, a, n: _over(g, -1.0, g.add("sqrt", _circle(g, a))),
    "arctan": lambda g, a, n: _over(g, 1.0, _one_and(g, "add", a, a)),
    "sinh": lambda g, a, n: g.add("cosh", a),
    "cosh": lambda g, a, n: g.add("sinh", a),
    "tanh": lambda g, a, n: _sech_square(g, a),
    "arcsinh": lambda g, a, n: _over(g, 1.0, g.add("hypot", g.constant(1.0), a)),
    "arccosh": lambda g, a, n: _arccosh(g, a),
    "arctanh": lambda g, a, n: _over(g, 1.0, _circle(g, a)),
    "exp": lambda g, a, n: n,
    "exp2": lambda g, a, n: g.add("multiply", n, g.constant(_LN2)),
    "expm1": lambda g, a, n: g.add("exp", a),
    "log": lambda g, a, n: _over(g, 1.0, a),
    "log2": lambda g, a, n: _over(g, 1.0 / _LN2, a),
    "log10": lambda g, a, n: _over(g, 1.0 / _LN10, a),
    "log1p": lambda g, a, n: _over(g, 1.0, g.add("add", a, g.constant(1.0))),
    "sqrt": lambda g, a, n: _over(g, 0.5, n),
    "cbrt": lambda g, a, n: _over(g, 1.0 / 3.0, g.add("multiply", n, n)),
}
