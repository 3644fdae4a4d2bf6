"""The steps of a chain: one file, over every kind of numbers, against 60 digits.

Draws are well scaled: covariances A Aᵀ / n + I, of condition numbers below a hundred or so. An
error is divided by the largest entry of the result that is due, and by the condition number of what
a root is taken of.
"""

from functools import cache
from itertools import product

import mpmath
import numpy as np
import pytest
from crossed import slow_after
from mpmath import mp
from number_kinds import (
    RUNS,
    DenseRuns,
    Floats,
    InMemory,
    Lines,
    LinesOfRuns,
    OneDense,
    Packs,
    PacksInMemory,
    PacksOfTracedPairs,
    Pairs,
    PairStacks,
    Registers,
    RowsOfRuns,
    Stacks,
    Traced,
    TracedPairs,
    TracedPairStacks,
    as_tuple,
)

from pgm.kernels import step, written
from pgm.kernels.dense import Runs
from pgm.kernels.numbers import where
from pgm.linearisers import Cubature, GaussHermite, Unscented

DIGITS = 60


@pytest.fixture(autouse=True)
def many_digits():
    """All that is due is computed with 60 digits."""
    with mp.workdps(DIGITS):
        yield


# Kinds whose numbers are there one by one, kinds whose matrices have a root, and all of them: pairs
# in arrays have products and sums alone.
STRAIGHT = [Registers(), Packs(), TracedPairs(), PacksOfTracedPairs()]
LOOPS = [InMemory(), PacksInMemory()]
BY_ROWS = [Floats(), RowsOfRuns(), Lines(), LinesOfRuns(), Traced(), Pairs(), *STRAIGHT]
ONE_BY_ONE = [*BY_ROWS, *LOOPS]
WITH_ROOTS = [*ONE_BY_ONE, OneDense(), DenseRuns(), Stacks()]
EVERY = [*WITH_ROOTS, PairStacks(), TracedPairStacks()]
SEEDS = pytest.mark.parametrize("seed", slow_after(1, range(3)))


def under(kinds, *names, cases=((),), long=(), of_loops=()):
    """Run a test under some kinds of numbers, in each of some cases of other arguments.

    Straight lines of machine code take long to compile where a case is `long`: there it is slow.
    """
    quick = [*product(cases, kinds), *product(long, [k for k in kinds if k not in STRAIGHT])]
    quick += product(of_loops, LOOPS)
    slow = product(long, [kind for kind in kinds if kind in STRAIGHT])
    params = [pytest.param(kind, *case) for case, kind in quick]
    params += [pytest.param(kind, *case, marks=pytest.mark.slow) for case, kind in slow]
    return pytest.mark.parametrize(("kind", *names), params, ids=named)


def named(value):
    """The name of a kind, or a rule, in that of a test."""
    return None if isinstance(value, int | tuple | list) else type(value).__name__


def of_sizes(kinds):
    """Run a test under some kinds of numbers, of states and measurements of some sizes.

    Matrices in memory have rows of several packs too, the last of them not full.
    """
    few = [(1, 1), (2, 1), (3, 2), (2, 4)]
    return under(kinds, "size", "height", cases=few, long=[(6, 3)], of_loops=[(13, 5)])


def drawn(seed, size, height):
    """The parts m, P, F or H, a residual, and N or R, (runs, m, n) each."""
    rng = np.random.default_rng([seed, size, height])

    def covariance(n):
        root = rng.normal(size=(RUNS, n, n))
        cov = root @ root.swapaxes(-1, -2) / n + np.eye(n)
        return 0.5 * (cov + cov.swapaxes(-1, -2))

    vector = rng.normal(size=(RUNS, size, 1)), rng.normal(size=(RUNS, height, 1))
    matrix = rng.normal(size=(RUNS, height, size))
    return vector[0], covariance(size), matrix, vector[1], covariance(height)


def exact(arrays, run):
    """One run's matrix with 60 digits."""
    return mp.matrix(arrays[run].tolist())


