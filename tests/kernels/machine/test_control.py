"""Loops, branches, variables and calls of machine code."""

import ctypes

import numpy as np
import pytest
from machine_code import WIDTHS, elementwise

from pgm.kernels.machine.emitter.kinds import ADDRESS, FLOAT, PACK, TRUTH, WHOLE
from pgm.kernels.machine.emitter.module import Module

PACKS = WIDTHS[1:]


def wholes(make, count):
    """The function of whole numbers that `make` writes."""
    module = Module()
    code = module.function("f", [WHOLE] * count, WHOLE)
    make(code, *code.arguments)
    return module.compile().callable("f")


@pytest.mark.parametrize(("first", "count"), [(0, 5), (2, 5), (0, 0), (3, -2), (4, 4)])
@pytest.mark.parametrize("down", [False, True])
def test_a_loop_runs_for_each_number(first, count, down):
    def make(code, first, count):
        digits = code.variable(code.whole(0))
        with code.loop(count, first, down=down) as index:
            digits.set(digits.get() * 10 + index)
        code.give(digits.get())

    each = list(range(first, count))[:: -1 if down else 1]
    assert wholes(make, 2)(first, count) == int("0" + "".join(map(str, each)))


def test_loops_inside_loops():
    def make(code, rows, columns):
        total = code.variable(code.whole(0))
        with code.loop(rows) as row, code.loop(columns, row) as column:
            total.set(total.get() + row * 10 + column)
        code.give(total.get())

    due = sum(row * 10 + column for row in range(4) for column in range(row, 6))
    assert wholes(make, 2)(4, 6) == due


def test_a_loop_ends_early():
    def make(code, limit, bound):
        power, steps = code.variable(code.whole(1)), code.variable(code.whole(0))
        with code.loop(limit):
            code.leave_when(power.get() > bound)
            power.set(power.get() * 2)
            steps.set(steps.get() + 1)
        code.give(power.get() * 100 + steps.get())

    function = wholes(make, 2)
    assert function(50, 30) == 3205
    assert function(3, 30) == 803


def test_leaving_ends_the_innermost_loop_alone():
    def make(code, rows):
        total = code.variable(code.whole(0))
        with code.loop(rows), code.loop(10) as column:
            with code.when(column == 3):
                code.leave()
            total.set(total.get() + 1)
        code.give(total.get())

    assert wholes(make, 1)(4) == 12


def test_leaving_outside_of_a_loop_is_refused():
    with pytest.raises(ValueError, match="outside of one"):
        Module().function("f", []).leave()


@pytest.mark.parametrize("lanes", PACKS)
def test_a_pack_iterates_until_every_lane_is_settled(lanes):
    def make(code, x):
        root, steps = code.variable(x), code.varying(0.0)
        with code.loop(60):
            old = root.get()
            new = (old + x / old) * 0.5
            moving = abs(new - old) > 1e-9 * new
            code.leave_unless(code.some(moving))
            root.set(moving.where(new, old))
            steps.set(steps.get() + moving.where(1.0, 0.0))
        return root.get() + 1000.0 * steps.get()

    x = np.array([1.0, 2.0, 9.0, 1e4, 3.0, 1e-3, 7.0, 0.5])
    found = elementwise(make, 1, lanes)(x)
    alone = elementwise(make, 1, 1)(x)
    np.testing.assert_allclose(found, alone, rtol=1e-14)
    np.testing.assert_allclose(np.mod(found, 1000.0), np.sqrt(x), rtol=1e-8)


def test_branches():
    def make(code, x):
        found = code.variable(code.whole(0))
        with code.when(x > 10):
            found.set(1)
        with code.otherwise():
            with code.when(x < 0):
                found.set(2)
            with code.otherwise():
                found.set(3)
        with code.when(x == 5):
            found.set(found.get() + 10)
        code.give(found.get())

    function = wholes(make, 1)
    assert [function(x) for x in (11, -1, 0, 5)] == [1, 2, 3, 13]


def test_otherwise_follows_when():
    code = Module().function("f", [WHOLE])
    with code.when(code.arguments[0] > 0):
        pass
    code.variable(code.whole(0))
    with pytest.raises(ValueError, match="right after"), code.otherwise():
        pass


def test_giving_early_ends_the_function():
    def make(code, x):
        with code.loop(100) as index, code.when(index * index >= x):
            code.give(index)
        code.give(-1)

    function = wholes(make, 1)
    assert [function(x) for x in (10, 16, 10**6)] == [4, 4, -1]


def test_a_function_that_is_to_give_a_value_gives_one():
    module = Module()
    module.function("f", [], FLOAT)
    with pytest.raises(ValueError, match="gives none"):
        module.compile()


@pytest.mark.parametrize("lanes", WIDTHS)
def test_lanes_together(lanes):
    def make(code, x):
        some = code.some(x > 0.0).where(1.0, 0.0)
        every = code.every(x > 0.0).where(2.0, 0.0)
        return (some + every + code.bits(x > 0.0).number() * 10.0).spread(lanes)

    x = np.array([1.0, -1.0, -1.0, 2.0, 3.0, 4.0, 5.0, 6.0, -1, -1, -1, -1, -1, -1, -1, -1])
    positive = x.reshape(-1, lanes) > 0.0
    bits = positive @ 2.0 ** np.arange(lanes)
    due = positive.any(axis=1) + 2.0 * positive.all(axis=1) + 10.0 * bits
    np.testing.assert_array_equal(elementwise(make, 1, lanes)(x), np.repeat(due, lanes))


