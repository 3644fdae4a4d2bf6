"""Functions of machine code that Python calls as its own: wrong arguments, memory, lifetimes."""

import gc
import pickle
import sys
import threading
import weakref

import numpy as np
import pytest

pytest.importorskip("llvmlite")

from pgm.kernels.machine.emitter.arrays import are_known as arrays_are_known
from pgm.kernels.machine.emitter.arrays import floats, shown
from pgm.kernels.machine.emitter.module import Module
from pgm.kernels.machine.emitter.python import bound, place_of_slot, written


def made():
    """Machine code that sums the array of a dict, beside the key it is bound to, and a bytes."""

    def write(python):
        code = python.code
        start = code.memory(python.bytes(python.given[0], 8)).load(0)
        ((key, value),) = python.items(python.given[1], 1)
        python.give_none_unless(python.is_same(key, python.mine(0)))
        address, (count,) = floats(python, value, python.mine(1), 1)
        cells, total = code.memory(address), code.variable(start)
        with code.loop(count) as k:
            total.set(total.get() + cells.load(k))
        name = python.slot(python.mine(2), place_of_slot(Holder, "name"))
        python.give_none_unless(python.is_same(name, python.mine(3)))
        found = python.held(python.call("PyBytes_FromStringAndSize", python.null, 8))
        code.memory(python.memory_of(found)).store(0, total.get())
        code.give(python.passed(found))

    module = Module()
    written(module, "total", 2, write)
    return module.compile()


class Holder:
    """An object with slots."""

    __slots__ = ("array", "name")

    def __init__(self, name):
        self.name = name


@pytest.fixture(scope="module")
def machine():
    return made()


KEY, NAME = object(), "a name"


def function(machine, holder=None):
    holder = holder or Holder(NAME)
    return bound(machine, "total", (KEY, np.ndarray, holder, NAME))


def value(found):
    return np.frombuffer(found).item()


START = np.array([1.0]).tobytes()


def test_arrays_are_read(machine):
    total = function(machine)
    unpickled = pickle.loads(pickle.dumps(np.arange(5.0)))
    assert value(total(START, {KEY: unpickled})) == 11.0  # which has a dtype of its own
    assert value(total(START, {KEY: np.arange(5.0)})) == 11.0
    assert value(total(START, {KEY: np.empty(0)})) == 1.0


OTHERS = {
    "another key": {object(): np.ones(2)},
    "two": {KEY: np.ones(2), 1: 2},
    "none": {},
    "no dict": [np.ones(2)],
    "nothing": None,
    "a number": {KEY: 1.0},
    "a list": {KEY: [1.0]},
    "bytes": {KEY: bytes(16)},
    "a memoryview": {KEY: memoryview(np.ones(2))},
    "whole numbers": {KEY: np.ones(2, dtype=int)},
    "single precision": {KEY: np.ones(2, dtype=np.float32)},
    "other bytes": {KEY: np.ones(2, dtype=">f8")},
    "complex": {KEY: np.ones(2, dtype=complex)},
    "objects": {KEY: np.array([1.0, None], dtype=object)},
    "dates": {KEY: np.array(["2020-01-01"], dtype="datetime64[D]")},
    "records": {KEY: np.zeros(2, dtype=[("a", float)])},
    "not aligned": {KEY: np.frombuffer(bytes(17), np.int8)[1:].view(float)},
    "strided": {KEY: np.ones(4)[::2]},
    "two axes": {KEY: np.ones((1, 2))},
    "no axis": {KEY: np.array(1.0)},
}


@pytest.mark.parametrize("given", OTHERS.values(), ids=OTHERS)
def test_other_arguments_are_told(machine, given):
    assert function(machine)(START, given) is None


@pytest.mark.parametrize("arguments", [(), (START,), (START, {}, 1)])
def test_another_number_of_arguments_is_an_error(machine, arguments):
    with pytest.raises(TypeError, match="another number of arguments"):
        function(machine)(*arguments)
    with pytest.raises(TypeError):
        function(machine)(*arguments[:1], given={})


@pytest.mark.parametrize(("start", "error"), [(None, TypeError), (np.ones(1), TypeError)])
def test_what_is_no_bytes_is_an_error(machine, start, error):
    with pytest.raises(error):
        function(machine)(start, {KEY: np.ones(2)})


