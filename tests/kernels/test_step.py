"""The steps of a chain: one file, over every kind of numbers, against 60 digits.

Draws are well scaled: covariances A Aᵀ / n + I, of condition numbers below a hundred or so. An
error is divided by the largest entry of the result that is due, and by the condition number of what
a root is taken of.
"""

from functools import cache

import mpmath
import numpy as np
import pytest
from crossed import slow_after
from mpmath import mp

from pgm.kernels import step, written
from pgm.kernels.dense import Dense, Runs, Stack
from pgm.kernels.extended import Twofold
from pgm.kernels.numbers import Matrix
from pgm.linearisers import Cubature, GaussHermite, Unscented
from pgm.tracing.traced import Node, Recorder

RUNS = 3
DIGITS = 60


@pytest.fixture(autouse=True)
def many_digits():
    """All that is due is computed with 60 digits."""
    with mp.workdps(DIGITS):
        yield


# ---- the kinds: from arrays (runs, m, n) of float64, with the matrix of run 0 and back to (m, n)


class Floats:
    """Lists of floats."""

    digits = 1e-14

    def matrix(self, arrays):
        return Matrix(arrays[0].tolist())

    def root(self, arrays):
        return self.matrix(arrays).root()

    def run(self, function, *arguments):
        return function(*arguments)

    def numbers(self, found):
        """Numbers of 60 digits, of each run."""
        rows = found.rows if isinstance(found, Matrix) else [[found]]
        return [mp.matrix([[self.number(x) for x in row] for row in rows])]

    def number(self, x):
        return mp.mpf(float(x))


class RowsOfRuns(Floats):
    """Matrices of arrays, each a row of runs."""

    def matrix(self, arrays):
        return Matrix([list(row) for row in np.moveaxis(arrays, 0, -1)])

    def numbers(self, found):
        rows = found.rows if isinstance(found, Matrix) else [[found]]
        whole = np.array([[np.broadcast_to(x, RUNS) for x in row] for row in rows])
        return [mp.matrix(whole[..., k].tolist()) for k in range(RUNS)]


class OneDense(Floats):
    """One array, by BLAS and LAPACK."""

    def matrix(self, arrays):
        return Dense(arrays[0])

    def numbers(self, found):
        return [mp.matrix(np.atleast_2d(getattr(found, "array", found)).tolist())]


class DenseRuns(Floats):
    """Arrays with the runs last."""

    def matrix(self, arrays):
        return Runs(np.ascontiguousarray(np.moveaxis(arrays, 0, -1)))

    def numbers(self, found):
        whole = found.array if isinstance(found, Runs) else np.asarray(found)[None, None]
        whole = np.broadcast_to(whole, (*whole.shape[:2], RUNS))
        return [mp.matrix(whole[..., k].tolist()) for k in range(RUNS)]


class Stacks(Floats):
    """Arrays with the runs first."""

    def matrix(self, arrays):
        return Stack(arrays)

    def numbers(self, found):
        whole = found.array if isinstance(found, Stack) else np.asarray(found)[..., None, None]
        whole = np.broadcast_to(whole, (RUNS, *whole.shape[-2:]))
        return [mp.matrix(each.tolist()) for each in whole]


class Lines(Floats):
    """Lines of Python, which are compiled and called."""

    def run(self, function, *arguments):
        shapes, values, flat = {}, {}, [each for each in arguments if isinstance(each, Matrix)]
        for k, each in enumerate(flat):
            shapes[f"a{k}_"] = each.shape
            values[f"a{k}_"] = np.array(each.rows)
        kept, along = [], isinstance(self, LinesOfRuns)

        def body(*matrices):
            left = iter(matrices)
            found = function(*(next(left) if isinstance(a, Matrix) else a for a in arguments))
            kept.extend(found if isinstance(found, tuple) else [found])
            every = [x for part in kept for row in rows_of(part) for x in row]
            return every, True

        numbers = written.function(shapes, body, along_runs=along)(**values)
        return back(kept, iter(numbers if isinstance(numbers, tuple) else (numbers,)))


class LinesOfRuns(RowsOfRuns):
    """Lines of Python over rows of runs."""

    run = Lines.run