@pytest.mark.parametrize("lanes", PACKS)
def test_lanes_one_by_one(lanes):
    def make(_, x):
        return x.with_lane(1, x.lane(0) + 0.5)

    x = np.arange(16.0)
    due = x.reshape(-1, lanes).copy()
    due[:, 1] = due[:, 0] + 0.5
    np.testing.assert_array_equal(elementwise(make, 1, lanes)(x), due.ravel())


@pytest.mark.parametrize("inline", [None, True, False])
@pytest.mark.parametrize("lanes", WIDTHS)
def test_internal_functions(lanes, inline):
    module = Module(contract=False)
    affine = module.function(
        "affine", [PACK, FLOAT, TRUTH], PACK, lanes=lanes, internal=True, inline=inline
    )
    x, factor, more = affine.arguments
    room = affine.room(2)
    with affine.loop(2) as index:
        room.store(index, x * factor + more.where(1.0, 0.0))
    affine.give(room.load(1))
    code = module.function("f", [ADDRESS, ADDRESS, FLOAT], lanes=lanes)
    given, out, factor = code.arguments
    x = code.memory(given).load(0)
    code.memory(out).store(0, code.call(affine, x, factor, True))
    points, found = np.arange(8.0), np.zeros(8)
    module.compile().callable("f")(points.ctypes.data, found.ctypes.data, 3.0)
    np.testing.assert_array_equal(found[:lanes], points[:lanes] * 3.0 + 1.0)


def test_functions_call_by_address():
    module = Module()
    twice = module.function("twice", [FLOAT, WHOLE], FLOAT)
    x, count = twice.arguments
    twice.give(x * 2.0 + count.number())
    machine = module.compile()
    other = Module()
    for known in (True, False):
        code = other.function(f"known {known}", [ADDRESS], FLOAT)
        place = code.address(machine.address("twice")) if known else code.arguments[0]
        code.give(code.call_at(place, code.constant(4.0), code.whole(3), result=FLOAT))
    functions = other.compile()
    for known in (True, False):
        assert functions.callable(f"known {known}")(machine.address("twice")) == 11.0


def test_functions_of_python_are_called_back():
    seen = []

    def told(x, y):
        seen.append((x, y))
        return x < y

    back = ctypes.CFUNCTYPE(ctypes.c_bool, ctypes.c_double, ctypes.c_double)(told)
    module = Module()
    code = module.function("f", [ADDRESS, FLOAT], FLOAT)
    place, x = code.arguments
    found = code.call_at(place, x, code.constant(2.0), result=TRUTH)
    code.give(found.where(10.0, 20.0))
    function = module.compile().callable("f")
    address = ctypes.cast(back, ctypes.c_void_p).value
    assert [function(address, x) for x in (1.0, 3.0)] == [10.0, 20.0]
    assert seen == [(1.0, 2.0), (3.0, 2.0)]


def test_addresses_and_truths_are_given_and_taken():
    module = Module()
    code = module.function("next", [ADDRESS, WHOLE], ADDRESS)
    code.give(code.arguments[0] + code.arguments[1])
    code = module.function("both", [TRUTH, FLOAT], TRUTH)
    code.give(code.arguments[0] & (code.arguments[1] > 0.0))
    machine = module.compile()
    assert machine.callable("next")(1024, 3) == 1048
    both = machine.callable("both")
    assert [both(True, 1.0), both(True, -1.0), both(False, 1.0)] == [True, False, False]


@pytest.mark.parametrize("wrong", [1.5, True])
def test_a_wrong_argument_is_refused_as_code_is_written(wrong):
    module = Module()
    inner = module.function("inner", [ADDRESS], internal=True)
    outer = module.function("outer", [])
    with pytest.raises(TypeError, match="outer: the value must be of kind address"):
        outer.call(inner, wrong)


def test_packs_stay_inside_the_module():
    with pytest.raises(ValueError, match="only an internal function"):
        Module().function("f", [PACK], lanes=8)


@pytest.mark.parametrize("lanes", PACKS)
def test_variables_of_one_lane_stand_beside_packs(lanes):
    def make(code, x):
        factor = code.variable(x.lane(0))
        with code.loop(3):
            factor.set(factor.get() + 1.0)
        return factor.get() * x

    x = np.arange(16.0)
    due = x * np.repeat(x[::lanes] + 3.0, lanes)
    np.testing.assert_array_equal(elementwise(make, 1, lanes)(x), due)


def test_variables_of_truths():
    def make(code, x):
        found = code.varying(False)
        with code.loop(3) as index:
            found.set(found.get() | (x == index.number()))
        return found.get().where(1.0, 0.0)

    x = np.arange(8.0)
    for lanes in WIDTHS:
        np.testing.assert_array_equal(elementwise(make, 1, lanes)(x), x < 3.0)


def test_a_fraction_is_no_whole_number():
    with pytest.raises(TypeError, match="integer"):
        Module().function("f", []).whole(1.5)


def test_whole_numbers():
    def make(code, x, y):
        folded = (x * 3 - y + 1) // 2 % 100 - (2 - y)
        code.give(folded + (y.number() / 2.0).whole())

    assert wholes(make, 2)(20, 5) == (20 * 3 - 5 + 1) // 2 % 100 - (2 - 5) + 2


@pytest.mark.parametrize(
    ("x", "due"), [(2.9, 2), (-2.9, -2), (1e30, 2**63 - 1), (-np.inf, -(2**63)), (np.nan, 0)]
)
def test_a_float_as_a_whole_number(x, due):
    module = Module()
    code = module.function("f", [FLOAT], WHOLE)
    code.give(code.arguments[0].whole())
    assert module.compile().callable("f")(x) == due


def test_names_are_given_once():
    module = Module()
    module.function("f", [])
    with pytest.raises(ValueError, match="already"):
        module.function("f", [])
