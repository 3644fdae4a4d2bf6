"""Factors as rows against dense algebra: integrals, conditionals, exact relations."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.stats import multivariate_normal

from pgm.kernels import rows
from pgm.kernels.rows import Rows, eliminate, largest_first, triangular
from tests.dense import algebra, matrices, random_covariance, vectors


def log_value(factor, x):
    """The exponent −½ ‖A x − r‖² at x, for one right side."""
    return -0.5 * np.sum((factor.matrix @ x - factor.right[..., 0]) ** 2, axis=-1)


def normal(matrix, right):
    """Mean, covariance and log-integral of exp(−½ ‖A x − r‖²), from its normal equations."""
    K, h = matrix.T @ matrix, matrix.T @ right
    cov = np.linalg.inv(K)
    mean = cov @ h
    size = matrix.shape[1]
    log_det = np.linalg.slogdet(K)[1]
    return mean, cov, 0.5 * (size * np.log(2 * np.pi) - log_det + h @ mean - right @ right)


shapes = st.integers(1, 5).flatmap(
    lambda size: st.tuples(st.just(size), st.integers(0, size), st.integers(0, 4))
)


@algebra
@given(shapes.flatmap(lambda s: st.tuples(st.just(s), matrices(s[2], s[0]), vectors(s[2] + s[0]))))
def test_elimination_is_a_conditional_times_the_rest(drawn):
    (size, count, _), spread, right = drawn
    matrix = np.concatenate([spread, np.eye(size)])
    done = eliminate(Rows(matrix, right[:, None]), count)
    mean, cov, integral = normal(matrix, right)
    # The conditional of x given s.
    kept = np.ix_(range(count, size), range(count, size))
    crossed = np.ix_(range(count), range(count, size))
    gain = cov[crossed] @ np.linalg.inv(cov[kept])
    assert_allclose(done.gain, gain, atol=1e-10)
    assert_allclose(done.offset[:, 0], mean[:count] - gain @ mean[count:], atol=1e-10)
    assert_allclose(done.noise, cov[:count, :count] - gain @ cov[crossed].T, atol=1e-10)
    assert done.contradiction is None
    # The rest: its integral, with the scale, is the factor's; its moments are those of s.
    if count < size:
        rest_mean, rest_cov, rest = normal(done.rest.matrix, done.rest.right[:, 0])
        assert_allclose(rest_mean, mean[count:], atol=1e-9)
        assert_allclose(rest_cov, cov[kept], atol=1e-9)
        assert_allclose(rest + done.log_scale[0], integral, atol=1e-9)
    else:
        assert_allclose(done.log_scale[0], integral, atol=1e-9)
    assert done.rest.matrix.shape == (size - count, size - count)


def test_stacks_and_right_sides():
    """Each factor of a stack, and each right side, as if it were alone."""
    rng = np.random.default_rng(0)
    matrix, right = rng.normal(size=(2, 3, 6, 4)), rng.normal(size=(2, 3, 6, 5))
    together = eliminate(Rows(matrix, right), 2)
    assert together.log_scale.shape == (2, 3, 5)
    for index in np.ndindex(2, 3):
        for side in range(5):
            alone = eliminate(Rows(matrix[index], right[index][:, side : side + 1]), 2)
            assert_allclose(together.gain[index], alone.gain, rtol=1e-12)
            assert_allclose(together.offset[index][:, side], alone.offset[:, 0], rtol=1e-10)
            assert_allclose(together.noise[index], alone.noise, rtol=1e-11, atol=1e-14)
            assert_allclose(together.log_scale[index][side], alone.log_scale[0], rtol=1e-11)


def test_nothing_to_integrate_and_nothing_left():
    rng = np.random.default_rng(1)
    factor = Rows(rng.normal(size=(5, 3)), rng.normal(size=(5, 2)))
    none = eliminate(factor, 0)
    assert none.gain.shape == (0, 3)
    assert none.noise.shape == (0, 0)
    assert_allclose(none.rest.matrix.T @ none.rest.matrix, factor.matrix.T @ factor.matrix)
    everything = eliminate(factor, 3)
    assert everything.rest.matrix.shape == (0, 0)
    assert everything.rest.right.shape == (0, 2)
    empty = eliminate(Rows(np.zeros((4, 0)), np.full((4, 1), 2.0)), 0)
    assert_allclose(empty.log_scale, [-8.0])


def test_rows_of_zeros_say_nothing():
    rng = np.random.default_rng(2)
    matrix, right = rng.normal(size=(4, 3)), rng.normal(size=(4, 1))
    bare = eliminate(Rows(matrix, right), 1)
    padded = eliminate(
        Rows(
            np.concatenate([np.zeros((2, 3)), matrix, np.zeros((1, 3))]),
            np.pad(right, [(2, 1), (0, 0)]),
        ),
        1,
    )
    for found, due in zip(padded, bare, strict=True):
        if isinstance(found, np.ndarray):
            assert_allclose(found, due, rtol=1e-12)


def test_an_integral_that_does_not_exist_is_nan_and_leaves_the_others():
    """Of three factors the second knows nothing about its first variable."""
    matrix = np.stack([np.eye(2), np.diag([0.0, 1.0]), 2 * np.eye(2)])
    done = eliminate(Rows(matrix, np.zeros((3, 2, 1))), 1)
    assert np.isnan(done.log_scale[1]).all()
    assert np.isfinite(done.log_scale[[0, 2]]).all()
    assert_allclose(done.noise[[0, 2], 0, 0], [1.0, 0.25])


def test_information_in_one_direction_alone_is_no_belief():
    """Two rows of one direction, but for rounding."""
    row = np.array([0.1, 0.2, 0.3])
    done = eliminate(Rows(np.stack([row, 3 * row, np.eye(3)[0]]), np.zeros((3, 1))), 3)
    assert np.isnan(done.log_scale).all()


# ---- the triangle


@algebra
@given(st.tuples(st.integers(0, 6), st.integers(1, 4)).flatmap(lambda s: matrices(*s)))
def test_a_triangle_keeps_the_normal_equations(matrix):
    right = np.ones((matrix.shape[0], 2))
    found = triangular(matrix, right)
    both = np.concatenate([matrix, right], axis=-1)
    assert found.shape[0] >= matrix.shape[1]
    assert_allclose(found, np.triu(found))
    assert_allclose(found.T @ found, both.T @ both, atol=1e-9)


def test_a_triangle_keeps_small_rows_beside_large_ones():
    """Rows of size one below rows of size 10¹²: the order in which they come does not matter."""
    sharp, weak = np.array([[1e12, 1e12, 1e12]]), np.eye(3) + np.triu(np.ones((3, 3)), 1)
    # In exact arithmetic: s along the sharp row's null space sees the weak rows alone.
    null = np.array([[1.0, -1.0, 0.0], [0.0, 1.0, -1.0]]).T
    due = np.linalg.inv((weak @ null).T @ (weak @ null))
    due = null @ due @ null.T
    for order in ([0, 1, 2, 3], [3, 2, 1, 0], [1, 0, 3, 2], [2, 3, 1, 0]):
        matrix = np.concatenate([sharp, weak])[order]
        factor = triangular(matrix, np.zeros((4, 1)))
        inverse = np.linalg.inv(factor[:3, :3])
        assert_allclose(inverse @ inverse.T, due, rtol=1e-11)


# ---- exact relations


def exact_joint(seed, x, s, relations, proper=True):
    """A density over (x, s), as rows and exact relations, and its dense moments.

    It is N(v; 0, P) for a covariance P of the rank that the relations leave.
    """
    rng = np.random.default_rng(seed)
    size = x + s
    basis, _ = np.linalg.qr(rng.normal(size=(size, size)))
    exact, free = basis[:, :relations].T, basis[:, relations:]
    root = rng.normal(size=(size - relations, size - relations)) + 2 * np.eye(size - relations)
    cov = free @ root @ root.T @ free.T
    mean = rng.normal(size=size)
    # Rows that know the free directions, and some nonsense about the exact ones.
    matrix = np.linalg.inv(root) @ free.T
    matrix = matrix + rng.normal(size=(size - relations, relations)) @ exact
    return matrix, matrix @ mean, exact, exact @ mean, mean, cov


CASES = [(2, 2, 1), (2, 2, 2), (2, 2, 3), (1, 3, 2), (3, 1, 2), (3, 0, 1), (3, 0, 3), (0, 3, 2)]


@pytest.mark.parametrize(("x", "s", "relations"), CASES)
@pytest.mark.parametrize("extra", [0, 2])
def test_exact_relations_against_moments(x, s, relations, extra):
    """Relations said several times over, mixed and scaled, are the same relations."""
    for seed in range(5):
        matrix, right, exact, exact_right, mean, cov = exact_joint(seed, x, s, relations)
        rng = np.random.default_rng(seed)
        more = rng.normal(size=(extra, relations))
        exact = np.concatenate([exact, more @ exact, np.zeros((1, x + s))])
        exact_right = np.concatenate([exact_right, more @ exact_right, [0.0]])
        done = eliminate(Rows(matrix, right[:, None], exact, exact_right[:, None]), x)
        assert not done.contradiction.any()
        if not s:
            assert_allclose(done.offset[:, 0], mean, atol=1e-11)
            assert_allclose(done.noise, cov, atol=1e-11)
            continue
        # What is over s determines s: x follows from it by the conditional.
        kept = cov[x:, x:]
        gain = cov[:x, x:] @ np.linalg.pinv(kept, rcond=1e-10)
        assert_allclose(done.gain @ kept, cov[:x, x:], atol=1e-10)
        assert_allclose(done.gain @ mean[x:] + done.offset[:, 0], mean[:x], atol=1e-10)
        assert_allclose(done.noise, cov[:x, :x] - gain @ cov[x:, :x], atol=1e-10)
        rest = eliminate(done.rest, s)
        assert_allclose(rest.offset[:, 0], mean[x:], atol=1e-10)
        assert_allclose(rest.noise, kept, atol=1e-10)


@pytest.mark.parametrize(("x", "s", "relations"), CASES)
def test_the_scale_of_exact_relations_is_the_limit_of_sharp_ones(x, s, relations):
    """δ(Cx − c) is N(Cx; c, ε²) in the limit, wherever the order of integration starts."""
    sharp = 1e-6
    matrix, right, exact, exact_right, *_ = exact_joint(7, x, s, relations)
    exact = np.diag(np.arange(1.0, relations + 1.0)) @ exact
    exact_right = np.arange(1.0, relations + 1.0) * exact_right
    first = eliminate(Rows(matrix, right[:, None], exact, exact_right[:, None]), x)
    total = first.log_scale + eliminate(first.rest, s).log_scale
    limit = eliminate(
        Rows(
            np.concatenate([matrix, exact / sharp]),
            np.concatenate([right, exact_right / sharp])[:, None],
        ),
        x + s,
    ).log_scale - relations * (0.5 * np.log(2 * np.pi) + np.log(sharp))
    assert_allclose(total, limit, atol=1e-8)


def test_a_relation_among_what_is_left_is_handed_on():
    """x + s₀ = 1 and x − s₁ = 0 leave s₀ + s₁ = 1."""
    exact = np.array([[1.0, 1.0, 0.0], [1.0, 0.0, -1.0]])
    done = eliminate(Rows(np.zeros((1, 3)), np.zeros((1, 1)), exact, np.array([[1.0], [0.0]])), 1)
    (relation,) = done.rest.exact[np.abs(done.rest.exact).max(axis=1) > 0.5]
    assert_allclose(np.abs(relation), np.sqrt([0.5, 0.5]))
    assert_allclose(done.rest.exact @ [0.25, 0.75], done.rest.exact_right[:, 0], atol=1e-15)


@pytest.mark.parametrize("count", [0, 1, 2])
@pytest.mark.parametrize("far", [1e-5, 1.0, 1e5])
def test_contradictions(count, far):
    """Three relations about two variables, which agree for the first right side alone."""
    exact = np.array([[1.0, 0.0], [0.0, 1.0], [0.6, 0.8]])
    good = exact @ [0.5, -1.0]
    right = np.stack([good, good + np.array([0, 0, far]), good], axis=-1)
    done = eliminate(Rows(np.eye(2), np.zeros((2, 3)), exact, right), count)
    last = done
    if not done.contradiction.any():
        last = eliminate(done.rest, 2 - count)
    assert last.contradiction.tolist() == [False, True, False]


def test_rounding_is_no_contradiction():
    """In units of the largest number, not of one."""
    exact = np.array([[1.0, 0.0], [0.0, 1.0], [0.6, 0.8]])
    right = exact @ np.array([[1e9], [3e8]]) + [[0.0], [0.0], [1e-3]]
    assert not eliminate(Rows(np.eye(2), np.zeros((2, 1)), exact, right), 2).contradiction.any()


def test_a_coefficient_of_rounding_determines_nothing():
    """0.1 + 0.2 − 0.3 of a variable is none of it, and 10⁻¹³ of it no more."""
    for other in (0.1 + 0.2, 0.3 + 2e-13):
        factor = Rows(
            np.eye(2), np.zeros((2, 1)), np.array([[1.0, 0.3], [1.0, other]]), np.zeros((2, 1))
        )
        assert_allclose(eliminate(factor, 2).noise[1, 1], 1.0 / 1.09, rtol=1e-12)
        assert not eliminate(factor, 1).rest.exact.any()


def test_no_relations_are_as_none():
    rng = np.random.default_rng(3)
    matrix, right = rng.normal(size=(4, 3)), rng.normal(size=(4, 1))
    bare = eliminate(Rows(matrix, right), 2)
    for zeros in (np.zeros((0, 3)), np.zeros((4, 3))):
        same = eliminate(Rows(matrix, right, zeros, np.zeros((len(zeros), 1))), 2)
        for name in ("gain", "offset", "noise", "log_scale"):
            assert_allclose(getattr(same, name), getattr(bare, name), rtol=1e-10, atol=1e-13)


# ---- the order of a root


def test_largest_first_keeps_the_order_of_equals():
    assert largest_first(np.eye(4)).tolist() == [0, 1, 2, 3]
    assert largest_first(np.ones((2, 3, 3))).tolist() == [[0, 1, 2], [0, 1, 2]]
    assert largest_first(np.zeros((0, 2, 2))).shape == (0, 2)


def test_largest_first_puts_what_is_nearly_determined_last():
    """Component 1 is nearly component 0; component 2 is free."""
    cov = np.array([[1.0, 1.0 - 1e-9, 0.0], [1.0 - 1e-9, 1.0, 0.0], [0.0, 0.0, 1.0]])
    assert largest_first(cov).tolist() == [0, 2, 1]


@algebra
@given(st.integers(1, 4).flatmap(lambda rank: st.tuples(st.just(rank), matrices(5, rank))))
def test_pivots_fall_in_that_order(drawn):
    _, root = drawn
    cov = root @ root.T
    std = np.sqrt(np.where(np.diag(cov) > 0, np.diag(cov), 1.0))
    cov = cov / (std[:, None] * std)
    order = largest_first(cov)
    assert sorted(order) == list(range(5))
    left, pivots = cov[np.ix_(order, order)], []
    for k in range(5):
        pivots.append(max(left[k, k], 0.0))
        if pivots[-1] > rows.NEGLIGIBLE:
            left = left - np.outer(left[:, k], left[k]) / left[k, k]
    assert all(a >= b - 1e-9 for a, b in pairwise(pivots))


def test_a_density_as_rows():
    """Rows L⁻¹ of a covariance L Lᵀ: the scale that makes them a density."""
    cov = random_covariance(np.random.default_rng(4), 3)
    lower = np.linalg.cholesky(cov)
    inverse = np.linalg.inv(lower)
    value = np.array([0.3, -0.2, 1.0])
    done = eliminate(Rows(inverse, np.zeros((3, 1))), 3)
    density = log_value(Rows(inverse, np.zeros((3, 1))), value) - done.log_scale[0]
    assert_allclose(density, multivariate_normal(np.zeros(3), cov).logpdf(value), rtol=1e-12)
