"""Fronts in machine code, against dense least squares."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

pytest.importorskip("llvmlite")

from pgm.kernels.machine.fronts.plan import Plan
from pgm.kernels.machine.fronts.solving import Solver

NEGLIGIBLE = 1e-11


def drawn(rng, fronts, most):
    """A plan of a random tree, and the components of its fronts' columns, and of its factors."""
    parents = [int(rng.integers(k + 1, fronts)) for k in range(fronts - 1)] + [-1]
    # Children come right before their parents: the order of a search in depth, turned round.
    children = [[k for k in range(fronts) if parents[k] == j] for j in range(fronts)]
    order, waiting = [], [fronts - 1]
    while waiting:
        order.append(waiting.pop())
        waiting += children[order[-1]]
    order = order[::-1]
    number = {old: new for new, old in enumerate(order)}
    parent = [number.get(parents[old], -1) for old in order]
    pivots = rng.integers(1, most + 1, size=fronts)
    first = np.cumsum(pivots) - pivots
    held = [list(range(a, a + n)) for a, n in zip(first, pivots, strict=True)]
    for k in reversed(range(fronts)):
        if parent[k] >= 0:
            above = held[parent[k]]
            some = rng.random(len(above)) < 0.6
            held[k] = held[k] + [place for place, own in zip(above, some, strict=True) if own]
    separators = np.array([len(h) for h in held]) - pivots
    above = [held[parent[k]].index(place) for k in range(fronts) for place in held[k][pivots[k] :]]
    factors, columns, owners, where, entry, row = [], [], [], [], 0, 0
    for k in range(fronts):
        for height in [len(held[k]) + 2, *rng.integers(1, 4, size=2)]:
            some = rng.permutation(len(held[k]))[: rng.integers(1, len(held[k]) + 1)]
            some = np.arange(len(held[k])) if height == len(held[k]) + 2 else some
            factors.append((height, some.size, entry, row, len(columns)))
            where.append([held[k][column] for column in some])
            columns += some.tolist()
            owners.append(k)
            entry, row = entry + height * some.size, row + height
    ends = lambda counts: np.concatenate([[0], np.cumsum(counts)])  # noqa: E731
    hanging = sorted((k for k in range(fronts) if parent[k] >= 0), key=lambda k: parent[k])
    plan = Plan(
        pivots=pivots,
        separators=separators,
        first_child=ends(np.bincount([parent[k] for k in hanging], minlength=fronts)),
        children=np.array(hanging, dtype=int),
        first_column=ends(separators),
        above=np.array(above, dtype=int),
        first_factor=ends(np.bincount(owners, minlength=fronts)),
        factors=np.array(factors),
        columns=np.array(columns),
    )
    return plan, held, where, entry, row


def dense(plan, where, entries, size):
    matrix = np.zeros((int(plan.factors[:, 0].sum()), size))
    for (height, width, entry, row, _), places in zip(plan.factors, where, strict=True):
        block = entries[entry : entry + height * width].reshape(height, width)
        matrix[row : row + height, places] = block
    return matrix


