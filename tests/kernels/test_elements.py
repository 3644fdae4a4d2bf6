"""Elements of segments against the dense joint, and their algebra."""

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given, settings

from pgm.kernels import elements, prefixes
from pgm.kernels.elements import Belief, Element, Likelihood

N = 3


def semidefinite(rng, rank):
    root = rng.normal(size=(N, rank))
    return root @ root.T


def element(rng, cov_rank, rank):
    """An element whose evidence is W x = v with unit noise, so that its h lies in K's range."""
    white = rng.normal(size=(rank, N))
    h = white.T @ rng.normal(size=rank)
    return Element(
        rng.normal(size=(N, N)),
        rng.normal(size=N),
        semidefinite(rng, cov_rank),
        white.T @ white,
        h,
        np.asarray(rng.normal()),
    )


def log_joint(e, x, y):
    """The logarithm of an element with a regular covariance."""
    r = y - e.F @ x - e.b
    normal = -0.5 * (
        r @ np.linalg.solve(e.cov, r) + np.linalg.slogdet(e.cov)[1] + N * np.log(2 * np.pi)
    )
    return normal - 0.5 * x @ e.K @ x + e.h @ x + e.g


def close(one, other, tolerance=1e-9):
    for a, b in zip(one, other, strict=True):
        assert np.abs(a - b).max() <= tolerance * max(1.0, np.abs(b).max())


RANKS = st.integers(0, N)


@settings(deadline=None, max_examples=60)
@given(st.integers(0, 10**6), st.lists(RANKS, min_size=6, max_size=6))
def test_they_compose_associatively(seed, ranks):
    rng = np.random.default_rng(seed)
    a, b, c = (element(rng, ranks[2 * k], ranks[2 * k + 1]) for k in range(3))
    left = elements.compose(elements.compose(a, b), c)
    right = elements.compose(a, elements.compose(b, c))
    close(left, right, 1e-7)


@settings(deadline=None, max_examples=60)
@given(st.integers(0, 10**6), st.lists(RANKS, min_size=5, max_size=5))
def test_a_belief_goes_through_a_composition_as_through_its_parts(seed, ranks):
    rng = np.random.default_rng(seed)
    a, b = (element(rng, ranks[2 * k], ranks[2 * k + 1]) for k in range(2))
    belief = Belief(rng.normal(size=N), semidefinite(rng, ranks[4]), np.asarray(0.3))
    whole = elements.push(belief, elements.compose(a, b))
    close(whole, elements.push(elements.push(belief, a), b), 1e-7)


def test_a_composition_is_the_integral_over_the_middle():
    rng = np.random.default_rng(0)
    a, b = element(rng, N, 2), element(rng, N, 1)
    whole = elements.compose(a, b)
    x, y = rng.normal(size=(2, N))
    # The integrand is a Gaussian in the middle m: exp(−½ mᵀAm + rᵀm + c).
    zero = np.zeros(N)
    c = log_joint(a, x, zero) + log_joint(b, zero, y)
    precision = np.linalg.inv(a.cov) + b.F.T @ np.linalg.solve(b.cov, b.F) + b.K
    r = np.linalg.solve(a.cov, a.F @ x + a.b) + b.F.T @ np.linalg.solve(b.cov, y - b.b) + b.h
    due = c + 0.5 * (
        r @ np.linalg.solve(precision, r) - np.linalg.slogdet(precision)[1] + N * np.log(2 * np.pi)
    )
    assert log_joint(whole, x, y) == pytest.approx(due, abs=1e-9)


@pytest.mark.parametrize("rank", range(N + 1))
def test_a_condition_is_that_of_a_reading(rank):
    """N(m, P) and z = H x + n by the textbook, with P of any rank; the log-weight, too."""
    rng = np.random.default_rng(rank)
    mean, cov = rng.normal(size=N), semidefinite(rng, rank)
    see, noise, z = rng.normal(size=(2, N)), np.diag([0.5, 2.0]), rng.normal(size=2)
    inverse = np.linalg.inv(noise)
    log_scale = -0.5 * (z @ inverse @ z + np.linalg.slogdet(2 * np.pi * noise)[1])
    likelihood = Likelihood(see.T @ inverse @ see, see.T @ inverse @ z, np.asarray(log_scale))
    found = elements.condition(Belief(mean, cov, np.asarray(0.0)), likelihood)
    s = see @ cov @ see.T + noise
    gain, left = cov @ see.T @ np.linalg.inv(s), z - see @ mean
    np.testing.assert_allclose(found.mean, mean + gain @ left, atol=1e-10)
    np.testing.assert_allclose(found.X.T @ found.X, cov - gain @ s @ gain.T, atol=1e-10)
    due = -0.5 * (left @ np.linalg.solve(s, left) + np.linalg.slogdet(2 * np.pi * s)[1])
    assert found.log_weight == pytest.approx(due, abs=1e-10)
    moved = found.mean - mean
    assert found.moved @ found.moved == pytest.approx(moved @ np.linalg.pinv(cov) @ moved, abs=1e-9)


def test_sharp_evidence_after_a_vague_noise_costs_no_digits():
    """In one dimension K (1 + ΣK)⁻¹ and Σ (1 + ΣK)⁻¹ are known."""
    for sharp in (1e2, 1e5, 1e8):
        vague = Element(
            *(np.full(s, v) for s, v in (((1, 1), 1.0), ((1,), 0.0), ((1, 1), sharp))),
            np.zeros((1, 1)),
            np.zeros(1),
        )
        seen = Element(
            np.eye(1), np.zeros(1), np.zeros((1, 1)), np.full((1, 1), sharp), np.zeros(1)
        )
        whole = elements.compose(vague, seen)
        due = sharp / (1 + sharp * sharp)
        np.testing.assert_allclose(whole.K, due, rtol=1e-12)
        np.testing.assert_allclose(whole.cov, due, rtol=1e-12)


@pytest.mark.parametrize("steps", [1, 2, 3, 5, 8, 13, 64, 100])
def test_a_scan_is_a_loop(steps):
    rng = np.random.default_rng(steps)
    runs = 2
    made = [[element(rng, 2, 1) for _ in range(runs)] for _ in range(steps)]
    stack = Element(
        *(np.array([[getattr(e, f) for e in row] for row in made]) for f in Element._fields)
    )
    start = Belief(
        np.zeros((1, runs, N)), np.broadcast_to(np.eye(N), (1, runs, N, N)), np.zeros((1, runs))
    )
    found = prefixes.prefixes(start, prefixes.levels(stack, elements.compose), elements.push)
    belief = start
    for step in range(steps):
        belief = elements.push(belief, prefixes.take(stack, slice(step, step + 1)))
        close(prefixes.take(found, slice(step, step + 1)), belief, 1e-7)


def test_chunks_are_as_good_as_the_whole(monkeypatch):
    rng = np.random.default_rng(1)
    rows = [element(rng, N, 2) for _ in range(50)]
    stack = Element(*(np.array([[getattr(e, f)] for e in rows]) for f in Element._fields))
    whole = prefixes.in_chunks(elements.compose, stack, stack)
    monkeypatch.setattr(prefixes, "_CHUNK", 7)
    close(prefixes.in_chunks(elements.compose, stack, stack), whole, 1e-12)