def assert_due(kind, found, due, condition=1.0, shares=0.0):
    """The results of all runs are those due, but for rounding of the kind.

    `due` gives those of a run. Errors are shares of the largest entry, or of `shares`, one for each
    result or for all, if that is larger.
    """
    found = as_tuple(found)
    shares = shares if isinstance(shares, tuple) else (shares,) * len(found)
    for place, (part, share) in enumerate(zip(found, shares, strict=True)):
        for run, one in enumerate(kind.numbers(part)):
            wanted = as_tuple(due(run))[place]
            scale = max(max(map(abs, wanted)), mp.mpf(share))
            off = max(map(abs, one - wanted))
            assert off <= kind.digits * condition * scale, (place, mpmath.nstr(off / scale, 5))


def of_draws(due):
    """What is due of one run of a draw, from its parts, computed once for all kinds."""

    @cache
    def of_run(seed, size, height, run):
        return due(*(exact(each, run) for each in drawn(seed, size, height)))

    return lambda *draw: lambda run: of_run(*draw, run)


def condition(arrays):
    """The largest condition number of a stack."""
    return float(np.linalg.cond(arrays).max())


def single(number):
    """A number as a matrix."""
    return mp.matrix([[number]])


def trace(matrix):
    return sum(matrix[i, i] for i in range(matrix.rows))


# ---- the steps


@of_draws
def pushed(mean, cov, matrix, offset, noise):
    return matrix * mean + offset, matrix * cov * matrix.T + noise


@of_sizes(EVERY)
@SEEDS
def test_predict_and_push(kind, size, height, seed):
    def both(mean, cov, matrix, offset, noise):
        return *step.push(mean, cov, matrix, offset, noise), step.predict(cov, matrix, noise)

    found = kind.run(both, *map(kind.matrix, drawn(seed, size, height)))
    due = pushed(seed, size, height)
    assert_due(kind, found[:2], due, shares=(3.0, 0.0))
    assert_due(kind, found[2], lambda k: due(k)[1])


@cache
def any_gain(seed, size, height):
    return np.random.default_rng(seed).normal(size=(RUNS, size, height))


@cache
def squares_due(seed, size, height, run):
    parts = (*drawn(seed, size, height), any_gain(seed, size, height))
    _, cov, matrix, _, noise, gain = (exact(each, run) for each in parts)
    keep = mp.eye(size) - gain * matrix
    return keep * cov * keep.T + gain * noise * gain.T


@of_sizes(EVERY)
@SEEDS
def test_squares_of_any_gain(kind, size, height, seed):
    _, cov, matrix, _, noise = drawn(seed, size, height)
    parts = map(kind.matrix, (cov, any_gain(seed, size, height), matrix, noise))
    found = kind.run(step.squares, *parts)
    assert_due(kind, found, lambda k: squares_due(seed, size, height, k), condition=3.0)


def updated(mean, cov, matrix, residual, noise):
    """The textbook's update with inverses: mean, covariance, rᵀ S⁻¹ r and ln |S| / 2."""
    S = matrix * cov * matrix.T + noise
    gain = cov * matrix.T * S**-1
    square = residual.T * S**-1 * residual
    after = cov - gain * matrix * cov
    return mean + gain * residual, after, square, single(mp.log(mp.det(S)) / 2)


@of_draws
def update_due(mean, cov, matrix, residual, noise):
    """The update, and the least share of a pivot in its own diagonal entry."""
    S = matrix * cov * matrix.T + noise
    lower = mp.cholesky(S)
    share = min(lower[i, i] ** 2 / S[i, i] for i in range(S.rows))
    return *updated(mean, cov, matrix, residual, noise), single(share)