@pytest.mark.parametrize("size", [0, 7])
def test_bytes_of_a_smaller_size_are_an_error(machine, size):
    with pytest.raises(ValueError, match="more bytes"):
        function(machine)(bytes(size), {KEY: np.ones(2)})


def test_an_empty_slot_has_nothing(machine):
    holder = Holder(NAME)
    total = function(machine, holder)
    del holder.name
    assert total(START, {KEY: np.ones(2)}) is None


def test_an_attribute_without_a_slot_has_no_place():
    with pytest.raises(AttributeError):
        place_of_slot(Holder, "other")
    assert arrays_are_known()


@pytest.fixture(scope="module")
def holders():
    """Machine code that makes a holder of an array (2, 3), which shows what a bytes object has."""

    def write(python):
        (numbers,) = python.given
        kinds = python.mine(0), python.mine(1)
        found = python.new(python.mine(2))
        array = shown(python, kinds, (2, 3), python.bytes(numbers, 48), numbers)
        python.fill(found, place_of_slot(Holder, "array"), python.passed(array))
        python.code.give(python.passed(found))

    module = Module()
    written(module, "holder", 1, write)
    return bound(module.compile(), "holder", (np.ndarray, np.dtype(float), Holder))


@pytest.fixture
def uncollected():
    """No garbage of others is collected meanwhile, which would lower counts of what it held."""
    gc.collect()
    gc.disable()
    yield
    gc.enable()


@pytest.mark.usefixtures("uncollected")
def test_objects_are_made_of_arrays_that_are_read_only(holders):
    numbers = np.arange(6.0).tobytes()
    before = sys.getrefcount(numbers), sys.getrefcount(np.dtype(float))
    found = holders(numbers)
    assert type(found) is Holder
    assert not hasattr(found, "name")
    due = np.frombuffer(numbers).reshape(2, 3)
    np.testing.assert_array_equal(found.array, due)
    assert found.array.flags == due.flags
    with pytest.raises(ValueError, match="read-only"):
        found.array[0, 0] = 1.0
    with pytest.raises(ValueError, match="WRITEABLE"):
        found.array.flags.writeable = True
    array = found.array
    del found, due
    assert array.base is numbers
    del array
    for _ in range(100):
        with pytest.raises(ValueError, match="more bytes"):
            holders(bytes(40))
        with pytest.raises(TypeError):
            holders(1)
        holders(numbers)
    assert sys.getrefcount(numbers) == before[0]
    # A leak would hold it a hundred times.
    assert abs(sys.getrefcount(np.dtype(float)) - before[1]) < 50


@pytest.mark.usefixtures("uncollected")
def test_nothing_is_held_on_to(machine):
    total, holder, array = function(machine), Holder("another"), np.ones(3)
    other, given = function(machine, holder), {KEY: array}
    before = sys.getrefcount(array), sys.getrefcount(holder.name), sys.getrefcount(None)
    for _ in range(1000):
        total(START, given)
        assert other(START, given) is None
        assert total(START, {KEY: array, 1: 2}) is None
        assert total(START, {KEY: array[:, None]}) is None
        with pytest.raises(TypeError):
            total(None, given)
    after = sys.getrefcount(array), sys.getrefcount(holder.name), sys.getrefcount(None)
    assert before[:2] == after[:2]
    assert abs(before[2] - after[2]) < 100


def test_a_function_keeps_its_machine_code():
    machine = made()
    alive, total = weakref.ref(machine), function(machine)
    del machine
    gc.collect()
    assert alive() is not None
    assert value(total(START, {KEY: np.ones(2)})) == 3.0
    del total
    gc.collect()
    assert alive() is None


@pytest.mark.slow
def test_garbage_is_collected_between_and_within_calls():
    def work():
        for k in range(30):
            total = function(made())
            for j in range(200):
                given = {KEY: np.full(j, 1.0)}
                given["itself"] = [given]
                del given["itself"]
                assert value(total(START, given)) == 1.0 + j
            if k % 5 == 0:
                gc.collect()

    before = gc.get_threshold()
    gc.set_threshold(3, 2, 2)
    try:
        threads = [threading.Thread(target=work) for _ in range(3)]
        for each in threads:
            each.start()
        for each in threads:
            each.join()
    finally:
        gc.set_threshold(*before)
