"""Numbers and other values of machine code in memory, and the mode that checks their places."""

import numpy as np
import pytest
from machine_code import WIDTHS

from pgm.kernels.machine.emitter.kinds import ADDRESS, FLOAT, WHOLE
from pgm.kernels.machine.emitter.memory import Runs
from pgm.kernels.machine.emitter.module import Module

PACKS = WIDTHS[1:]


def built(write, arguments, lanes=1, result=None, checked=True):
    """The function that `write` writes, checked."""
    module = Module(checked=checked)
    code = module.function("moved", arguments, result, lanes=lanes)
    write(code, *code.arguments)
    function = module.compile().callable("moved")
    return lambda *given: function(
        *(each.ctypes.data if isinstance(each, np.ndarray) else each for each in given)
    )


@pytest.mark.parametrize("checked", [False, True])
@pytest.mark.parametrize("lanes", WIDTHS)
def test_runs_next_to_each_other(lanes, checked):
    """Arrays (components, runs): component k of the runs from the second on."""

    def write(code, x, y, runs, count):
        source = code.memory(x + 1, step=runs, length=count)
        target = code.memory(y + 1, step=runs, length=count)
        with code.loop(count) as index:
            target.store(index, source.load(index) * 2.0)

    source, target = np.arange(50.0).reshape(5, 10), np.zeros((5, 10))
    built(write, [ADDRESS, ADDRESS, WHOLE, WHOLE], lanes, checked=checked)(source, target, 10, 5)
    due = np.zeros((5, 10))
    due[:, 1 : 1 + lanes] = 2.0 * source[:, 1 : 1 + lanes]
    np.testing.assert_array_equal(target, due)


@pytest.mark.parametrize("lanes", WIDTHS)
def test_one_number_for_all_runs(lanes):
    def write(code, x, y):
        same = code.memory(x, runs=Runs.SAME, length=3)
        code.memory(y).store(0, same.load(2) + same.moved(1, 2).load(0))

    target = np.zeros(8)
    built(write, [ADDRESS, ADDRESS], lanes)(np.array([1.0, 20.0, 300.0]), target)
    np.testing.assert_array_equal(target, 320.0 * (np.arange(8) < lanes))


@pytest.mark.parametrize("lanes", PACKS)
def test_one_number_for_all_runs_is_only_read(lanes):
    code = Module().function("f", [ADDRESS], lanes=lanes)
    with pytest.raises(TypeError, match="only read"):
        code.memory(code.arguments[0], runs=Runs.SAME, name="gain").store(0, 1.0)


@pytest.mark.parametrize("known", [True, False])
@pytest.mark.parametrize("lanes", WIDTHS)
def test_runs_at_a_distance(lanes, known):
    """Arrays (runs, components)."""

    def write(code, x, y, distance):
        apart = 5 if known else distance
        source = code.memory(x, runs=Runs.APART, apart=apart, length=5)
        target = code.memory(y, runs=Runs.APART, apart=apart, length=5)
        with code.loop(4) as index:
            target.store(index + 1, source.load(index) + 0.5)

    source, target = np.arange(40.0).reshape(8, 5), np.zeros((8, 5))
    built(write, [ADDRESS, ADDRESS, WHOLE], lanes)(source, target, 5)
    due = np.zeros((8, 5))
    due[:lanes, 1:] = source[:lanes, :4] + 0.5
    np.testing.assert_array_equal(target, due)


@pytest.mark.parametrize("lanes", WIDTHS)
def test_room_is_taken_once_however_often_code_runs(lanes):
    def write(code, y, count):
        total = code.varying(0.0)
        with code.loop(count) as index:
            room = code.room(1000)
            room.store(index % 1000, 1.0)
            total.set(total.get() + room.load(index % 1000))
        code.memory(y).store(0, total.get())

    target = np.zeros(8)
    built(write, [ADDRESS, WHOLE], lanes)(target, 10_000)  # 80 MB, were it taken each time
    np.testing.assert_array_equal(target[:lanes], 10_000.0)


