"""Functions printed for NVIDIA's cards, without one: interpreted, against NumPy, and assembled."""

import numpy as np
import pytest
from card import CAPABILITIES, assembled, needs_libdevice
from machine_code import apart
from ptx import Program

from pgm.kernels.machine.emitter import card
from pgm.kernels.machine.emitter.card import Card, printed, thread
from pgm.kernels.machine.emitter.kinds import ADDRESS, WHOLE
from pgm.kernels.machine.emitter.module import Module
from pgm.kernels.machine.sweeps import lying
from pgm.kernels.machine.sweeps.card import kernel
from pgm.kernels.machine.sweeps.told import Array, Forward
from pgm.tracing.operations import BOOLEAN, SCALAR

needs_libdevice()

EXACT = BOOLEAN | {"floor", "ceil", "trunc", "rint", "minimum", "maximum", "where", "sign"}
EXACT |= {"negative", "absolute", "copysign", "sqrt", "add", "subtract", "multiply", "divide"}
EXACT |= {"fmod", "remainder", "floor_divide"}
TRUTHS = {"logical_and", "logical_or", "logical_not"}
TINY, HUGE = [5e-324, 2.2250738585072014e-308, 1e-160, 1e-9], [1e5, 1e22, 1e150, 1e300, np.inf]
POSITIVE = [0.0, 0.25, 0.5, 1.0, 1.5, 2.0, 2.5, 710.0, 745.2, 2.0**52 + 0.5, np.pi, 1e6 * np.pi]
POSITIVE = np.array([*POSITIVE, *TINY, *HUGE])
SPECIAL = np.concatenate([POSITIVE, -POSITIVE, [np.nan]])
PAIRS = np.stack(np.meshgrid(SPECIAL, SPECIAL), axis=-1).reshape(-1, 2).T


def points(count):
    """Arguments in all corners of float64, and others of all sizes and signs."""
    rng = np.random.default_rng(count)
    drawn = [rng.normal(0, 30, (count, 100)), np.exp(rng.uniform(-700, 700, (count, 100)))]
    drawn = np.concatenate(drawn, axis=1) * rng.choice([-1.0, 1.0], (count, 200))
    special = [SPECIAL] if count == 1 else [*PAIRS, PAIRS[0]][:count]
    return [np.concatenate(both) for both in zip(special, drawn, strict=True)]


def written(make, count, capability=(8, 0)):
    """The kernel as PTX that applies what `make` writes to each of many points."""
    module = Module(contract=False, target=Card(capability))
    code = module.function("each", [ADDRESS] * (count + 1) + [WHOLE])
    *given, out, length = code.arguments
    here = thread(code)
    with code.when(here < length):
        numbers = [code.memory(each).load(here) for each in given]
        code.memory(out).store(here, make(code, *numbers))
    return printed(module, ["each"])


def operation(name):
    def make(_, first, *others):
        return (first > 0.0 if name == "where" else first).apply(name, *others)

    return make, 3 if name == "where" else getattr(np, name).nin


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize("name", SCALAR)
def test_an_operation_is_numpys(name):
    make, count = operation(name)
    given = points(count)
    out = np.full(len(given[0]), 12345.0)
    regions = [(each.ctypes.data, each.ctypes.data + each.nbytes) for each in (*given, out)]
    places = [each.ctypes.data for each in (*given, out)]
    Program(written(make, count), regions).launch(
        "pgm_each", [*places, len(out)], len(out) // 200 + 1, 200
    )
    as_given = [each != 0.0 for each in given] if name in TRUTHS else list(given)
    if name == "where":
        as_given[0] = given[0] > 0.0
    units = apart(out, np.broadcast_to(getattr(np, name)(*as_given), out.shape))
    worst = int(units.argmax())
    assert units.max() <= (0 if name in EXACT else 4), (name, [each[worst] for each in given])


