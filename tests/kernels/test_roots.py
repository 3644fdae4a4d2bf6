"""Roots of semidefinite matrices: what is determined, in any units, in any batch."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from pgm.kernels import roots, solving, step
from pgm.kernels.dense import Stack
from tests.dense import algebra, definite, matrices, random_covariance

# Batches that are solved matrix by matrix, and ones that are solved column by column.
leads = pytest.mark.parametrize("lead", [(3,), (15,), (16,), (60,), (5, 4)])


@algebra
@given(definite(4))
def test_a_definite_matrix_has_its_cholesky_root(matrix):
    assert_allclose(roots.root(matrix), np.linalg.cholesky(matrix), atol=1e-12)
    assert not roots.determined(roots.root(matrix)).any()
    assert roots.is_proper(roots.root(matrix))


@algebra
@given(st.integers(0, 4).flatmap(lambda rank: matrices(4, rank)))
def test_a_root_of_a_semidefinite_matrix_is_lower_triangular_and_multiplies_back(factor):
    matrix = factor @ factor.T
    lower = roots.root(matrix)
    scale = np.abs(matrix).max(initial=0.0)
    assert_allclose(lower, np.tril(lower))
    assert_allclose(lower @ lower.T, matrix, atol=1e-6 * scale)
    assert (np.diagonal(lower) >= 0.0).all()
    assert not lower[:, roots.determined(lower)].any()


@pytest.mark.parametrize(
    ("matrix", "determined"),
    [
        (np.zeros((3, 3)), [True, True, True]),
        (np.diag([0.0, 2.0, 0.0]), [True, False, True]),
        (np.ones((3, 3)), [False, True, True]),
        ([[1, 2, 0], [2, 4, 0], [0, 0, 1]], [False, True, False]),
        ([[0, 0, 0], [0, 1, -1], [0, -1, 1]], [True, False, True]),
        (1e-30 * np.eye(3), [False, False, False]),
    ],
)
def test_components_determined_by_those_before(matrix, determined):
    lower = roots.root(np.asarray(matrix, dtype=float))
    np.testing.assert_array_equal(roots.determined(lower), determined)
    assert_allclose(lower @ lower.T, matrix, atol=1e-15)


@algebra
@given(
    st.integers(1, 4).flatmap(lambda rank: matrices(4, rank)),
    st.lists(st.integers(-20, 20), min_size=4, max_size=4),
)
def test_units_do_not_matter(factor, exponents):
    matrix = factor @ factor.T
    units = 2.0 ** np.array(exponents)  # exact in floating point
    lower = roots.root(matrix)
    assert_allclose(
        roots.root(units[:, None] * matrix * units), units[:, None] * lower, rtol=1e-9, atol=0.0
    )


@pytest.mark.parametrize("unit", [1e-9, 1e-3, 1e4, 1e8])
def test_units_of_one_component_do_not_matter(unit):
    root = np.array([[2.0, 0.0], [1.0, 1e-3], [3.0, 0.0]])
    units = np.array([1.0, unit, 1.0])
    expected = roots.root(root @ root.T)
    found = roots.root((units[:, None] * root) @ (units[:, None] * root).T)
    np.testing.assert_array_equal(roots.determined(found), [False, False, True])
    assert_allclose(found, units[:, None] * expected, rtol=1e-7)


@pytest.mark.parametrize(
    "matrix",
    [
        np.diag([1.0, -1.0]),
        -np.eye(2),
        [[1.0, 2.0], [2.0, 1.0]],
        [[0.0, 1.0], [1.0, 0.0]],
        [[0.0, 1.0], [1.0, 5.0]],
        [[1.0, 1.0], [1.0, 1.0 - 1e-6]],
        [[1e12, 0.0], [0.0, -1e-6]],
        [[1e12, 2.0], [2.0, 1e-12]],
        [[np.nan, 0.0], [0.0, 1.0]],
        [[1.0, 0.0], [0.0, np.inf]],
        [[1.0, np.inf], [np.inf, 1.0]],
    ],
)
def test_an_indefinite_matrix_has_no_root(matrix):
    lower = roots.root(np.array(matrix))
    assert np.isnan(lower).all()
    assert not roots.is_proper(lower)
    batch = roots.root(np.stack([np.eye(2), np.array(matrix), np.zeros((2, 2))]))
    assert_allclose(batch[0], np.eye(2))
    assert np.isnan(batch[1]).all()
    assert_allclose(batch[2], 0.0)
    assert not roots.is_proper(batch)


def test_rounding_is_not_indefinite():
    rng = np.random.default_rng(0)
    for _ in range(200):
        factor = rng.normal(size=(6, 2)) * 10.0 ** rng.integers(-6, 6, size=(6, 1))
        assert roots.is_proper(roots.root(factor @ factor.T))


@leads
@pytest.mark.parametrize("rank", [0, 2, 4])
def test_a_batch_is_its_singles(lead, rank):
    rng = np.random.default_rng(rank)
    factor = rng.normal(size=(*lead, 4, rank))
    factor[..., :rank, :] += 4.0 * np.eye(rank)
    matrix = factor @ factor.swapaxes(-1, -2)
    right = matrix @ rng.normal(size=(*lead, 4, 2))
    lower = roots.root(matrix)
    parts = {
        "solve_lower": solving.solve_lower(lower, right),
        "solve_upper": solving.solve_upper(lower, right),
        "solve": solving.solve(lower, right),
        "log_determinant": solving.log_determinant(lower),
    }
    for k in np.ndindex(lead):
        single = roots.root(matrix[k])
        assert_allclose(lower[k], single, atol=1e-7)
        for name, part in parts.items():
            arguments = () if name == "log_determinant" else (right[k],)
            expected = getattr(solving, name)(lower[k], *arguments)
            assert_allclose(part[k], expected, rtol=1e-9, atol=1e-9)


@leads
def test_one_singular_matrix_leaves_the_rest_of_the_batch(lead):
    rng = np.random.default_rng(0)
    matrix = random_covariance(rng, 3, lead=lead) + np.eye(3)
    expected = np.linalg.cholesky(matrix)
    matrix[(1, *(0 for _ in lead[1:]))] = 0.0
    lower = roots.root(matrix)
    fixed = np.zeros(lead, dtype=bool)
    fixed[(1, *(0 for _ in lead[1:]))] = True
    np.testing.assert_array_equal(roots.determined(lower).all(axis=-1), fixed)
    assert_allclose(lower[~fixed], expected[~fixed], atol=1e-12)


@leads
def test_solving_is_that_of_numpy(lead):
    rng = np.random.default_rng(0)
    matrix = random_covariance(rng, 3, lead=lead) + np.eye(3)
    right, lower = rng.normal(size=(*lead, 3, 2)), roots.root(matrix)
    assert_allclose(solving.solve_lower(lower, right), np.linalg.solve(lower, right), atol=1e-10)
    upper = lower.swapaxes(-1, -2)
    assert_allclose(solving.solve_upper(lower, right), np.linalg.solve(upper, right), atol=1e-10)
    assert_allclose(solving.solve(lower, right), np.linalg.solve(matrix, right), atol=1e-10)
    assert_allclose(solving.log_determinant(lower), np.linalg.slogdet(matrix)[1], atol=1e-10)


@pytest.mark.parametrize("many", [4, 40])
def test_right_sides_broadcast(many):
    rng = np.random.default_rng(0)
    matrix = random_covariance(rng, 3) + np.eye(3)
    right, lower = rng.normal(size=(many, 3, 2)), roots.root(matrix)
    assert_allclose(solving.solve(lower, right), np.linalg.solve(matrix, right), atol=1e-10)
    stack = np.broadcast_to(lower, (many, 3, 3))
    assert_allclose(
        solving.solve(stack, right[0]), np.linalg.solve(matrix, right[[0] * many]), atol=1e-10
    )


@algebra
@given(st.integers(0, 3).flatmap(lambda rank: matrices(4, rank)), matrices(4, 2))
def test_a_singular_system_is_solved_in_its_range(factor, x):
    matrix = factor @ factor.T
    right = matrix @ x
    lower = roots.root(matrix)
    assert_allclose(matrix @ solving.solve(lower, right), right, atol=1e-6)
    left = solving.solve_lower(lower, right)[roots.determined(lower)]
    assert_allclose(left, 0.0, atol=1e-6)


def test_what_is_left_outside_the_range():
    lower = roots.root(np.ones((2, 2)))
    assert_allclose(solving.solve_lower(lower, np.array([[3.0], [5.0]])), [[3.0], [2.0]])
    assert_allclose(solving.solve_upper(lower, np.array([[3.0], [5.0]])), [[3.0], [0.0]])


@pytest.mark.parametrize("lead", [(), (3,), (60,)])
@pytest.mark.parametrize("rank", [0, 1, 3, 5])
def test_the_gain_regresses_one_block_of_a_covariance_on_another(lead, rank):
    cov = random_covariance(np.random.default_rng(rank), 5, rank, lead)
    cross, rest = cov[..., :2, 2:], cov[..., 2:, 2:]
    gain = step.gain(Stack(rest).root(), Stack(cov[..., 2:, :2])).array
    assert_allclose(gain @ rest, cross, atol=1e-7)
    explained = gain @ cross.swapaxes(-1, -2)
    inverse = np.linalg.pinv(rest, hermitian=True, rcond=1e-10)
    assert_allclose(explained, cross @ inverse @ cross.swapaxes(-1, -2), atol=1e-7)


def test_the_determinant_is_that_of_what_is_not_determined():
    assert solving.log_determinant(roots.root(np.zeros((2, 2)))) == 0.0
    assert_allclose(solving.log_determinant(roots.root(4.0 * np.ones((3, 3)))), np.log(4.0))


def test_matrices_of_no_components():
    empty = np.empty((7, 0, 0))
    lower = roots.root(empty)
    assert lower.shape == (7, 0, 0)
    assert solving.solve(lower, np.empty((7, 0, 2))).shape == (7, 0, 2)
    assert_allclose(solving.log_determinant(lower), np.zeros(7))


def test_pivots_are_compared_with_what_they_came_from():
    # A variance of 1e-6 is one; but not where it is the difference of two of 1e9.
    matrix = np.diag([1.0, 1e-6])
    np.testing.assert_array_equal(roots.determined(roots.root(matrix)), [False, False])
    lower = roots.root(matrix, np.array([1.0, 1e9]))
    np.testing.assert_array_equal(roots.determined(lower), [False, True])


def test_the_smallest_share_left_open():
    assert roots.smallest_pivot(np.eye(3)) == 1.0
    correlated = np.array([[4.0, 1.8], [1.8, 1.0]])
    assert_allclose(roots.smallest_pivot(roots.root(correlated)), 1.0 - 1.8**2 / 4.0)
    stack = roots.root(np.stack([np.eye(2), correlated]))
    assert_allclose(roots.smallest_pivot(stack), 1.0 - 1.8**2 / 4.0)
    assert roots.smallest_pivot(roots.root(np.ones((2, 2)))) == 0.0
