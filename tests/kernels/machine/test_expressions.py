"""Drawn expressions of arithmetic in machine code are NumPy's to the last bit."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from machine_code import apart, elementwise

from pgm.kernels.machine.emitter.kinds import ADDRESS
from pgm.kernels.machine.emitter.module import Module
from pgm.kernels.machine.emitter.traces import written
from pgm.tracing.graph import Graph

pytestmark = pytest.mark.filterwarnings("ignore::RuntimeWarning")

TWO = ["add", "subtract", "multiply", "divide", "minimum", "maximum", "copysign", "remainder"]
ONE = ["negative", "absolute", "floor", "rint", "sqrt", "sign"]
FLOATS = st.floats(allow_nan=True, allow_infinity=True)
LEAVES = st.sampled_from(["x", "y", "z"]) | FLOATS
TREES = st.recursive(
    LEAVES,
    lambda inner: st.one_of(
        st.tuples(st.sampled_from(TWO), inner, inner),
        st.tuples(st.sampled_from(ONE), inner),
        st.tuples(st.just("where"), st.tuples(st.just("less"), inner, inner), inner, inner),
    ),
    max_leaves=25,
)


def evaluated(tree, values, apply, known):
    """The value of a tree, by a way to apply operations."""
    if isinstance(tree, str):
        return values[tree]
    if isinstance(tree, float):
        return known(tree)
    name, *inner = tree
    return apply(name, *(evaluated(each, values, apply, known) for each in inner))


def numpys(tree, values):
    return evaluated(tree, values, lambda name, *given: getattr(np, name)(*given), np.float64)


@given(TREES, st.sampled_from([1, 4, 8]), st.lists(FLOATS, min_size=24, max_size=24))
@settings(max_examples=60, deadline=None)
def test_an_expression(tree, lanes, points):
    values = dict(zip("xyz", np.array(points).reshape(3, 8), strict=True))

    def make(code, *numbers):
        own = dict(zip("xyz", numbers, strict=True))
        return evaluated(tree, own, lambda name, a, *b: a.apply(name, *b), code.constant)

    found = elementwise(make, 3, lanes, contract=False)(*values.values())
    assert apart(found, np.broadcast_to(numpys(tree, values), 8)).max() == 0


@given(TREES, st.sampled_from([1, 8]), st.lists(FLOATS, min_size=24, max_size=24))
@settings(max_examples=40, deadline=None)
def test_a_trace(tree, lanes, points):
    graph = Graph()
    values = dict(zip("xyz", np.array(points).reshape(3, 8), strict=True))
    places = {name: graph.input(0, k) for k, name in enumerate("xyz")}
    output = evaluated(tree, places, graph.add, graph.constant)

    def make(code, *numbers):
        (found,) = written(code, graph, [output], lambda _, component: numbers[component])
        return code.constant(found) if isinstance(found, float) else found

    found = elementwise(make, 3, lanes, contract=False)(*values.values())
    assert apart(found, np.broadcast_to(numpys(tree, values), 8)).max() == 0


def test_constants_of_a_trace_come_back_as_floats():
    graph = Graph()
    outputs = [graph.constant(0.0), graph.input(0, 0), graph.constant(True)]
    code = Module().function("f", [ADDRESS])
    x = code.memory(code.arguments[0]).load(0)
    assert written(code, graph, outputs, lambda *_: x) == [0.0, x, True]
