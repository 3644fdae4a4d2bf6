"""Gaussians in moment form, one and a batch, against conditioning in rational numbers."""

from fractions import Fraction

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from pgm.kernels import gaussian
from tests.dense import random_covariance

# Of one Gaussian the first of these are written out number by number, the others go to LAPACK.
SMALL = [(1, 1), (1, 4), (2, 1), (2, 2), (3, 1), (3, 2), (3, 3), (4, 2), (5, 1)]
LARGE = [(7, 3), (2, 9), (6, 4), (1, 12)]
sizes = pytest.mark.parametrize(("size", "height"), SMALL + LARGE)
batches = pytest.mark.parametrize("batch", [(), (1,), (5,), (20,), (40,)], ids=repr)
F = np.vectorize(Fraction, otypes=[object])


def exactly(mean, cov, matrix, residual, noise):
    """Condition on one component of the reading after another, in rational numbers.

    Returns the mean, the covariance, the log-density, and how far off what is determined is.
    """
    size, matrix = len(mean), F(matrix)
    whole = np.vstack([np.eye(size, dtype=int), matrix])
    spread = whole @ F(cov) @ whole.T
    spread[size:, size:] += F(noise)
    moved, log_density, left = (
        F(np.concatenate([mean, 0.0 * residual])),
        0.0,
        np.zeros(len(residual)),
    )
    for k, due in enumerate(F(residual)):
        variance, off = spread[size + k, size + k], due - moved[size + k]
        if variance == 0:
            left[k] = abs(float(off))
            continue
        column = spread[:, size + k].copy()
        moved = moved + column * (off / variance)
        spread = spread - np.outer(column, column / variance)
        log_density -= 0.5 * (float(off**2 / variance) + np.log(2 * np.pi * float(variance)))
    return moved[:size].astype(float), spread[:size, :size].astype(float), log_density, left


def drawn(batch, size, height, seed=0):
    """A belief, H, a residual and a noise, components first."""
    rng = np.random.default_rng(10 * size + height + seed)

    def covariance(n):
        found = random_covariance(rng, n, lead=batch) + 0.1 * np.eye(n)
        return np.moveaxis(0.5 * (found + found.swapaxes(-1, -2)), (-2, -1), (0, 1))

    return (
        rng.normal(size=(size, *batch)),
        covariance(size),
        rng.normal(size=(height, size, *batch)),
        rng.normal(size=(height, *batch)),
        covariance(height),
    )


def each(batch):
    """Some places of a batch."""
    return [()] if batch == () else [(0,), (batch[0] - 1,)]


def at(array, own, run):
    """One of a batch, or the one for all."""
    if array.ndim == own or not run:
        return array
    return array[..., min(run[0], array.shape[-1] - 1)]


def predictive(arguments, run):
    """S = H P Hᵀ + noise in units of its own deviations."""
    _, cov, matrix, _, noise = arguments
    cov, matrix, noise = (at(part, 2, run) for part in (cov, matrix, noise))
    spread = matrix @ cov @ matrix.T + noise
    std = np.sqrt(np.diag(spread))
    return spread / np.outer(std, std)


def share_left(arguments, batch):
    """The smallest share of a component of the readings that those before it leave open."""
    every = np.ndindex(*batch)
    return min(np.diag(np.linalg.cholesky(predictive(arguments, run))).min() for run in every) ** 2