class Traced(Floats):
    """Traced numbers, whose graph is evaluated."""

    def run(self, function, *arguments):
        graph, values = Recorder(), []

        def read(number):
            values.append(number)
            return Node(graph, graph.input(0, len(values) - 1))

        traced = [
            Matrix([[read(x) for x in row] for row in each.rows])
            if isinstance(each, Matrix)
            else each
            for each in arguments
        ]
        found = function(*traced)
        kept = list(found) if isinstance(found, tuple) else [found]
        known = evaluated(graph, values)
        every = [
            known[x.number] if isinstance(x, Node) else x
            for part in kept
            for row in rows_of(part)
            for x in row
        ]
        return back(kept, iter(every))


class Pairs(Floats):
    """Numbers of twice the digits, of many runs."""

    digits = 1e-30

    def matrix(self, arrays):
        rows = np.moveaxis(arrays, 0, -1)
        return Matrix([[Twofold(x.copy()) for x in row] for row in rows])

    def numbers(self, found):
        rows = found.rows if isinstance(found, Matrix) else [[found]]
        return [mp.matrix([[self.number(x, k) for x in row] for row in rows]) for k in range(RUNS)]

    def number(self, x, k):
        if not isinstance(x, Twofold):
            return mp.mpf(float(np.broadcast_to(x, RUNS)[k]))
        return mp.mpf(float(x.hi[k])) + mp.mpf(float(x.lo[k]))


def rows_of(part):
    return part.rows if isinstance(part, Matrix) else [[part]]


def back(kept, numbers):
    """Results in the shape of those kept, of these numbers."""
    found = [
        Matrix([[next(numbers) for _ in row] for row in part.rows])
        if isinstance(part, Matrix)
        else next(numbers)
        for part in kept
    ]
    return tuple(found) if len(found) > 1 else found[0]


def evaluated(graph, values):
    """The values of all nodes of a graph."""
    known = []
    for name, *operands in graph.operations:
        if name == "constant":
            known.append(operands[0])
        elif name == "input":
            known.append(values[operands[1]])
        else:
            known.append(getattr(np, name)(*(known[k] for k in operands)))
    return known


SINGLE = [Floats(), RowsOfRuns(), Lines(), LinesOfRuns(), Traced(), Pairs()]
ARRAYS = [OneDense(), DenseRuns(), Stacks()]
KINDS = pytest.mark.parametrize("kind", [*SINGLE, *ARRAYS], ids=lambda kind: type(kind).__name__)
ONE_BY_ONE = pytest.mark.parametrize("kind", SINGLE, ids=lambda kind: type(kind).__name__)
SIZES = pytest.mark.parametrize(("size", "height"), [(1, 1), (2, 1), (3, 2), (2, 4), (6, 3)])
SEEDS = pytest.mark.parametrize("seed", slow_after(1, range(3)))


def drawn(seed, size, height):
    """The parts m, P, F or H, a residual, N or R and another mean, (runs, m, n) each."""
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


def assert_due(kind, found, due, condition=1.0, share=0.0):
    """The results of all runs are those due, but for rounding of the kind."""
    for run, one in enumerate(kind.numbers(found)):
        wanted = due(run)
        scale = max(max(map(abs, wanted)), mp.mpf(share))
        off = max(map(abs, one - wanted))
        assert off <= kind.digits * condition * scale, mpmath.nstr(off / scale, 5)


def condition(arrays):
    """The largest condition number of a stack."""
    return float(np.linalg.cond(arrays).max())


def identity(size):
    return mp.eye(size)


def updated(mean, cov, matrix, residual, noise):
    """The textbook's update with inverses: mean, covariance, rᵀ S⁻¹ r and ln |S| / 2."""
    S = matrix * cov * matrix.T + noise
    gain = cov * matrix.T * S**-1
    square = residual.T * S**-1 * residual
    after = cov - gain * matrix * cov
    return mean + gain * residual, after, square, mp.matrix([[mp.log(mp.det(S)) / 2]])


# ---- the steps


@KINDS
@SIZES
@SEEDS
def test_predict_and_push(kind, size, height, seed):
    mean, cov, matrix, offset, noise = drawn(seed, size, height)
    parts = [kind.matrix(each) for each in (mean, cov, matrix, offset, noise)]

    def spread(k):
        return exact(matrix, k) * exact(cov, k) * exact(matrix, k).T + exact(noise, k)

    assert_due(kind, kind.run(step.predict, parts[1], parts[2], parts[4]), spread)
    found = kind.run(step.push, *parts)

    def moved(k):
        return exact(matrix, k) * exact(mean, k) + exact(offset, k)

    assert_due(kind, found[0], moved, share=3.0)
    assert_due(kind, found[1], spread)


