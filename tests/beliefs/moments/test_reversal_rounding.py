"""Smoothed covariances of motions whose noise has few directions, read by noisy sensors.

Components that hardly vary given all the others are the kind: the filter has all digits there, and
the gain that reverses the motion loses them, step after step.
"""

import pickle

import numpy as np
import pytest
from crossed import crossed
from precise import Reference, floats

import pgm
from pgm.beliefs.moments.digits import reversal_rounding
from pgm.kernels import shares

x = pgm.Variable("x", tuple("abcd"))
STEPS = 30


def contracting(seed, rank):
    """Four states that die out, pushed along so many directions, and a noisy sensor of some."""
    rng = np.random.default_rng(seed)
    moved = rng.choice([0.6, 0.7, 0.8, 0.9]) * np.eye(4)
    moved = moved + np.round(rng.normal(size=(4, 4)) * rng.choice([0.0005, 0.002, 0.02, 0.1]), 4)
    push = np.round(rng.normal(size=(4, rank)), 1)
    rows = int(rng.integers(1, 4))
    see = np.round(rng.normal(size=(rows, 4)), 1)
    noise, prior = rng.choice([1.0, 10.0, 100.0, 1000.0]), rng.choice([1.0, 4.0, 100.0])
    z = pgm.Variable("z", tuple("pqr"[:rows]))
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(x, np.zeros(4), prior)],
        [pgm.LinearGaussianCPD(x, {x.previous: moved}, cov=push @ push.T)],
        [pgm.LinearGaussianCPD(z, {x: see}, cov=noise)],
    )
    return model, z, rng.normal(size=(STEPS, rows)) * np.sqrt(noise)


DRAWN = [(281860907, 1), (273071059, 2), (813270239, 3)]


@pytest.fixture(scope="module", params=DRAWN, ids=str)
def case(request):
    model, z, values = contracting(*request.param)
    readings = [(z, k + 1, row, {}) for k, row in enumerate(values)]
    return model, z, values, Reference(model, STEPS, {}, readings)


def balanced(model, evidence):
    return pgm.infer(pgm.compile(model, steps=STEPS, method=pgm.Balanced()), evidence)


WAYS = {
    "plain": lambda model, evidence: pgm.smooth(model, evidence, compiled=False),
    "compiled": lambda model, evidence: pgm.smooth(model, evidence, compiled=True),
    "balanced": balanced,
    "all of a lag": lambda model, evidence: pgm.smooth(model, evidence, lag=STEPS),
}


@crossed(("runs", "way"), [1, 3], list(WAYS))
def test_smoothed_beliefs_are_right(case, way, runs):
    """Of one run and of many, to 1e-7 deviations and 1e-7 of variances."""
    model, z, values, due = case
    found = WAYS[way](model, {z: values if runs == 1 else np.stack([values] * runs)})
    mean, cov = (floats(part) for part in zip(*due.smoothed, strict=True))
    std = np.sqrt(np.diagonal(cov, axis1=-2, axis2=-1))
    assert (np.abs(found[x].mean - mean) <= 1e-7 * std).all()
    assert (np.abs(found[x].cov - cov) <= 1e-7 * std[:, :, None] * std[:, None, :]).all()


@pytest.mark.parametrize("lag", [2, 12])
def test_lagged_beliefs_of_a_robot_are_right_or_refused(case, lag):
    """A filter goes back over its own transitions, in float64 alone."""
    model, z, values, _ = case
    robot = pgm.OnlineFilter(model, lag=lag)
    belief, refused = robot.initial(), 0
    for row in values[:16]:
        belief = robot.update(robot.predict(belief), {z: row})
    found = []
    readings = [(z, k + 1, row, {}) for k, row in enumerate(values[:16])]
    mean, cov = map(floats, Reference(model, 16, {}, readings).smoothed[16 - lag])
    try:
        found.append(belief.lagged[x])
    except pgm.NumericalError:
        refused += 1
    std = np.sqrt(np.diag(cov))
    for each in found:
        assert (np.abs(each.mean - mean) <= 1e-7 * std).all()
        assert (np.abs(each.cov - cov) <= 1e-7 * np.outer(std, std)).all()
    assert len(found) + refused == 1


def test_an_ordinary_robot_looks_back():
    """Over a lag, before and after it was pickled."""
    v, z = pgm.Variable("v", ("p", "vp")), pgm.Variable("z")
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(v, np.zeros(2), 100.0)],
        [pgm.LinearGaussianCPD(v, {v.previous: [[1.0, 0.1], [0.0, 1.0]]}, cov=np.diag([0.0, 0.1]))],
        [pgm.LinearGaussianCPD(z, {v: [[1.0, 0.0]]}, cov=0.25)],
    )
    values = np.random.default_rng(0).normal(size=(20, 1))
    robot = pgm.OnlineFilter(model, lag=5)
    belief = robot.initial()
    for row in values:
        belief = robot.update(robot.predict(belief), {z: row})
    due = pgm.smooth(model, {z: values}).joint(v.at(15))
    for each in (belief, pickle.loads(pickle.dumps(belief))):
        np.testing.assert_allclose(each.lagged[v].mean, due.mean, atol=1e-9)
        np.testing.assert_allclose(each.lagged[v].cov, due.cov, atol=1e-9)