@of_sizes(WITH_ROOTS)
@SEEDS
def test_update_and_innovation(kind, size, height, seed):
    arrays = drawn(seed, size, height)
    _, cov, matrix, _, noise = arrays
    cost = condition(ahead(cov, matrix, noise))

    def both(mean, cov, matrix, residual, noise):
        alone = step.innovation(residual, step.predict(cov, matrix, noise))
        return *step.update(mean, cov, matrix, residual, noise), *alone

    found = kind.run(both, *map(kind.matrix, arrays))
    due = update_due(seed, size, height)
    assert_due(kind, found[:5], due, condition=cost, shares=(1.0, 1.0, 1.0, 1.0, 0.0))
    assert_due(kind, found[5:], lambda k: due(k)[2:], condition=cost, shares=(1.0, 1.0, 0.0))


@of_draws
def mild_due(mean, cov, matrix, residual, noise):
    return updated(mean, cov, matrix, residual, 8 * noise)


@under(WITH_ROOTS)
@SEEDS
def test_the_difference_is_the_sum_of_squares_where_a_measurement_is_mild(kind, seed):
    *arrays, noise = drawn(seed, 3, 2)

    def lessened(mean, cov, matrix, residual, noise):
        cross = matrix @ cov
        root = (cross.times(matrix) + noise).root()
        return tuple(step.lessened(mean, cov, residual, root, cross))[:4]

    found = kind.run(lessened, *map(kind.matrix, (*arrays, 8.0 * noise)))
    assert_due(kind, found, mild_due(seed, 3, 2), condition=30.0, shares=1.0)


def ahead(cov, matrix, noise):
    """The covariance of what is predicted, rounded to float64."""
    spread = matrix @ cov @ matrix.swapaxes(-1, -2) + noise
    return 0.5 * (spread + spread.swapaxes(-1, -2))


@cache
def reverse_due(seed, size, height, run):
    """The gain back, the mean of the rest and its covariance, of one draw; and the step back.

    That is given that the next mean is twice as large as predicted, its noise three times.
    """
    arrays = drawn(seed, size, height)
    later = exact(ahead(arrays[1], arrays[2], arrays[4]), run)
    mean, cov, matrix, offset, noise = (exact(each, run) for each in arrays)
    gain = cov * matrix.T * later**-1
    keep = mp.eye(size) - gain * matrix
    kept, own = keep * cov * keep.T, gain * noise * gain.T
    return gain, mean - gain * offset, kept + own, gain, mean + gain * offset, kept + 3 * own


@of_sizes(WITH_ROOTS)
@SEEDS
def test_reverse_and_the_step_back(kind, size, height, seed):
    mean, cov, matrix, offset, noise = drawn(seed, size, height)
    later = ahead(cov, matrix, noise)

    def each(mean, cov, matrix, noise, offset, later):
        turned = step.reverse(mean, cov, matrix, noise, offset, later)
        gain, _ = step.gain_back(cov, matrix, later)
        given = (offset + offset, noise + noise)
        known = step.back(mean, cov, matrix, noise, (offset, later), given)
        return *turned[:3], gain, *known[:2]

    found = kind.run(each, *map(kind.matrix, (mean, cov, matrix, noise, offset, later)))

    def due(k):
        return reverse_due(seed, size, height, k)

    shares = (0.0, 1.0, 0.0, 0.0, 1.0, 1.0)
    assert_due(kind, found, due, condition=condition(later), shares=shares)


@under(WITH_ROOTS, "parents", cases=[((0, 1, 2),), ((2, 0),), ((1,),)])
@SEEDS
def test_extend(kind, parents, seed):
    _, cov, matrix, _, noise = drawn(seed, 3, 2)
    matrix = matrix[..., : len(parents)]

    def due(k):
        whole, own = mp.zeros(5, 3), mp.zeros(5, 5)
        for i in range(3):
            whole[i, i] = 1
        for i in range(2):
            for place, parent in enumerate(parents):
                whole[3 + i, parent] = exact(matrix, k)[i, place]
        own[3:, 3:] = exact(noise, k)
        return whole * exact(cov, k) * whole.T + own

    parts = map(kind.matrix, (cov, matrix, noise))
    found = kind.run(lambda p, f, n: step.extend(p, parents, f, n), *parts)
    assert_due(kind, found, due)


