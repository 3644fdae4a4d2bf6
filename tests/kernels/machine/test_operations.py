"""Every operation of traces in machine code against NumPy's, in every corner of float64."""

import numpy as np
import pytest
from machine_code import WIDTHS, apart, elementwise

from pgm.kernels.machine.emitter.operations import OPERATIONS
from pgm.tracing.operations import BATCH, BOOLEAN, SCALAR

TURNS = np.pi * np.array([0.25, 0.5, 0.75, 1.0, 1.5, 2.0, 3.0, 100.5, 1e6])
NEAR = np.nextafter([1.0, 1.0, 0.5, 2.0**52], [0.0, 2.0, 0.0, 0.0])
WHOLE = [0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 20.0, 2.0**52 + 0.5, 2.0**53, 1e15, 1e22]
TINY = [5e-324, 1e-310, 2.2250738585072014e-308, 1e-300, 1e-160, 1e-20, 1e-9]
HUGE = [1e5, 1e8, 1e150, 1e155, 1e160, 1e300, 1.7976931348623157e308, np.inf]
# Where exp, sinh, exp2 and their like overflow, or lose their digits.
BOUNDS = [700.0, 708.5, 709.5, 709.8, 710.0, 711.0, 744.0, 745.2, 746.0, 1022.0, 1024.0, 1074.0]
POSITIVE = np.concatenate([WHOLE, TINY, HUGE, BOUNDS, TURNS, NEAR])
SPECIAL = np.concatenate([POSITIVE, -POSITIVE, [np.nan]])
PAIRS = np.stack(np.meshgrid(SPECIAL, SPECIAL), axis=-1).reshape(-1, 2).T

EXACT = BOOLEAN | {"floor", "ceil", "trunc", "rint", "minimum", "maximum", "where", "sign"}
EXACT |= {"negative", "absolute", "copysign", "sqrt", "add", "subtract", "multiply", "divide"}
EXACT |= {"fmod", "remainder", "floor_divide"}
TRUTHS = {"logical_and", "logical_or", "logical_not"}

pytestmark = pytest.mark.filterwarnings("ignore::RuntimeWarning")


def drawn(count):
    """Points of all sizes and signs."""
    rng = np.random.default_rng(count)
    sizes = [rng.normal(0, 1, 500), rng.normal(0, 30, 500), np.exp(rng.uniform(-20, 20, 500))]
    sizes += [np.exp(rng.uniform(-700, 700, 500)), np.exp(rng.uniform(-1e-3, 1e-3, 500))]
    points = np.concatenate(sizes)
    points *= rng.choice([-1.0, 1.0], points.shape)
    return [rng.permutation(points) for _ in range(count)]


def compared(name, count, lanes, points, **options):
    """Units in the last place between the machine's operation and NumPy's."""
    given = [each != 0.0 for each in points] if name in TRUTHS else list(points)
    if name == "where":
        given[0] = points[0] > 0.0
    due = np.broadcast_to(getattr(np, name)(*given), points[0].shape)

    def make(code, first, *others):
        return (first > 0.0 if name == "where" else first).apply(name, *others)

    return apart(elementwise(make, count, lanes, contract=False, **options)(*points), due)


def number_of_arguments(name):
    return 3 if name == "where" else getattr(np, name).nin


def test_every_operation_of_traces_is_known():
    assert set(OPERATIONS) == set(BATCH)


@pytest.mark.parametrize("lanes", WIDTHS)
@pytest.mark.parametrize("name", SCALAR)
def test_an_operation_is_numpys(name, lanes):
    count = number_of_arguments(name)
    special = [SPECIAL] if count == 1 else [*PAIRS, PAIRS[0]][:count]
    points = [np.concatenate(both) for both in zip(special, drawn(count), strict=True)]
    units = compared(name, count, lanes, points)
    worst = int(units.argmax())
    at = [each[worst] for each in points]
    assert units.max() <= (0 if name in EXACT else 4), (name, at, units[worst])


@pytest.mark.parametrize("level", [0, 1, 3])
@pytest.mark.parametrize("lanes", [1, 8])
def test_operations_are_the_same_at_other_levels(lanes, level):
    for name in SCALAR:
        points = drawn(number_of_arguments(name))
        units = compared(name, len(points), lanes, points, level=level)
        assert units.max() <= (0 if name in EXACT else 4), name


@pytest.mark.parametrize("lanes", WIDTHS)
@pytest.mark.parametrize("name", ["sin", "hypot", "remainder", "minimum"])
def test_a_float_is_beside_a_number(name, lanes):
    points = drawn(1)
    count = number_of_arguments(name)
    others = [0.75] * (count - 1)
    found = elementwise(lambda _, x: x.apply(name, *others), 1, lanes)(*points)
    assert apart(found, getattr(np, name)(*points, *others)).max() <= 4


@pytest.mark.parametrize("lanes", WIDTHS)
def test_operators_take_floats_on_either_side(lanes):
    def make(_, x):
        inside = (x > -1.0) & (x <= 1.5) | ~(x != 3.0)
        return inside.where(2.0 - x * 3.0, 1.0 / (0.5 + -x) + abs(x) * True)

    def due(x):
        inside = (x > -1.0) & (x <= 1.5) | ~(x != 3.0)
        return np.where(inside, 2.0 - x * 3.0, 1.0 / (0.5 + -x) + abs(x) * True)

    found = elementwise(make, 1, lanes, contract=False)(SPECIAL)
    assert apart(found, due(SPECIAL)).max() == 0


@pytest.mark.parametrize("lanes", WIDTHS)
def test_truths_are_numbers_in_arithmetic(lanes):
    found = elementwise(lambda _, x: (x > 0.0) + (x > 1.0) * 2.0, 1, lanes)(SPECIAL)
    np.testing.assert_array_equal(found, (SPECIAL > 0.0) + (SPECIAL > 1.0) * 2.0)


def test_products_and_sums_fuse_where_they_may():
    a, b = 1.0 + 2.0**-30, 1.0 - 2.0**-30
    fused = elementwise(lambda _, x, y: x * y - 1.0, 2, 1)([a], [b])
    apart_ = elementwise(lambda _, x, y: x * y - 1.0, 2, 1, contract=False)([a], [b])
    assert apart_ == 0.0
    assert fused in (0.0, -(2.0**-60))  # a processor without fused operations rounds twice


@pytest.mark.parametrize("lanes", WIDTHS)
def test_a_product_and_a_sum_rounded_together(lanes):
    a, b = 1.0 + 2.0**-30, 1.0 - 2.0**-30
    given = [np.full(8, a), np.full(8, b)]
    found = elementwise(lambda _, x, y: x.intrinsic("fma", y, -1.0), 2, lanes)(*given)
    np.testing.assert_array_equal(found, -(2.0**-60))


def test_a_number_is_no_truth_of_python():
    with pytest.raises(TypeError, match="known only when its code runs"):
        elementwise(lambda _, x: x if x > 0.0 else -x, 1, 1)
