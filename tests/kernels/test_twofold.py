"""Twice the digits against rational numbers."""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pgm.kernels import extended
from pgm.kernels.extended import Twofold

# Two float64 hold 106 bits; a few of the last ones are rounding, of each term that is summed up.
DIGITS = Fraction(1, 10**31)
# Below this share of its diagonal entry a pivot of the matrices drawn here is rounding.
SHARE = 1e-26
few = settings(max_examples=25, deadline=None)
numbers = st.builds(
    lambda mantissa, exponent: Fraction(mantissa) * Fraction(2) ** exponent,
    st.integers(-(2**105), 2**105),
    st.integers(-150, -50),
)


def held(rows):
    """Rational numbers of 105 bits, held exactly."""
    rows = np.array(rows, dtype=object)
    high = rows.astype(float)
    return Twofold(high, (rows - exact(high)).astype(float))


def exact(value):
    """The rational numbers that are held."""
    if isinstance(value, Twofold):
        return exact(value.hi) + exact(value.lo)
    return np.vectorize(Fraction, otypes=[object])(value)


def stacks(*shape):
    count = int(np.prod(shape))
    rows = st.lists(numbers, min_size=count, max_size=count)
    return rows.map(lambda row: np.array(row, dtype=object).reshape(shape))


def assert_close(found, due, size):
    """Within rounding of what was summed up, and with the two parts apart."""
    assert found.shape == due.shape
    assert (abs(exact(found) - due) <= DIGITS * size).all()
    assert (found.hi + found.lo == found.hi).all()


@few
@given(stacks(3), stacks(3), st.floats(-1e9, 1e9))
def test_arithmetic(a, b, c):
    one, other, c_exact = held(a), held(b), Fraction(c)
    row, row_exact = other.hi, exact(other.hi)
    size = abs(a) + abs(b)
    assert_close(one + other, a + b, size)
    assert_close(one - other, a - b, size)
    assert_close(-one, -a, 0 * size)
    assert_close(one * other, a * b, abs(a * b))
    # With an array, and with a number, on either side.
    assert_close(row + one, a + row_exact, size)
    assert_close(row - one, row_exact - a, size)
    assert_close(one - row, a - row_exact, size)
    assert_close(row * one, a * row_exact, abs(a * row_exact))
    assert_close(c * one + c, c_exact * a + c_exact, abs(c_exact * a) + abs(c_exact))
    if (b != 0).all():
        assert_close(one / other, a / b, 2 * abs(a / b))
        assert_close(1.0 / other, 1 / b, 2 / abs(b))
        assert_close(one / row, a / row_exact, 2 * abs(a / row_exact))


@few
@given(numbers, numbers)
def test_what_cancels(a, b):
    """Counted from what was summed up."""
    difference = (held([a]) + held([b])) - held([a])
    assert abs(exact(difference)[0] - b) <= 2 * DIGITS * (abs(a) + abs(b))


@few
@given(stacks(2, 3, 4), stacks(2, 4, 3))
def test_products(a, b):
    one, other = held(a), held(b)
    size = 4 * (abs(a) @ abs(b))
    assert_close(one @ other, a @ b, size)
    assert_close(one @ other.hi, a @ exact(other.hi), size)
    assert_close(one[..., 0] * one[..., 0], a[..., 0] ** 2, a[..., 0] ** 2)
    assert_close(one.dot(other.T), (a * b.swapaxes(-1, -2)).sum(-1), 4 * (abs(a) @ abs(b)).sum(-1))
    assert_close(one.T, a.swapaxes(-1, -2), 0 * abs(a.swapaxes(-1, -2)))


@few
@given(stacks(2, 3, 3))
def test_matrices_of_covariances(a):
    """Products that are symmetric are so to the last digit, of which half is computed."""
    cov = held(a) + held(a).T
    found, due = cov.times(cov), exact(cov) @ exact(cov).swapaxes(-1, -2)
    assert_close(found, due, 4 * (abs(exact(cov)) @ abs(exact(cov))))
    assert (found == found.T).all()
    assert_close(cov.one_minus(), np.eye(3, dtype=int) - exact(cov), 1 + abs(exact(cov)))