@cache
def seen_due(first, run):
    """The update by the components that are seen; without any, what was known before."""
    known = known_of(first)[run, :, 0] > 0.5
    mean, cov, matrix, residual, noise = (each[run] for each in drawn(0, 3, 2))
    if not known.any():
        return mp.matrix(mean.tolist()), mp.matrix(cov.tolist()), single(0), single(0)
    some = mean, cov, matrix[known], residual[known], noise[known][:, known]
    return updated(*(mp.matrix(each.tolist()) for each in some))


def known_of(first):
    """Ones where a component of a run is known, (runs, 2, 1): of each run others."""
    known = np.array([(1.0, 0.0), (0.0, 1.0), (1.0, 1.0), (0.0, 0.0)])
    return np.roll(known, -first, axis=0)[:RUNS, :, None]


@under(WITH_ROOTS, "first", cases=[(0,), (1,), (2,), (3,)])
def test_components_that_are_missing_say_nothing(kind, first):
    def read(known, mean, cov, matrix, residual, noise):
        left = step.seen(kind.truths(known), residual, matrix, noise)
        return tuple(step.update(mean, cov, left.matrix, left.residual, left.noise))[:4]

    found = kind.run(read, *map(kind.matrix, (known_of(first), *drawn(0, 3, 2))))
    assert_due(kind, found, lambda k: seen_due(first, k), condition=30.0, shares=1.0)


@under(ONE_BY_ONE)
def test_the_nearest_branch_of_an_angle(kind):
    readings = [0.1, 3.0, -3.1, 9.0, -40.0, 3.1, 1e3]
    values = [0.2, -3.0, 3.1, 0.0, 1.0, 0.0, -2.0]
    pairs = np.stack([readings, values], axis=-1)
    parts = kind.matrix(np.broadcast_to(pairs, (RUNS, 7, 2)))

    def branches(both):
        return tuple(step.nearest(both[i, 0], both[i, 1]) for i in range(both.shape[0]))

    found = kind.run(branches, parts)
    turn = mp.mpf(step.TURN)

    def due(_):
        moved = [mp.mpf(r) - turn * mp.nint((mp.mpf(r) - mp.mpf(v)) / turn) for r, v in pairs]
        return tuple(map(single, moved))

    assert_due(kind, found, due, condition=20.0, shares=3.0)


RULES = [Unscented(), Cubature(), GaussHermite(3)]


def rule_of(points):
    """The matrices of `step.Rule`, as arrays (m, n)."""
    *known, signs = (None if each is None else each.array for each in points.fit)
    if not len(known[2]):  # a line passes through all points
        return *known[:2], np.zeros((1, len(points.points))), np.eye(1)
    return *known, np.eye(len(known[2])) if signs is None else signs


@cache
def regress_due(rule, size, run):
    mean, slopes, rest, sign = (mp.matrix(x.tolist()) for x in rule_of(rule.points(size, "x", 0)))
    y = exact(values_of(rule, size), run)
    slope = (slopes * y).T * mp.cholesky(exact(drawn(1, size, 1)[1], run)) ** -1
    return slope, (mean * y).T, (rest * y).T * sign * (rest * y)


def values_of(rule, size):
    """The values of a function at a rule's points."""
    count = len(rule.points(size, "x", 0).points)
    return np.random.default_rng(size).normal(size=(RUNS, count, 2))


@under(
    WITH_ROOTS,
    "rule",
    "size",
    cases=[*product(RULES, (1, 2)), *product(RULES[:2], (3,))],
    long=[(RULES[2], 3)],
)
def test_regress(kind, rule, size):
    points = rule.points(size, "x", 0)
    _, cov, *_ = drawn(1, size, 1)
    fixed = [np.broadcast_to(each, (RUNS, *each.shape)).copy() for each in rule_of(points)]

    def line(cov, values, *rule):
        return tuple(step.regress(cov.root(), step.Rule(*rule), values))[:3]

    found = kind.run(line, *map(kind.matrix, (cov, values_of(rule, size), *fixed)))
    cost = condition(cov) * max(float(np.abs(points.cov_weights).sum()), 1.0)
    assert_due(kind, found, lambda k: regress_due(rule, size, k), condition=cost, shares=1.0)