def assert_conditioned(found, arguments, batch):
    """Each of a batch, to the digits that S leaves; its covariance exactly symmetric."""
    size = len(arguments[0])
    assert found.mean.shape == (size, *batch)
    assert found.cov.shape == (size, size, *batch)
    assert np.shape(found.log_density) == batch
    assert_array_equal(found.cov, found.cov.swapaxes(0, 1))
    for run in each(batch):
        parts = [at(part, own, run) for part, own in zip(arguments, (1, 2, 2, 1, 2), strict=True)]
        mean, cov, log_density, left = exactly(*parts)
        std = np.sqrt(np.diag(cov))
        unit = np.where(std > 0.0, std, 1.0)
        # What S costs, and how far deviations fall.
        fall = np.where(std > 0.0, np.sqrt(np.diag(parts[1])) / unit, 1.0).max()
        digits = 1e-12 + 2e-15 * fall * np.linalg.cond(predictive(arguments, run))
        off = found.mean[(slice(None), *run)] - mean
        assert_allclose(off / np.maximum(unit, np.abs(mean - parts[0])), 0.0, atol=digits)
        off = found.cov[(slice(None), slice(None), *run)] - cov
        assert_allclose(off / np.outer(unit, unit), 0.0, atol=digits)
        assert_allclose(np.asarray(found.log_density)[run], log_density, rtol=digits, atol=digits)
        if found.left is None:
            assert not left.any()
        else:
            assert_allclose(found.left[(slice(None), *run)], left, atol=1e-12)


# ---- updates


@pytest.mark.parametrize("noises", [(1.0, 1.0), (1.0, 1e-4), (1e-4, 1e-4)])
def test_updates_of_two_runs_of_which_measurements_are_mild_or_not(noises):
    """Mild ones are differences of covariances, and others are sums of squares."""
    mean, cov, matrix, residual, noise = drawn((2,), 4, 2)
    arguments = mean, cov, matrix, residual, noise * np.array(noises)
    assert_conditioned(gaussian.update(*arguments), arguments, (2,))


@sizes
@batches
def test_an_update(size, height, batch):
    arguments = drawn(batch, size, height)
    found = gaussian.update(*arguments)
    assert found.regular
    assert found.left is None
    assert found.mean.dtype == found.cov.dtype == np.float64
    assert_conditioned(found, arguments, batch)


@pytest.mark.parametrize(("size", "height"), [(3, 2), (7, 3)])
@pytest.mark.parametrize("shared", ["matrix", "noise", "both"])
def test_one_matrix_and_one_noise_may_serve_a_batch(size, height, shared):
    mean, cov, matrix, residual, noise = drawn((40,), size, height)
    if shared != "noise":
        matrix = matrix[..., :1]
    if shared != "matrix":
        noise = noise[..., :1]
    arguments = mean, cov, matrix, residual, noise
    assert_conditioned(gaussian.update(*arguments), arguments, (40,))


@batches
@pytest.mark.parametrize(("size", "height"), [(2, 2), (6, 4)])
def test_a_weak_prior_loses_no_digits_of_a_sharp_reading(size, height, batch):
    """The covariance is a sum of squares: a difference would leave 1e-4 of 1e12 in a 1."""
    mean, cov, matrix, residual, noise = drawn(batch, size, height)
    matrix = matrix + 2.0 * np.eye(height, size).reshape(height, size, *(1 for _ in batch))
    arguments = mean, 1e12 * cov, matrix, 1e6 * residual, noise
    found = gaussian.update(*arguments)
    assert_conditioned(found, arguments, batch)


@pytest.mark.parametrize("batch", [(), (40,)], ids=repr)
def test_units_cost_no_digits(batch):
    """Determinants of a size that numbers cannot hold, of large and of small numbers."""
    parts = drawn(batch, 2, 12)
    run = each(batch)[-1]
    mean, cov, log_density, _ = exactly(*(part[(..., *run)] for part in parts))
    for power in (-60, -30, 30, 60):
        unit = 2.0**power  # is exact
        powers = [1, 2, 0, 1, 2]
        arguments = [unit**power * part for part, power in zip(parts, powers, strict=True)]
        with np.errstate(over="ignore"):  # of a determinant
            found = gaussian.update(*arguments)
        assert_allclose(found.mean[(..., *run)], unit * mean, rtol=1e-11)
        assert_allclose(found.cov[(..., *run)], unit**2 * cov, rtol=1e-11)
        density = log_density - 12 * power * np.log(2.0)
        assert_allclose(np.asarray(found.log_density)[run], density, rtol=1e-12)