@pytest.mark.parametrize("count", range(6))
def test_products_over_any_number_of_terms(count):
    rng = np.random.default_rng(count)
    a, b = rng.normal(size=(2, 3, count)), rng.normal(size=(2, count, 2))
    found = Twofold(a) @ b
    due = np.zeros((2, 3, 2), dtype=object) + Fraction(0)
    for k in range(count):
        due = due + exact(a)[..., k, None] * exact(b)[:, k, None, :]
    assert_close(found, due, abs(exact(np.abs(a) @ np.abs(b))))


@few
@given(stacks(4), stacks(4), st.lists(st.booleans(), min_size=4, max_size=4))
def test_choosing_and_setting(a, b, mask):
    mask, one, other = np.array(mask), held(a), held(b)
    assert (exact(extended.where(mask, one, other)) == np.where(mask, a, b)).all()
    assert (exact(extended.where(mask, one, 0.0)) == np.where(mask, a, Fraction(0))).all()
    copy = one.copy()
    copy[mask] = other[mask]
    copy[0] = 2.0
    due = np.where(mask, b, a)
    due[0] = Fraction(2)
    assert (exact(copy) == due).all()
    assert (exact(one) == a).all()  # the copy is one
    assert (exact(Twofold.zeros((2, 3))) == 0).all()


# ---- elimination

units = st.lists(st.integers(-20, 20), min_size=4, max_size=4)
entries = st.lists(st.integers(-3, 3), min_size=12, max_size=12)


def semidefinite(entry, unit, rank):
    """B Bᵀ of a rank at most, in units of powers of two."""
    root = np.array(entry, dtype=object).reshape(4, 3)[:, :rank] * Fraction(1)
    root = root * np.array([[Fraction(2) ** k] for k in unit])
    return root @ root.T


def factors(matrix):
    """U and D of U D Uᵀ in rational numbers, zero below a pivot of zero."""
    left, size = matrix.copy(), len(matrix)
    unit, pivots = exact(np.eye(size)), exact(np.zeros(size))
    for j in range(size):
        pivots[j] = left[j, j]
        if pivots[j]:
            unit[j + 1 :, j] = left[j + 1 :, j] / pivots[j]
            left = left - np.outer(left[:, j], left[j]) / pivots[j]
    return unit, pivots


@few
@given(entries, units, st.integers(0, 3))
def test_factors_of_semidefinite_matrices(entry, unit, rank):
    """Whatever their rank, and whatever the units."""
    matrix = semidefinite(entry, unit, rank)
    lower, pivots = extended.eliminated(held(matrix)[None], SHARE)
    due, due_pivots = factors(matrix)
    scale = [Fraction(2) ** k for k in unit]
    assert ((pivots.hi[0] == 0.0) == (due_pivots == 0)).all()
    assert (abs(exact(pivots)[0] - due_pivots) <= 1000 * DIGITS * np.diagonal(matrix)).all()
    edge = np.outer(scale, [1 / s for s in scale])
    assert (abs(exact(lower)[0] - due) <= 10**5 * DIGITS * edge).all()
    # The inverse on the range, and nothing beside it: A A⁺ A = A, A⁺ A A⁺ = A⁺.
    inverse = exact(extended.inverse(lower, pivots))[0]
    again = matrix @ inverse @ matrix
    deviations = np.array([abs(row).max() for row in matrix])
    assert (abs(again - matrix) <= 10**8 * DIGITS * np.maximum.outer(deviations, deviations)).all()
    size = abs(inverse) @ abs(matrix) @ abs(inverse)
    assert (abs(inverse @ matrix @ inverse - inverse) <= 10**5 * DIGITS * size).all()