@pytest.mark.parametrize("capability", CAPABILITIES)
def test_all_operations_assemble(capability, tmp_path):
    def make(code, *numbers):
        found = code.constant(0.0)
        for name in SCALAR:
            each, count = operation(name)
            found = found + each(code, *numbers[:count])
        return found

    text = written(make, 3, capability)
    assert f".target sm_{capability[0]}{capability[1]}" in text
    told, length = assembled(text, capability, tmp_path)
    assert not told
    assert length > 10_000  # of so many functions


def test_what_is_no_code_does_not_assemble(tmp_path):
    make, count = operation("sin")
    text = written(make, count).replace("mul.rn.f64", "mul.no.f64", 1)
    with pytest.raises(AssertionError, match=r"Unknown modifier '\.no'"):
        assembled(text, (8, 0), tmp_path)


def test_products_and_sums_are_rounded_apart_where_they_are_to_be():
    def make(_, a, b, c):
        return a * b + c

    assert "fma" not in written(make, 3)
    module = Module(target=Card((8, 0)))
    code = module.function("each", [ADDRESS])
    numbers = code.memory(code.arguments[0])
    numbers.store(3, make(code, *map(numbers.load, range(3))))
    assert "fma.rn.f64" in printed(module, ["each"])


def test_each_thread_of_all_blocks_has_a_number():
    module = Module(target=Card((7, 5)))
    code = module.function("each", [ADDRESS])
    here = thread(code)
    code.memory(code.arguments[0]).store(here, here.number())
    out = np.full(12, np.nan)
    Program(printed(module, ["each"])).launch("pgm_each", [out.ctypes.data], 3, 4)
    np.testing.assert_array_equal(out, np.arange(12.0))


def test_a_later_card_gets_code_for_the_newest_one_that_is_known():
    make, count = operation("add")
    assert ".target sm_90\n" in written(make, count, (12, 0))
    assert ".target sm_75\n" in written(make, count, (7, 9))


def test_cards_that_are_too_old_are_refused():
    with pytest.raises(ValueError, match=r"capability 7\.5 and later, not of 6\.1"):
        Card((6, 1))


def test_without_libdevice_it_is_said_how_to_install_it(monkeypatch):
    monkeypatch.setattr(card, "_LIBRARIES", ("nowhere.bc",))
    with pytest.raises(ImportError, match=r"libdevice.*pip install 'sepset\[gpu\]'"):
        written(*operation("sin"))
    assert "add.rn.f64" in written(*operation("add"))  # which takes none


@pytest.mark.parametrize("turned", [False, True])
def test_numbers_that_lie_on_a_card_are_looked_at_and_added_up(turned):
    numbers = np.random.default_rng(3).normal(size=(5, 4, 3))  # runs, rows, cells
    numbers[1, 2, 0] = np.nan
    numbers[2, 3, 2], numbers[3, 0, 1] = np.inf, -np.inf
    numbers[2, 3, 1] = np.nan
    lies = np.asfortranarray(numbers) if turned else numbers
    across, down, cell = (stride // 8 for stride in lies.strides)
    for name, due in (("look", [0.0, 1.0, 2.0, 2.0, 0.0]), ("add", numbers[..., 0].sum(axis=1))):
        out = np.full(6, 12345.0)
        given = lies.ctypes.data, down, across, cell, 4, 3 if name == "look" else 1
        program = Program(lying.kernel(name, (8, 0)))
        program.launch(f"pgm_{name}", [*given, out.ctypes.data, 5], 3, 2)
        np.testing.assert_allclose(out[:5], due, rtol=1e-15)
        assert out[5] == 12345.0


@pytest.mark.parametrize("name", ["look", "add"])
def test_what_looks_at_numbers_assembles(name, tmp_path):
    for capability in CAPABILITIES:
        told, _ = assembled(lying.kernel(name, capability), capability, tmp_path)
        assert not told


def test_functions_of_the_program_are_refused():
    cells = Array(0, (1,), None, True)
    chain = Forward(
        size=1,
        states=(0,),
        single=True,
        motions=(),
        sensors=(),
        begin=(cells, cells),
        predicted=(),
        known=(cells, cells),
        density=cells,
        iterated=False,
        asked=cells,
    )
    with pytest.raises(ValueError, match="have to be traced"):
        kernel(chain, (8, 0))