def test_the_reversed_chain_would_lose_them(case, monkeypatch):
    """What the passes in float64 give, and that the bound is no less than its error."""
    model, z, values, due = case
    told = []

    def keep(plan, *parts):
        added = reversal_rounding.accumulated(parts[0])
        moves = reversal_rounding.between_slices(plan)
        every = np.ones(added.shape, dtype=bool)
        told.append((reversal_rounding._swept(moves, *parts, added, every), added.max()))
        return True

    monkeypatch.setattr(reversal_rounding, "TOLD", np.inf)
    monkeypatch.setattr(reversal_rounding, "keeps_digits", keep)
    found = pgm.smooth(model, {z: values}, compiled=False)
    cov = floats([part for _, part in due.smoothed])
    variance = np.diagonal(cov, axis1=-2, axis2=-1)
    lost = np.abs(np.diagonal(found[x].cov, axis1=-2, axis2=-1) / variance - 1.0).max()
    assert found.status.digits is None
    assert lost > 1e-9
    assert told[0][0] >= lost
    assert told[0][1] >= lost


def test_an_ordinary_robot_costs_nothing(monkeypatch):
    """A constant velocity seen from its position: the quick bound tells that all is well."""

    def never(*parts):
        raise AssertionError("the bound was swept")

    monkeypatch.setattr(reversal_rounding, "_swept", never)
    v, z = pgm.Variable("v", ("p", "q", "vp", "vq")), pgm.Variable("z", ("p", "q"))
    moved = np.eye(4) + 0.5 * np.eye(4, k=2)
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(v, np.zeros(4), 25.0)],
        [pgm.LinearGaussianCPD(v, {v.previous: moved}, cov=np.diag([0.01, 0.01, 0.1, 0.1]))],
        [pgm.LinearGaussianCPD(z, {v: np.eye(2, 4)}, cov=0.25)],
    )
    values = np.random.default_rng(0).normal(size=(200, 2))
    for compiled in (False, True):
        assert pgm.smooth(model, {z: values}, compiled=compiled).status.digits is None


def test_the_bound_of_one_transition():
    """The gain is that of Bayes' rule; of one component the formula can be written down."""
    rng = np.random.default_rng(5)
    matrix, root = rng.normal(size=(2, 3, 3))
    known, noise = root @ root.T, np.eye(3)
    predicted = matrix @ known @ matrix.T + noise
    gain, lost = reversal_rounding.injected(matrix, noise, predicted, known, predicted)
    np.testing.assert_allclose(gain, known @ matrix.T @ np.linalg.inv(predicted), rtol=1e-10)
    assert (lost < 1e-12 * np.diag(known)).all()
    a, p, q, later = 2.0, 9.0, 16.0, 4.0  # P_y is 52
    gain, lost = reversal_rounding.injected(
        *np.array([a, q, a * a * p + q, p, later])[:, None, None]
    )
    moved, summed = 3.0 + a * p / 52.0 * 10.0, 10.0  # |A| σ + σ_Q = 6 + 4
    pulled = summed / 52.0 * later * a * p / 52.0
    due = 2.0 * moved * pulled + (a * p / 52.0 * 2.0) ** 2 + p
    np.testing.assert_allclose(gain, [[a * p / 52.0]])
    np.testing.assert_allclose(lost, [np.finfo(float).eps * due])


def test_inflation_is_the_trace_of_the_inverse_of_correlations():
    roots = np.random.default_rng(2).normal(size=(6, 4, 4))
    covs = roots @ roots.mT
    covs[1, 2], covs[1, :, 2] = 0.0, 0.0
    covs[2, 1], covs[2, :, 1] = covs[2, 0], covs[2, :, 0]
    due = []
    for cov in covs:
        std = np.sqrt(np.diag(cov))
        std[std == 0.0] = 1.0
        correlation = cov / np.outer(std, std)
        np.fill_diagonal(correlation, 1.0)
        singular = np.linalg.matrix_rank(correlation) < 4
        due.append(np.inf if singular else np.trace(np.linalg.inv(correlation)))
    found = shares.inflation(np.moveaxis(covs, 0, -1).copy())
    assert found[2] > 1e14
    np.testing.assert_allclose(np.delete(found, 2), np.delete(due, 2), rtol=1e-10)


def test_units_do_not_matter():
    """Components in other units, by powers of two, leave the bounds as they are."""
    rng = np.random.default_rng(1)
    predicted, known, later, noise = (a @ a.mT for a in rng.normal(size=(4, 8, 1, 4, 4)))
    moves = rng.normal(size=(8, 1, 4, 4))
    unit = 2.0 ** np.array([0, 10, -7, 3])
    scale = unit[:, None] * unit
    _, due = reversal_rounding.injected(moves, noise, predicted, known, later)
    covs = (cov * scale for cov in (noise, predicted, known, later))
    _, lost = reversal_rounding.injected(unit[:, None] * moves / unit, *covs)
    np.testing.assert_allclose(lost, due * unit**2, rtol=1e-9)
    due = reversal_rounding.accumulated(predicted)
    np.testing.assert_allclose(reversal_rounding.accumulated(predicted * scale), due, rtol=1e-9)