@few
@given(entries, stacks(2, 4, 2))
def test_regular_matrices(entry, right):
    """The inverse, and the solution of U X = B, of a stack."""
    matrix = semidefinite(entry, [0] * 4, 3) + exact(np.eye(4))
    lower, pivots = extended.eliminated(held([matrix, 2 * matrix]), SHARE)
    found = exact(extended.inverse(lower, pivots))
    assert (abs(found[0] @ matrix - np.eye(4)) <= 10**6 * DIGITS).all()
    assert (abs(2 * found[1] @ matrix - np.eye(4)) <= 10**6 * DIGITS).all()
    whole = extended.solve(lower, pivots, held(right))
    size = 100 * abs(matrix) @ abs(exact(whole))
    assert (abs(matrix @ exact(whole)[0] - right[0]) <= DIGITS * size[0]).all()
    assert (abs(2 * matrix @ exact(whole)[1] - right[1]) <= 2 * DIGITS * size[1]).all()
    solution = extended.solve_unit(lower, held(right))
    size = abs(exact(lower)) @ abs(exact(solution))
    assert (abs(exact(lower) @ exact(solution) - right) <= 10 * DIGITS * size).all()


def test_a_solution_keeps_what_an_inverse_loses():
    """Of a matrix that is nearly singular: A x is right, though x hardly is."""
    wide = Fraction(10**22)
    matrix = np.array([[wide + Fraction(1, 100), wide], [wide, wide + Fraction(1, 50)]])
    lower, pivots = extended.eliminated(held([matrix]), SHARE * 1e-6)
    right = held([[[wide], [wide + 1]]])
    found = exact(extended.solve(lower, pivots, right))[0]
    size = abs(matrix) @ abs(found)
    assert (abs(matrix @ found - exact(right)[0]) <= 10 * DIGITS * size).all()
    # The sum of both components is some 1e-22 of theirs.
    assert abs(found.sum() - 1) < Fraction(1, 10**20)


def test_pivots_that_are_rounding():
    """A pivot as a share of its diagonal entry, or beside what rounding may have changed it by."""
    small = Fraction(1, 2**90)
    matrix = held([[[Fraction(1), Fraction(1)], [Fraction(1), 1 + small]]])

    def pivots(negligible, *rounding):
        rows = (np.array([rounding]),) if rounding else ()
        lower, found = extended.eliminated(matrix, negligible, *rows)
        assert exact(lower)[0, 1, 0] == 1
        return list(exact(found)[0])

    assert pivots(1e-26) == [1, 0]
    assert pivots(1e-28) == [1, small]
    assert pivots(100.0, 1e-31, 1e-31) == [1, small]
    assert pivots(100.0, 1e-31, 1e-29) == [1, 0]
    assert pivots(100.0, 1e-29, 0.0) == [1, 0]  # elimination carries it to the second
    # An entry that may be rounding is no pivot, and nothing is eliminated by it.
    lower, found = extended.eliminated(matrix, 100.0, np.array([[0.1, 1e-31]]))
    assert list(exact(found)[0]) == [0, 1 + small]
    assert (exact(lower)[0] == np.eye(2)).all()


def test_the_rounding_given_is_not_changed():
    rounding = np.full((1, 3), 1e-30)
    extended.eliminated(Twofold(np.eye(3)[None] + 1.0), 100.0, rounding)
    assert (rounding == 1e-30).all()


@few
@given(entries, units)
def test_the_rank_of_a_matrix_that_rounding_has_changed(entry, unit):
    """Of rank one, changed by 10⁻³⁰ of its entries: exactly one pivot, if there is any."""
    matrix = semidefinite(entry, unit, 1)
    signs = np.array([[1, -1, 1, -1], [-1, 1, 1, 1], [1, 1, -1, 1], [-1, 1, 1, -1]])
    changed = held(matrix + abs(matrix) * signs * Fraction(1, 10**30))
    bound = np.diagonal(matrix).astype(float)[None] * 1e-30
    _, pivots = extended.eliminated(changed, 100.0, bound)
    assert (pivots.hi != 0.0).sum() == (matrix != 0).any()