@batches
@pytest.mark.parametrize("gap", [0.0, 1e-9, 1e-5, 1e-3, 3.0])
@pytest.mark.parametrize("size", [2, 6])
def test_nearly_equal_sharp_readings(size, gap, batch):
    """Two of one component but for a gap: told by `regular`, and right either way."""
    mean, cov, matrix, residual, noise = drawn(batch, size, 2)
    noise = 1e-9 * noise
    matrix[1] = matrix[0]
    matrix[1, 1] += gap
    residual[1] = residual[0] + 1e-5
    arguments = mean, cov, matrix, residual, noise
    found = gaussian.update(*arguments)
    share = share_left(arguments, batch)
    assert found.regular == (share > gaussian.NEARLY_SINGULAR)
    assert found.regular == (gap > 1.0)
    if not batch:
        assert (gaussian.update_one(*arguments) is None) == (not found.regular)
    assert_conditioned(found, arguments, batch)


@batches
@pytest.mark.parametrize("fault", [np.nan, np.inf, -9.0])
@pytest.mark.parametrize("size", [2, 7])
def test_a_belief_that_is_none_has_no_density(size, fault, batch):
    """Of the run that has it; the others keep theirs."""
    mean, cov, matrix, residual, noise = drawn(batch, size, 2)
    due = np.asarray(gaussian.update(mean, cov, matrix, residual, noise).log_density)
    run = () if not batch else (batch[0] // 2,)
    cov[(slice(None), slice(None), *run)] = np.where(np.eye(size) > 0, fault, 0.0)
    with np.errstate(invalid="ignore"):
        found = np.asarray(gaussian.update(mean, cov, matrix, residual, noise).log_density)
        if not batch:
            assert gaussian.update_one(mean, cov, matrix, residual, noise) is None
    assert not np.isfinite(found[run])
    others = np.ones(batch, dtype=bool)
    others[run] = False
    assert_allclose(found[others], due[others], rtol=1e-12)


# ---- exact readings

EXACT = {
    "one of two": ([[1, 0]], [[0]], [3]),
    "both": ([[1, 0], [1, 2]], [[0, 0], [0, 0]], [3, -1]),
    "a third that they determine": ([[1, 0], [1, 2], [3, 2]], np.zeros((3, 3)), [3, -1, 5]),
    "one of them twice": ([[1, 0], [1, 0]], np.zeros((2, 2)), [3, 3]),
    "one that contradicts": ([[1, 0], [1, 0]], np.zeros((2, 2)), [3, 4]),
    "beside one with noise": ([[1, 0], [0, 1]], np.diag([0, 0.5]), [3, 1]),
    "noise of rank one": ([[1, 0], [1, 1]], [[4, 2], [2, 1]], [1, 2]),
    "of nothing": ([[0, 0]], [[0]], [0]),
}
PRIORS = {
    "regular": [[2, 1], [1, 3]],
    "one certain": [[2, 0], [0, 0]],
    "rank one": [[4, 6], [6, 9]],
    "certain": [[0, 0], [0, 0]],
}


@batches
@pytest.mark.parametrize("prior", PRIORS)
@pytest.mark.parametrize("name", EXACT)
@pytest.mark.parametrize("unit", [1.0, 1e-3])
def test_exact_readings(name, prior, unit, batch):
    """Zeros are zeros, what is determined adds nothing, and tells how far off it is."""
    matrix, noise, residual = (np.asarray(part, dtype=float) for part in EXACT[name])
    parts = np.array([0.5, -0.25]), np.array(PRIORS[prior]), matrix, residual, noise
    powers = [1, 2, 0, 1, 2]
    arguments = [
        np.multiply.outer(unit**power * part, np.ones(batch))
        for part, power in zip(parts, powers, strict=True)
    ]
    with np.errstate(invalid="ignore", divide="ignore"):
        found = gaussian.update(*arguments, exact=True)
    # In rational numbers thousandths are no thousandths: the textbook has those of whole ones.
    mean, cov, log_density, left = exactly(*parts)
    open_ = np.linalg.matrix_rank(matrix @ parts[1] @ matrix.T + noise, tol=1e-9)
    for run in each(batch):
        assert_allclose(found.mean[(slice(None), *run)], unit * mean, atol=1e-12 * unit)
        own = found.cov[(slice(None), slice(None), *run)]
        assert_allclose(own, unit**2 * cov, atol=1e-13 * unit**2)
        assert_array_equal(np.diag(own) == 0.0, np.diag(cov) == 0.0)
        density = np.asarray(found.log_density)[run]
        assert_allclose(density, log_density - open_ * np.log(unit), rtol=1e-12)
        lost = np.zeros(len(left)) if found.left is None else found.left[(slice(None), *run)]
        assert_allclose(lost, unit * left, atol=1e-12 * unit)
    assert (found.left is None) == (open_ == len(residual))


def test_runs_with_exact_readings_and_without_are_each_their_own():
    """In one call, of one noise each."""
    mean, cov, matrix, residual, noise = drawn((40,), 3, 2)
    noise[..., ::2] = 0.0
    noise[0, 0, 1::4] = 0.0
    noise[0, 1, 1::4] = noise[1, 0, 1::4] = 0.0
    arguments = mean, cov, matrix, residual, noise
    assert_conditioned(gaussian.update(*arguments, exact=True), arguments, (40,))


# ---- predictions


def pushed(cov, matrix, noise):
    return (F(matrix) @ F(cov) @ F(matrix).T + F(noise)).astype(float)


@sizes
@batches
def test_a_prediction(size, height, batch):
    _, cov, matrix, _, noise = drawn(batch, size, height)
    found = gaussian.predict(cov, matrix, noise)
    assert found.shape == (height, height, *batch)
    assert_array_equal(found, found.swapaxes(0, 1))
    for run in each(batch):
        due = pushed(*(at(part, 2, run) for part in (cov, matrix, noise)))
        assert_allclose(found[(slice(None), slice(None), *run)], due, rtol=1e-12, atol=1e-13)


@batches
@pytest.mark.parametrize("size", [2, 8])
def test_a_component_without_noise_may_be_certain(size, batch):
    """What rounding leaves of a variance of zero is zero, and a small one is no rounding."""
    factor = np.linspace(0.3, 0.1, size)
    cov = np.multiply.outer(np.outer(factor, factor), np.ones(batch))
    matrix = np.zeros((3, size))
    matrix[0, :2] = factor[1], -factor[0]  # nothing is left
    matrix[1, 0] = 1e-9
    matrix[2] = 1.0
    wide = np.multiply.outer(matrix, np.ones(batch))
    noise = np.multiply.outer(np.diag([0.0, 0.0, 0.5]), np.ones(batch))
    found = gaussian.predict(cov, wide, noise, (0, 1))
    for run in each(batch):
        own = found[(slice(None), slice(None), *run)]
        assert not own[0].any()
        assert not own[:, 0].any()
        due = pushed(np.outer(factor, factor), matrix, np.diag([0.0, 0.0, 0.5]))
        assert_allclose(own[1:, 1:], due[1:, 1:], rtol=1e-12)


@pytest.mark.parametrize("batch", [(5,), (40,)], ids=repr)
def test_one_of_a_batch_may_be_certain(batch):
    _, cov, matrix, _, _ = drawn(batch, 2, 1)
    cov[..., 3] = np.outer([0.3, 0.1], [0.3, 0.1])
    matrix[..., 3] = [[0.1, -0.3]]
    found = gaussian.predict(cov, matrix, np.zeros((1, 1, 1)), (0,))
    assert found[0, 0, 3] == 0.0
    for run in each(batch):
        assert_allclose(found[0, 0, run[0]], pushed(cov[..., run[0]], matrix[..., run[0]], [[0.0]]))


@batches
@pytest.mark.parametrize("places", [slice(0, 2), np.array([2, 0])], ids=["slice", "array"])
def test_extending_writes_the_child_into_the_joint(places, batch):
    mean, joint, matrix, _, noise = drawn(batch, 3, 2)
    matrix = matrix[:, :2]
    value = matrix[:, 0] + 0.5
    whole, spread = np.zeros((5, *batch)), np.zeros((5, 5, *batch))
    whole[:3], spread[:3, :3] = mean, joint
    gaussian.extend(whole, spread, slice(3, 5), places, matrix, value, noise)
    assert_array_equal(whole, np.concatenate([mean, value]))
    assert_array_equal(spread, spread.swapaxes(0, 1))
    for run in each(batch):
        wide, moved = np.zeros((5, 3)), np.zeros((5, 5))
        wide[:3], moved[3:, 3:] = np.eye(3), at(noise, 2, run)
        wide[3:, np.arange(3)[places]] = at(matrix, 2, run)
        due = pushed(at(joint, 2, run), wide, moved)
        assert_allclose(spread[(slice(None), slice(None), *run)], due, rtol=1e-12, atol=1e-13)


@batches
def test_a_certain_child_varies_with_nothing(batch):
    """Its covariances are zero, not the rounding of a difference; those of others stay."""
    factor = np.array([0.3, 0.1, 0.7])
    whole, spread = np.zeros((5, *batch)), np.zeros((5, 5, *batch))
    spread[:3, :3] = np.multiply.outer(np.outer(factor, factor), np.ones(batch))
    matrix = np.multiply.outer(np.array([[0.1, -0.3], [1.0, 1.0]]), np.ones(batch))
    assert (np.array([0.1, -0.3]) @ np.outer(factor, factor)[:2]).any()  # it is rounding
    nothing = np.zeros((2, 2, *batch))
    gaussian.extend(whole, spread, slice(3, 5), slice(0, 2), matrix, whole[:2], nothing, (0, 1))
    assert not spread[3].any()
    assert not spread[:, 3].any()
    due = np.append(0.4 * factor, [0.0, 0.16])
    assert_allclose(spread[4], np.multiply.outer(due, np.ones(batch)), rtol=1e-12)


# ---- roots


@pytest.mark.parametrize("batch", [(), (1,), (40,), (3, 4)], ids=repr)
@pytest.mark.parametrize("size", [1, 3, 6])
def test_a_root(size, batch):
    _, cov, _, _, _ = drawn(batch, size, 2)
    lower = gaussian.root(cov).matrix.array
    for run in np.ndindex(*batch):
        one = lower[(slice(None), slice(None), *run)]
        assert_allclose(one, np.linalg.cholesky(cov[(slice(None), slice(None), *run)]), atol=1e-13)


@pytest.mark.parametrize("batch", [(), (5,), (2, 3)], ids=repr)
@pytest.mark.parametrize(
    "cov",
    [
        np.zeros((2, 2)),
        np.ones((2, 2)),
        np.array([[1.0, 1.0], [1.0, 1.0 + 1e-14]]),
        np.diag([1.0, -1.0]),
        np.full((2, 2), np.nan),
        np.diag([1.0, np.nan]),
    ],
    ids=["zero", "rank one", "nearly", "indefinite", "nan", "partly nan"],
)
def test_there_is_no_root_of_what_is_not_definite(cov, batch):
    """One of a batch suffices."""
    many = np.multiply.outer(np.diag([2.0, 3.0]), np.ones(batch))
    assert gaussian.root(many) is not None
    many[(slice(None), slice(None), *(0 for _ in batch))] = cov
    with np.errstate(invalid="ignore"):
        assert gaussian.root(many) is None


def test_deviations():
    cov = np.array([[4.0, 0.0], [0.0, -1e-20]])
    assert_array_equal(gaussian.deviations(cov), [2.0, 0.0])
    wide = np.multiply.outer(cov, np.ones((2, 3)))
    assert_array_equal(gaussian.deviations(wide)[:, 1, 2], [2.0, 0.0])


@pytest.mark.parametrize("size", [1, 2, 3, 4, 6])
def test_what_is_regular(size):
    """By pivots beside variances, and these beside earlier ones; of a batch by the worst."""
    rng = np.random.default_rng(size)
    seen, covs, befores = [], [], []
    for power in np.linspace(-6, 0, 60):
        square = rng.normal(size=(size, size))
        square[-1] = square[0] + 10.0**power * square[-1]
        cov = square @ square.T
        before = cov * 10.0 ** rng.uniform(-1, 8)
        pivots = np.diagonal(np.linalg.cholesky(cov)) ** 2
        shares = [*(pivots / np.diagonal(cov)), *(np.diagonal(cov) / np.diagonal(before))]
        if abs(np.log(min(shares) / 1e-7)) < 0.1:
            continue  # too near to say
        due = min(shares) > 1e-7
        assert gaussian.is_moderate(np.zeros(cov.shape[1:]), cov, before, 1e-7, 1.0) == due
        seen.append(due)
        covs.append(cov)
        befores.append(before)
    good = np.flatnonzero(seen)
    assert 0 < good.size < len(seen)
    for some in (good, np.append(good, np.flatnonzero(~np.array(seen))[0])):
        cov, before = (np.stack([part[k] for k in some], axis=-1) for part in (covs, befores))
        assert gaussian.is_moderate(np.zeros(cov.shape[1:]), cov, before, 1e-7, 1.0) == (
            some is good
        )
    known = np.diag([0.0, *np.ones(size)])
    assert gaussian.is_moderate(np.ones(size + 1), known, known, 1e-7, 2.0)
    indefinite = np.array([[0.0, 1.0], [1.0, 0.0]])
    assert not gaussian.is_moderate(np.ones(2), indefinite, np.zeros((2, 2)), 1e-7, 2.0)


@pytest.mark.parametrize("size", [1, 3, 6])
@pytest.mark.parametrize("batch", [(), (4,)])
def test_a_mean_far_above_its_deviation_is_not_moderate(size, batch):
    cov = np.multiply.outer(4.0 * np.eye(size), np.ones(batch))
    mean = np.full((size, *batch), 19.0)
    assert gaussian.is_moderate(mean, cov, cov, 1e-7, 100.0)
    for odd in (21.0, np.nan, np.inf):
        mean[size - 1, ...] = -odd
        assert not gaussian.is_moderate(mean, cov, cov, 1e-7, 100.0)


@batches
@pytest.mark.parametrize("size", [1, 2, 5])
@pytest.mark.parametrize("shared", [0.0, 1e3, 1e6])
def test_lengths(size, batch, shared):
    """Each pair by itself: ten times what is left of a deviation given another component."""
    rng = np.random.default_rng(7)
    cov = np.array([random_covariance(rng, size) for _ in range(int(np.prod(batch)))]) + shared
    cov = np.moveaxis(cov.reshape(*batch, size, size), (-2, -1), (0, 1))
    own = np.einsum("ii...->i...", cov)
    due = own.copy()
    for j in range(size):
        for k in set(range(size)) - {j}:
            due[j] = np.minimum(due[j], 100.0 * (cov[j, j] - cov[j, k] ** 2 / cov[k, k]))
    assert_allclose(gaussian.lengths(cov) ** 2, np.maximum(due, 1e-6 * own), rtol=1e-6)


def test_lengths_of_singular_covariances():
    cov = np.array([[4.0, 4.0, 0.0], [4.0, 4.0, 0.0], [0.0, 0.0, 0.0]])
    assert_allclose(gaussian.lengths(cov), [2e-3, 2e-3, 0.0])