@of_draws
def squares_of_weights(mean, cov, matrix, residual, noise):
    plain = residual.T * noise**-1 * residual
    return plain, plain + single(trace(noise**-1 * matrix * cov * matrix.T))


@of_sizes(WITH_ROOTS)
@SEEDS
def test_the_square_of_robust_weights(kind, size, height, seed):
    _, cov, matrix, residual, noise = drawn(seed, size, height)

    def both(residual, noise, matrix, cov):
        root = noise.root()
        plain = step.whitened(residual, root).square
        return plain, step.whitened(residual, root, matrix, cov).square

    found = kind.run(both, *map(kind.matrix, (residual, noise, matrix, cov)))
    due = squares_of_weights(seed, size, height)
    assert_due(kind, found, due, condition=condition(noise))


WEIGHT = 0.3


@of_sizes(WITH_ROOTS)
@SEEDS
def test_the_square_by_the_belief_that_has_taken_in_its_measurement(kind, size, height, seed):
    """That of its mean, and those that are expected, without an error of the line and with one."""
    _, cov, matrix, residual, noise = drawn(seed, size, height)

    def every(residual, noise, matrix, cov, error):
        root = noise.root()
        exact = step.whitened(residual, root, matrix, cov)
        curved = step.whitened(residual, root, matrix, cov, error)
        given = (exact, False), (exact, True), (curved, True)
        return tuple(
            step.reweighed(each, WEIGHT, expects=expects).square for each, expects in given
        )

    error = error_of(seed, size, height)
    found = kind.run(every, *map(kind.matrix, (residual, noise, matrix, cov, error)))
    spread = matrix @ cov @ matrix.swapaxes(-1, -2) + noise
    cost = condition(noise) * condition(spread)
    assert_due(kind, found, lambda k: squares_after(seed, size, height, k), condition=cost)


def error_of(seed, size, height):
    """The covariances of a line's error."""
    return drawn(seed + 7, size, height)[4]


@cache
def squares_after(seed, size, height, run):
    parts = (*drawn(seed, size, height)[1:], error_of(seed, size, height))
    cov, matrix, residual, noise, error = (exact(each, run) for each in parts)
    spread, zero = matrix * cov * matrix.T, mp.zeros(height)

    def square(error, expects):
        keep = mp.eye(height) - spread * (spread + error + noise / mp.mpf(WEIGHT)) ** -1
        left = keep * residual
        open_ = trace(noise**-1 * (keep * spread + error)) if expects else 0
        return left.T * noise**-1 * left + single(open_)

    return square(zero, False), square(zero, True), square(error, True)


@under([kind for kind in WITH_ROOTS if not isinstance(kind, OneDense)])
def test_the_least_open_share_and_inflation(kind):
    """Of a covariance; shares of one with a component without a variance, and of an indefinite."""
    if isinstance(kind, Lines | LinesOfRuns):
        pytest.skip("inflation is not written as lines of Python")
    _, cov, *_ = drawn(0, 4, 1)
    gap, indefinite, others = cov.copy(), cov.copy(), [0, 2, 3]
    gap[:, 1], gap[:, :, 1] = 0.0, 0.0
    indefinite[:, 2, 2] = -3.0

    def told(cov, *more):
        shares = [kind.open_share(each) for each in (cov, *more)]
        return *shares, step.inflation(cov, cov.root())

    found = kind.run(told, *map(kind.matrix, (cov, gap, indefinite)))

    def due(k):
        given = cov, cov[:, others][..., others], indefinite
        shares = (open_share_due(exact(each, k)) for each in given)
        whole = exact(cov, k)
        factors = ((whole**-1)[i, i] * whole[i, i] for i in range(4))
        return *map(single, shares), single(sum(factors))

    assert_due(kind, found, due, condition=condition(cov))