@KINDS
@SIZES
@SEEDS
def test_squares_of_any_gain(kind, size, height, seed):
    _, cov, matrix, _, noise = drawn(seed, size, height)
    gain = np.random.default_rng(seed).normal(size=(RUNS, size, height))

    def due(k):
        keep = identity(size) - exact(gain, k) * exact(matrix, k)
        own = exact(gain, k) * exact(noise, k) * exact(gain, k).T
        return keep * exact(cov, k) * keep.T + own

    parts = [kind.matrix(each) for each in (cov, gain, matrix, noise)]
    assert_due(kind, kind.run(step.squares, *parts), due, condition=3.0)


@KINDS
@SIZES
@SEEDS
def test_update(kind, size, height, seed):
    arrays = drawn(seed, size, height)
    _, cov, matrix, _, noise = arrays
    cost = condition(matrix @ cov @ matrix.swapaxes(-1, -2) + noise)
    found = kind.run(step.update, *(kind.matrix(each) for each in arrays))
    for place in range(4):

        def due(k, place=place):
            return update_due(seed, size, height, k)[place]

        assert_due(kind, found[place], due, condition=cost, share=1.0)
    assert_due(kind, found[4], lambda k: share_due(seed, size, height, k), condition=cost)


@cache
def update_due(seed, size, height, run):
    """The textbook's update of one draw, computed once for all kinds."""
    return updated(*(exact(each, run) for each in drawn(seed, size, height)))


@cache
def share_due(seed, size, height, run):
    """The least share of a pivot in its own diagonal entry."""
    _, cov, matrix, _, noise = (exact(each, run) for each in drawn(seed, size, height))
    S = matrix * cov * matrix.T + noise
    lower = mp.cholesky(S)
    return mp.matrix([[min(lower[i, i] ** 2 / S[i, i] for i in range(height))]])


@KINDS
@SEEDS
def test_the_difference_is_the_sum_of_squares_where_a_measurement_is_mild(kind, seed):
    arrays = drawn(seed, 3, 2)
    arrays = (*arrays[:4], 9.0 * arrays[4])

    def lessened(mean, cov, matrix, residual, noise):
        cross = matrix @ cov
        root = (cross.times(matrix) + noise).root()
        return tuple(step.lessened(mean, cov, residual, root, cross))[:4]

    found = kind.run(lessened, *(kind.matrix(each) for each in arrays))
    for place in range(4):

        def due(k, place=place):
            return updated(*(exact(each, k) for each in arrays))[place]

        assert_due(kind, found[place], due, condition=30.0, share=1.0)


@KINDS
@SIZES
@SEEDS
def test_reverse_and_the_step_back(kind, size, height, seed):
    mean, cov, matrix, offset, noise = drawn(seed, size, height)
    later = ahead(cov, matrix, noise)
    cost = condition(later)
    parts = [kind.matrix(each) for each in (mean, cov, matrix, noise, offset, later)]
    found = kind.run(lambda *given: step.reverse(*given)[:3], *parts)
    back_ = kind.run(lambda *given: step.gain_back(*given)[0], parts[1], parts[2], parts[5])
    for place, one in enumerate((*found[:3], back_)):

        def due(k, place=place % 3):
            return reverse_due(seed, size, height, k)[place]

        assert_due(kind, one, due, condition=cost, share=1.0 if place == 1 else 0.0)

    def known(m, p, f, n, q, spread):
        return step.back(m, p, f, n, (q, spread), (q + q, n + n))[:2]

    for place, one in enumerate(kind.run(known, *parts)):

        def due(k, place=place):
            return back_due(seed, size, height, k)[place]

        assert_due(kind, one, due, condition=cost, share=1.0)


def ahead(cov, matrix, noise):
    """The covariance of what is predicted, rounded to float64."""
    spread = matrix @ cov @ matrix.swapaxes(-1, -2) + noise
    return 0.5 * (spread + spread.swapaxes(-1, -2))


@cache
def reverse_due(seed, size, height, run):
    """The gain back, the mean of the rest and its covariance, of one draw."""
    mean, cov, matrix, offset, noise = drawn(seed, size, height)
    later = exact(ahead(cov, matrix, noise), run)
    parts = (exact(each, run) for each in (mean, cov, matrix, offset, noise))
    mean, cov, matrix, offset, noise = parts
    gain = cov * matrix.T * later**-1
    keep = identity(size) - gain * matrix
    return gain, mean - gain * offset, keep * cov * keep.T + gain * noise * gain.T


