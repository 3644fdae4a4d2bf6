"""Displacements on a lattice: moments against high precision, matrices against plain loops."""

import mpmath
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from pgm.kernels.lattice import Span, along, kernels, matrices, reached

PARTS = [0.0, 1e-17, 1e-12, 1e-5, 0.02, 0.25, 0.4999, 0.5, 0.75, 1 - 1e-9]


def moments(first, weights, digits=50):
    """The sum, mean and variance of weights, summed with many digits."""
    with mpmath.workdps(digits):
        k = [mpmath.mpf(int(first) + i) for i in range(len(weights))]
        w = [mpmath.mpf(float(each)) for each in weights]
        total = mpmath.fsum(w)
        mean = mpmath.fsum(a * b for a, b in zip(w, k, strict=True)) / total
        spread = mpmath.fsum(a * (b - mean) ** 2 for a, b in zip(w, k, strict=True)) / total
        return total, mean, spread


@pytest.mark.parametrize("variance", [0.0, 1e-13, 1e-6, 0.01, 0.2, 0.25, 0.31, 1.0, 6.0, 400.0])
def test_moments_are_exact(variance):
    shift = np.array(PARTS) + np.array([0, 1, -3, 7, 0, -1, 2, 4, 0, -2])
    made = kernels(shift, variance)
    assert (made.weights >= 0.0).all()
    for first, weights, at, added in zip(*made[:2], shift, made.added, strict=True):
        total, mean, spread = moments(first, weights)
        part = at - np.floor(at)
        due = max(variance, part * (1.0 - part))
        assert abs(total - 1) < 1e-14
        assert abs(mean - mpmath.mpf(at)) < 1e-13 * max(1.0, variance**0.5)
        assert abs(spread - due) < 1e-12 * max(1.0, variance)
        assert_allclose(added, max(part * (1 - part) - variance, 0.0), atol=1e-15)


@given(st.floats(-50, 50), st.floats(0, 30))
def test_moments_of_any_displacement(shift, variance):
    made = kernels(np.array([shift]), variance)
    _, mean, spread = moments(made.first[0], made.weights[0])
    part = shift - np.floor(shift)
    assert abs(mean - shift) < 1e-12
    assert abs(spread - max(variance, part * (1 - part))) < 1e-12 * max(1.0, variance)


@pytest.mark.parametrize("excess", [1e-12, 1e-9, 1e-4, 0.03])
def test_a_little_more_than_two_points(excess):
    shift = np.array(PARTS)
    part = shift - np.floor(shift)
    made = kernels(shift, part * (1 - part) + excess)
    for first, weights, f in zip(*made[:2], part, strict=True):
        _, mean, spread = moments(first, weights)
        assert abs(mean - f) < 1e-14
        assert abs(spread - f * (1 - f) - excess) < 1e-14


def test_weights_are_those_of_the_formula():
    """Two parameters found by mpmath, with all tails."""
    shift, variance = 0.3, 0.5

    def each(a, b, power):
        terms = [mpmath.e ** (a * k - b * k * k) * mpmath.mpf(k) ** power for k in range(-30, 31)]
        return mpmath.fsum(terms)

    def off(a, b):
        total = each(a, b, 0)
        mean = each(a, b, 1) / total
        return mean - shift, each(a, b, 2) / total - mean**2 - variance

    with mpmath.workdps(30):
        a, b = mpmath.findroot(off, (0.6, 1.0))
        total = each(a, b, 0)
        made = kernels(np.array([shift]), variance)
        for k, weight in enumerate(made.weights[0], int(made.first[0])):
            assert abs(mpmath.e ** (a * k - b * k * k) / total - weight) < 1e-14


def moved(values, shifts, variance, periodic):
    """One column after another, its kernel found by itself."""
    cells = len(values)
    found = np.zeros(cells)
    for i, value in enumerate(values):
        first, weights, _ = kernels(np.array([shifts[i]]), variance)
        for k, weight in enumerate(weights[0], i + int(first[0])):
            if periodic:
                found[k % cells] += value * weight
            elif 0 <= k < cells:
                found[k] += value * weight
    return found


@pytest.mark.parametrize("periodic", [False, True])
@pytest.mark.parametrize("own", [False, True])
@pytest.mark.parametrize(("first", "count"), [(0, 9), (2, 4), (7, 2)])
@pytest.mark.parametrize("variance", [0.3, 9.0])
def test_matrices_are_kernels_in_columns(periodic, own, first, count, variance):
    rng, cells = np.random.default_rng(1), 9
    shifts = rng.normal(0, 3, cells) if own else np.full(cells, -2.3)
    values = np.zeros(cells)
    values[first : first + count] = rng.random(count)
    made = kernels(shifts[first : first + count] if own else shifts[:1], variance)
    starts, taps = made.first[None], made.weights.shape[-1]
    places = first + starts + (np.arange(count) if own else np.zeros(1, dtype=int))
    high = int(places.max()) + taps + (0 if own else count - 1)
    target = reached(int(places.min()), high, cells, periodic)
    (matrix,) = matrices(starts, made.weights[None], Span(first, count), target, cells, periodic)
    found = np.zeros(cells)
    rows = np.arange(target.first, target.first + target.length) % cells
    found[rows] = matrix @ values[first : first + count]
    assert_allclose(found, moved(values, shifts, variance, periodic), rtol=1e-12, atol=1e-16)


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("others", [(), (0,), (1,), (2,), "both"])
def test_products_along_an_axis(axis, others):
    rng, shape = np.random.default_rng(2), (3, 4, 5)
    by = tuple(k for k in range(3) if k != axis) if others == "both" else others
    if axis in by:
        return
    array = rng.random(shape)
    cells = [shape[k] for k in by]
    matrix = rng.random((int(np.prod(cells)), 6, shape[axis]))
    letters = "abc"
    lead = "".join(letters[k] for k in by)
    out = letters.replace(letters[axis], "z")
    due = np.einsum(
        f"{lead}z{letters[axis]},abc->{out}", matrix.reshape(*cells, 6, shape[axis]), array
    )
    assert_allclose(along(matrix, array, axis, by), due, rtol=1e-13)