def open_share_due(cov):
    """The least share of a variance in leading components: |P₁..ᵢ| / (|P₁..ᵢ₋₁| |Pᵢᵢ|)."""
    size = range(cov.rows)
    leading = [mp.mpf(1), *(mp.det(cov[: i + 1, : i + 1]) for i in size)]
    least = min(leading[i + 1] / leading[i] / abs(cov[i, i]) for i in size)
    return max(least, mp.mpf(0))


INDEFINITE = [[[-1.0]], [[0.0]], [[1.0, 2.0], [2.0, 1.0]], [[2.0, 0.0], [0.0, -1.0]]]


@under(ONE_BY_ONE, "matrix", cases=[(matrix,) for matrix in INDEFINITE])
def test_what_is_not_definite_has_no_share(kind, matrix):
    if isinstance(kind, Lines):
        pytest.skip("has no root at all")
    arrays = np.broadcast_to(np.array(matrix), (RUNS, len(matrix), len(matrix)))
    with np.errstate(all="ignore"):
        (share, *_) = kind.numbers(kind.run(lambda a: a.root().share, kind.matrix(arrays)))
    assert not share[0] > 1e-13


def test_lines_tell_equal_numbers():
    told = written.function({"a": (1,)}, lambda a: ([where(a[0, 0] == 2.0, 1.0, a[0, 0])], True))
    assert [told(np.array([x])) for x in (2.0, 3.0)] == [1.0, 3.0]


def test_lines_of_what_is_not_definite_return_nothing():
    read = written.function({"a": (2, 2)}, lambda a: ([a.root().share], True))
    assert read(np.eye(2)) == 1.0
    assert read(-np.eye(2)) is None
    assert read(np.zeros((2, 2))) is None


def test_lines_run_by_run():
    """Of runs that have one argument in common; none where one of them has no root."""

    def body(a, b):
        root = a.root()
        return [root.solve(b).columns[0], root.matrix, root.volume], root.share > 1e-6

    found = written.each({"a": (2, 2), "b": (2,)}, body)
    rng = np.random.default_rng(0)
    factor, b = rng.normal(size=(3, 2, 2)), rng.normal(size=(2, 3))
    a = np.moveaxis(factor @ factor.swapaxes(1, 2) + np.eye(2), 0, -1)
    for shared in (b, b[:, :1]):
        solved, roots, volumes = found(a, shared)
        assert (solved.shape, roots.shape, volumes.shape) == ((2, 3), (2, 2, 3), (3,))
        for run in range(3):
            lower = np.linalg.cholesky(a[..., run])
            due = np.linalg.solve(lower, shared[:, min(run, shared.shape[1] - 1)])
            np.testing.assert_allclose(solved[:, run], due, atol=1e-14)
            np.testing.assert_allclose(roots[..., run], lower, atol=1e-14)
            np.testing.assert_allclose(volumes[run], np.log(np.diag(lower)).sum(), atol=1e-14)
    for bad in (-np.eye(2), np.ones((2, 2)) + 1e-9 * np.eye(2)):
        a[..., 1] = bad
        assert found(a, b) is None


def test_one_matrix_for_runs_along_two_axes():
    rng = np.random.default_rng(0)
    many, one = rng.normal(size=(3, 2, 4, 5)), rng.normal(size=(3, 2))
    for_all = Runs(one[..., None])
    product, times = Runs(many) @ for_all.T, Runs(many).times(for_all)
    for place in np.ndindex(4, 5):
        due = many[(..., *place)] @ one.T
        np.testing.assert_allclose(product.array[(..., *place)], due, atol=1e-14)
        np.testing.assert_allclose(np.tril(times.array[(..., *place)]), np.tril(due), atol=1e-14)