def test_wholes_truths_and_addresses():
    def write(code, rows, kept, table, out):
        places, mask = code.wholes(rows, 3), code.truths(kept, 3)
        total = code.varying(0.0)
        with code.loop(3) as index:
            row = code.memory(code.addresses(table, 2).load(places.load(index)), length=1)
            with code.when(mask.load(index)):
                total.set(total.get() * 10.0 + row.load(0))
        places.store(1, places.load(0) + 7)
        mask.store(1, total.get() > 0.0)
        addresses = code.addresses(table, 2)
        addresses.store(0, addresses.load(1))
        code.memory(out).store(0, total.get())
        code.memory(out).store(1, addresses.load(1).is_null().where(1.0, 2.0))

    first, second, out = np.array([3.0]), np.array([4.0]), np.zeros(2)
    rows, kept = np.array([1, 0, 0]), np.array([True, False, True])
    table = np.array([first.ctypes.data, second.ctypes.data])
    built(write, [ADDRESS] * 4)(rows, kept, table, out)
    np.testing.assert_array_equal(out, [43.0, 2.0])
    np.testing.assert_array_equal(rows, [1, 8, 0])
    np.testing.assert_array_equal(kept, [True, True, True])
    assert table[0] == table[1]


@pytest.mark.parametrize("lanes", [1, 8])
@pytest.mark.parametrize("index", [-1, 5, 2**40])
@pytest.mark.parametrize("what", ["load", "store"])
def test_an_index_outside_is_told(lanes, index, what):
    def write(code, x, index):
        mean = code.memory(x, length=5, name="mean")
        if what == "load":
            mean.store(0, mean.load(index))
        else:
            mean.store(index, 1.0)

    function = built(write, [ADDRESS, WHOLE], lanes)
    room = np.zeros(40)
    with pytest.raises(IndexError, match=rf"moved: {what} in mean: index {index} .* its 5"):
        function(room, index)
    function(room, 4)  # once told, a fault is over


@pytest.mark.parametrize("kind", ["wholes", "truths", "addresses"])
def test_an_index_outside_of_other_values_is_told(kind):
    def write(code, x, index):
        getattr(code, kind)(x, 3, "parents").load(index)

    function = built(write, [ADDRESS, WHOLE])
    with pytest.raises(IndexError, match="load in parents: index 3"):
        function(np.zeros(3), 3)


@pytest.mark.parametrize("lanes", PACKS)
def test_a_misaligned_pack_is_told(lanes):
    def write(code, x):
        code.memory(x, alignment=8 * lanes, name="cov").store(0, 1.0)

    function = built(write, [ADDRESS], lanes)
    room = np.zeros(64)
    aligned = room.ctypes.data + -room.ctypes.data % 64
    function(aligned)
    with pytest.raises(
        IndexError, match=rf"store in cov: address \d+ is no multiple of {8 * lanes}"
    ):
        function(aligned + 8)


def test_a_misaligned_float_is_told():
    function = built(lambda code, x: code.give(code.memory(x).load(0)), [ADDRESS], result=FLOAT)
    with pytest.raises(IndexError, match="no multiple of 8"):
        function(np.zeros(2).ctypes.data + 4)


def test_a_fault_inside_a_called_function_is_told():
    module = Module(checked=True)
    inner = module.function("inner", [ADDRESS, WHOLE], internal=True, inline=False)
    inner.memory(inner.arguments[0], length=2, name="gain").store(inner.arguments[1], 1.0)
    outer = module.function("outer", [ADDRESS])
    outer.call(inner, outer.arguments[0], 2)
    room = np.zeros(4)
    with pytest.raises(IndexError, match="inner: store in gain: index 2"):
        module.compile().callable("outer")(room.ctypes.data)
    assert not room.any()