def back_due(seed, size, height, run):
    """The belief given that the next mean is twice as large as predicted, its noise three times."""
    mean, cov, matrix, offset, noise = (exact(each, run) for each in drawn(seed, size, height))
    gain = reverse_due(seed, size, height, run)[0]
    keep = identity(size) - gain * matrix
    return mean + gain * offset, keep * cov * keep.T + 3 * gain * noise * gain.T


@KINDS
@SEEDS
@pytest.mark.parametrize("parents", [(0, 1, 2), (2, 0), (1,)])
def test_extend(kind, parents, seed):
    _, cov, matrix, _, noise = drawn(seed, 3, 2)
    matrix = matrix[..., : len(parents)]

    def due(k):
        wide = mp.zeros(2, 3)
        for i in range(2):
            for place, parent in enumerate(parents):
                wide[i, parent] = exact(matrix, k)[i, place]
        whole, own = mp.zeros(5, 3), mp.zeros(5, 5)
        for i in range(3):
            whole[i, i] = 1
        whole[3:, :] = wide
        own[3:, 3:] = exact(noise, k)
        return whole * exact(cov, k) * whole.T + own

    parts = [kind.matrix(each) for each in (cov, matrix, noise)]
    found = kind.run(lambda p, f, n: step.extend(p, parents, f, n), *parts)
    assert_due(kind, found, due)


@ONE_BY_ONE
@pytest.mark.parametrize("known", [(True, False), (False, True), (True, True), (False, False)])
def test_components_that_are_missing_say_nothing(kind, known):
    arrays = drawn(0, 3, 2)
    seen = [k for k in range(2) if known[k]]

    def read(mean, cov, matrix, residual, noise):
        left = step.seen(known, residual, matrix, noise)
        return tuple(step.update(mean, cov, left.matrix, left.residual, left.noise))[:4]

    found = kind.run(read, *(kind.matrix(each) for each in arrays))

    def due(k, place):
        mean, cov, matrix, residual, noise = arrays
        if not seen:
            return (exact(mean, k), exact(cov, k), mp.matrix([[0]]), mp.matrix([[0]]))[place]
        some = matrix[:, seen], residual[:, seen], noise[:, seen][..., seen]
        return updated(exact(mean, k), exact(cov, k), *(exact(each, k) for each in some))[place]

    for place in range(4):
        assert_due(kind, found[place], lambda k, p=place: due(k, p), condition=30.0, share=1.0)


@ONE_BY_ONE
def test_the_nearest_branch_of_an_angle(kind):
    readings = [0.1, 3.0, -3.1, 9.0, -40.0, 3.1, 1e3]
    values = [0.2, -3.0, 3.1, 0.0, 1.0, 0.0, -2.0]
    pairs = np.stack([readings, values], axis=-1)
    parts = kind.matrix(np.broadcast_to(pairs, (RUNS, 7, 2)))

    def branches(both):
        return Matrix.column(step.nearest(*row) for row in both.rows)

    found = kind.run(branches, parts)
    turn = mp.mpf(step.TURN)

    def due(_):
        moved = [mp.mpf(r) - turn * mp.nint((mp.mpf(r) - mp.mpf(v)) / turn) for r, v in pairs]
        return mp.matrix(moved)

    assert_due(kind, found, due, condition=20.0)


RULES = [Unscented(), Cubature(), GaussHermite(3)]


@KINDS
@pytest.mark.parametrize("rule", RULES, ids=lambda rule: type(rule).__name__)
@pytest.mark.parametrize("size", [1, 2, 3])
def test_regress(kind, rule, size):
    points = rule.points(size, "x", 0)
    _, cov, _, _, _ = drawn(1, size, 1)
    count = len(points.points)
    values = np.random.default_rng(size).normal(size=(RUNS, count, 2))
    *known, signs = (None if each is None else each.array for each in points.fit)
    known.append(np.eye(count - 1 - size) if signs is None else signs)
    if not len(known[2]):  # a line passes through all points
        known[2:] = np.zeros((1, count)), np.eye(1)
    fixed = [kind.matrix(np.broadcast_to(each, (RUNS, *each.shape)).copy()) for each in known]

    def line(cov, values, *rule):
        return tuple(step.regress(cov.root(), step.Rule(*rule), values))[:3]

    found = kind.run(line, kind.matrix(cov), kind.matrix(values), *fixed)
    mean, slopes, rest, sign = (mp.matrix(each.tolist()) for each in known)

    def due(k, place):
        y = exact(values, k)
        slope = (slopes * y).T * mp.cholesky(exact(cov, k)) ** -1
        return (slope, (mean * y).T, (rest * y).T * sign * (rest * y))[place]

    cost = condition(cov) * max(float(np.abs(points.cov_weights).sum()), 1.0)
    for place in range(3):
        assert_due(kind, found[place], lambda k, p=place: due(k, p), condition=cost, share=1.0)