@pytest.mark.parametrize("sides", [1, 3])
@pytest.mark.parametrize(("fronts", "most"), [(1, 1), (1, 30), (2, 4), (9, 3), (25, 9), (5, 40)])
@pytest.mark.parametrize("way", ["rows", "squares"])
def test_against_dense_least_squares(sides, fronts, most, way):
    rng = np.random.default_rng(fronts * most + sides)
    plan, held, where, count, rows = drawn(rng, fronts, most)
    size = int(plan.pivots.sum())
    entries, right = rng.normal(size=count), rng.normal(size=(rows, sides))
    matrix = dense(plan, where, entries, size)
    mean, cov = np.linalg.lstsq(matrix, right, rcond=None)[0], np.linalg.inv(matrix.T @ matrix)
    solver = Solver(plan, sides)
    kept = solver.room()
    if way == "rows":
        rest, fault = solver.rows(entries, right, kept, NEGLIGIBLE)
        assert_allclose(rest, ((matrix @ mean - right) ** 2).sum(axis=0), rtol=1e-9, atol=1e-12)
    else:
        fault = solver.squares(entries, right, kept, 1e-13)
    assert fault == -1
    means, covs = np.empty((int(plan.means[-1]), sides)), np.empty(int(plan.blocks[-1]))
    magnified = solver.back(kept, means, covs)
    worst = 1.0
    for k, places in enumerate(held):
        assert_allclose(means[plan.means[k] : plan.means[k + 1]], mean[places], atol=1e-8)
        found = covs[plan.blocks[k] : plan.blocks[k + 1]].reshape(len(places), -1)
        assert_allclose(found, cov[np.ix_(places, places)], rtol=1e-7, atol=1e-10)
        own, shared = places[: plan.pivots[k]], places[plan.pivots[k] :]
        gain = cov[np.ix_(own, shared)] @ np.linalg.pinv(cov[np.ix_(shared, shared)])
        deviations = np.sqrt(np.diagonal(cov))
        summands = (np.abs(gain) @ deviations[shared]) ** 2
        worst = max(worst, (summands / np.diagonal(cov)[own]).max(initial=0.0))
    assert magnified == pytest.approx(worst, rel=1e-5)
    assert solver.log_pivots(kept) == pytest.approx(-0.5 * np.linalg.slogdet(cov)[1], abs=1e-8)


@pytest.mark.parametrize("way", ["rows", "squares"])
def test_the_front_without_a_pivot_is_told(way):
    rng = np.random.default_rng(0)
    plan, held, where, count, rows = drawn(rng, 9, 3)
    entries, right = rng.normal(size=count), rng.normal(size=(rows, 1))
    lost = held[4][0]  # a pivot of this front, which no row has
    for (height, width, entry, _, _), places in zip(plan.factors, where, strict=True):
        block = entries[entry : entry + height * width].reshape(height, width)
        block[:, [place == lost for place in places]] = 0.0
    solver = Solver(plan, 1)
    if way == "rows":
        _, fault = solver.rows(entries, right, solver.room(), NEGLIGIBLE)
    else:
        fault = solver.squares(entries, right, solver.room(), 1e-13)
    assert fault == 4
    entries[0] = np.nan
    if way == "rows":
        assert solver.rows(entries, right, solver.room(), NEGLIGIBLE)[1] == 0
    else:
        assert solver.squares(entries, right, solver.room(), 1e-13) == 0


def test_rows_of_very_different_sizes_keep_their_digits():
    """A difference read to 10⁻⁸ beside values read to 0.1, where squares lose all of it."""
    plan = Plan(
        pivots=np.array([1, 1]),
        separators=np.array([1, 0]),
        first_child=np.array([0, 0, 1]),
        children=np.array([0]),
        first_column=np.array([0, 1, 1]),
        above=np.array([0]),
        first_factor=np.array([0, 2, 3]),
        factors=np.array([[1, 2, 0, 0, 0], [1, 1, 2, 1, 2], [1, 1, 3, 2, 3]]),
        columns=np.array([0, 1, 0, 0]),
    )
    entries, right = np.array([1e8, -1e8, 10.0, 10.0]), np.array([[3e7], [1.0], [2.0]])
    solver = Solver(plan, 1)
    kept, means, covs = solver.room(), np.empty((3, 1)), np.empty(5)
    assert solver.rows(entries, right, kept, NEGLIGIBLE)[1] == -1
    solver.back(kept, means, covs)
    # With s = 10⁻¹⁶ + 0.02 the variance of the difference that the two values alone would have:
    share = 1e-16 / (1e-16 + 0.02)
    assert_allclose(means[0, 0] - means[1, 0], 0.3 + share * (-0.1 - 0.3), rtol=1e-14)
    assert_allclose(covs[4], 0.01 * (1e-16 + 0.01) / (1e-16 + 0.02), rtol=1e-14)