@KINDS
@SIZES
@SEEDS
def test_the_square_of_robust_weights(kind, size, height, seed):
    _, cov, matrix, residual, noise = drawn(seed, size, height)
    parts = [kind.matrix(each) for each in (residual, noise, matrix, cov)]
    cost = condition(noise)

    def plain(k):
        return exact(residual, k).T * exact(noise, k) ** -1 * exact(residual, k)

    def expected(k):
        spread = exact(matrix, k) * exact(cov, k) * exact(matrix, k).T
        inside = exact(noise, k) ** -1 * spread
        return plain(k) + mp.matrix([[sum(inside[i, i] for i in range(height))]])

    assert_due(kind, kind.run(step.weighed_square, *parts[:2]), plain, condition=cost)
    assert_due(kind, kind.run(step.weighed_square, *parts), expected, condition=cost)


@KINDS
@SIZES
@SEEDS
@pytest.mark.parametrize("expects", [False, True])
def test_the_square_by_the_belief_that_has_taken_in_its_measurement(
    kind, size, height, seed, expects
):
    _, cov, matrix, residual, noise = drawn(seed, size, height)
    error, weight = drawn(seed + 7, size, height)[4], 0.3
    arrays = (residual, noise, matrix, cov, error)[: 5 if expects else 4]

    def square(*parts):
        return step.reweighed(step.whitened(*parts), weight, expects=expects).square

    @cache
    def due(k):
        r, R, H, P, *more = (exact(each, k) for each in arrays)
        omega = more[0] if more else mp.zeros(height)
        spread = H * P * H.T
        keep = identity(height) - spread * (spread + omega + R / mp.mpf(weight)) ** -1
        left = R**-1 * (keep * spread + omega)
        trace = sum(left[i, i] for i in range(height)) if expects else 0
        return (keep * r).T * R**-1 * (keep * r) + mp.matrix([[trace]])

    cost = condition(noise) * condition(matrix @ cov @ matrix.swapaxes(-1, -2) + noise)
    found = kind.run(square, *(kind.matrix(each) for each in arrays))
    assert_due(kind, found, due, condition=cost)


@ONE_BY_ONE
@pytest.mark.parametrize(
    "matrix", [[[-1.0]], [[0.0]], [[1.0, 2.0], [2.0, 1.0]], [[2.0, 0.0], [0.0, -1.0]]]
)
def test_what_is_not_definite_has_no_share(kind, matrix):
    if isinstance(kind, Lines):
        pytest.skip("has no root at all")
    arrays = np.broadcast_to(np.array(matrix), (RUNS, len(matrix), len(matrix)))
    with np.errstate(all="ignore"):
        (share, *_) = kind.numbers(kind.run(lambda a: a.root().share, kind.matrix(arrays)))
    assert not share[0] > 1e-13


def test_lines_of_what_is_not_definite_return_nothing():
    read = written.function({"a": (2, 2)}, lambda a: ([a.root().share], True))
    assert read(np.eye(2)) == 1.0
    assert read(-np.eye(2)) is None
    assert read(np.zeros((2, 2))) is None


def test_one_matrix_for_runs_along_two_axes():
    rng = np.random.default_rng(0)
    many, one = rng.normal(size=(3, 2, 4, 5)), rng.normal(size=(3, 2))
    for_all = Runs(one[..., None])
    product, times = Runs(many) @ for_all.T, Runs(many).times(for_all)
    for place in np.ndindex(4, 5):
        due = many[(..., *place)] @ one.T
        np.testing.assert_allclose(product.array[(..., *place)], due, atol=1e-14)
        np.testing.assert_allclose(np.tril(times.array[(..., *place)]), np.tril(due), atol=1e-14)
