"""M steps against numerical maximisation of the expected log-density of a dense twin."""

import numpy as np
import pytest
from learning.twin import U, X, Z, dense, drawn, expected_log_density, linear
from scipy.optimize import root

import pgm
from pgm.learning import Coefficients, Covariance, Offset
from pgm.learning.model import Learner

STEPS = 7


def recording(rng, model, missing=False):
    controls = rng.normal(size=(STEPS, 1))
    evidence = model.sample({U: controls}, rng=rng).evidence
    readings = np.array(evidence[Z])
    if missing:
        readings[2] = np.nan
        readings[4, 0] = readings[5, 1] = np.nan
    return controls, readings


def stepped(model, evidence, learn, lineariser=None):
    """The model after one M step, and the gradient of the log-evidence."""
    lineariser = lineariser or pgm.Taylor()
    learner = Learner(
        model, [evidence], learn, lineariser, pgm.Smoothing(), None, [None], single=True
    )
    image, gradient = learner.improved(learner.expected(learner.start))
    return image, gradient, learner


def family(model, controls, readings):
    """Moments of (x[t−1], u, 1, x[t]) by the dense twin, the parents' first."""
    mean, cov, _ = dense(model, controls, readings)
    means, covs = [], []
    for t in range(1, STEPS + 1):
        means.append(np.concatenate([mean[t - 1], controls[t - 1], mean[t]]))
        joint = np.zeros((5, 5))
        both = cov[t - 1 : t + 1][:, :, t - 1 : t + 1].reshape(4, 4)
        places = np.array([0, 1, 3, 4])
        joint[np.ix_(places, places)] = both
        covs.append(joint)
    return np.array(means), np.array(covs)


def numerically(mean, cov, start, unpack):
    """The parameters where the complex-step gradient of the expected log-density is zero."""

    def gradient(p):
        steps = np.eye(p.size) * 1e-30j
        return np.array(
            [expected_log_density(mean, cov, None, *unpack(p + h)).imag / 1e-30 for h in steps]
        )

    found = root(gradient, start, tol=1e-13)
    assert found.success
    assert np.abs(gradient(found.x)).max() < 1e-8
    return unpack(found.x)


def packed(matrix, offset, noise):
    return np.concatenate([matrix.ravel(), offset, noise[np.tril_indices(2)]])


def unpacked(p):
    noise = np.zeros((2, 2), p.dtype)
    noise[np.tril_indices(2)] = p[8:]
    return p[:6].reshape(2, 3), p[6:8], noise + noise.T - np.diag(np.diag(noise))


def test_a_transition_is_the_maximum_of_the_expected_log_density():
    rng = np.random.default_rng(1)
    model = linear(rng)
    controls, readings = recording(rng, model)
    learn = {X: (Coefficients(), Offset(), Covariance())}
    image, *_ = stepped(model, {U: controls, Z: readings}, learn)
    new = image.model.transition[0]
    matrix = np.concatenate([new.matrices[X.previous], new.matrices[U]], axis=1)
    mean, cov = family(model, controls, readings)
    start = packed(matrix, new.offset, new.cov) + 0.01 * rng.normal(size=11)
    best = numerically(mean, cov, start, unpacked)
    for ours, theirs in zip((matrix, new.offset, new.cov), best, strict=True):
        np.testing.assert_allclose(ours, theirs, atol=1e-8)


def test_fixed_entries_stay_and_the_others_are_the_maximum():
    """Rows with different free entries, and a full noise: there is no closed form."""
    rng = np.random.default_rng(2)
    model = linear(rng)
    controls, readings = recording(rng, model)
    mask = np.array([[True, False], [True, True]])
    learn = {X: (Coefficients({X.previous: mask}), Covariance())}
    image, *_ = stepped(model, {U: controls, Z: readings}, learn)
    old, new = model.transition[0], image.model.transition[0]
    assert new.matrices[X.previous][0, 1] == old.matrices[X.previous][0, 1]
    np.testing.assert_array_equal(new.matrices[U], old.matrices[U])
    np.testing.assert_array_equal(new.offset, old.offset)

    def unpack(p):
        matrix = np.array(old.matrices[X.previous], p.dtype)
        matrix[mask] = p[:3]
        noise = np.array([[p[3], p[4]], [p[4], p[5]]])
        return np.concatenate([matrix, old.matrices[U]], axis=1), old.offset, noise

    start = np.concatenate([new.matrices[X.previous][mask], new.cov[np.tril_indices(2)][[0, 1, 2]]])
    best = numerically(*family(model, controls, readings), start * 1.001, unpack)
    np.testing.assert_allclose(new.matrices[X.previous], best[0][:, :2], atol=1e-8)
    np.testing.assert_allclose(new.cov, best[2], atol=1e-8)


@pytest.mark.parametrize("missing", [False, True])
def test_the_gradient_is_that_of_the_log_evidence_of_the_dense_twin(missing):
    """Of everything at once; with missing components too, which are expected."""
    rng = np.random.default_rng(3)
    model = linear(rng)
    controls, readings = recording(rng, model, missing)
    every = (Coefficients(), Offset(), Covariance())
    learn = {X.at(0): (Offset(), Covariance()), X: every, Z: every}
    image, gradient, learner = stepped(model, {U: controls, Z: readings}, learn)
    point = learner.vector(learner.start)

    def log_evidence(vector):
        return dense(learner.at(learner.start, vector).model, controls, readings)[2]

    h = 1e-5
    slopes = [
        (log_evidence(point + h * unit) - log_evidence(point - h * unit)) / (2 * h)
        for unit in np.eye(point.size)
    ]
    np.testing.assert_allclose(gradient, slopes, rtol=1e-6, atol=1e-6)
    assert dense(image.model, controls, readings)[2] > dense(model, controls, readings)[2]
    assert learner.expected(learner.start).log_evidence == pytest.approx(
        dense(model, controls, readings)[2], abs=1e-9
    )


@pytest.mark.parametrize(
    ("kind", "lower", "upper"),
    [
        ("diagonal", 0.0, np.inf),
        ("scaled", 0.0, np.inf),
        ("full", 0.9, 1.1),
        ("diagonal", 1.0, 2.0),
        ("scaled", 1.0, 1.01),
    ],
)
def test_noise_of_a_kind_and_within_bounds_is_the_best_of_its_kind(kind, lower, upper):
    """No draw within the bounds has a larger expected log-density."""
    rng = np.random.default_rng(4)
    model = linear(rng)
    start = np.diag([1.0, 2.0]) if kind == "diagonal" else drawn(rng, 2)
    if kind == "full":
        start = np.eye(2)
    sees = model.observation[0]
    sees = pgm.LinearGaussianCPD(Z, dict(sees.matrices), cov=start, offset=sees.offset)
    model = model.replace(observation=[sees])
    controls, readings = recording(rng, model)
    learn = {Z: Covariance(kind, lower, upper)}
    image, *_ = stepped(model, {U: controls, Z: readings}, learn)
    mean, cov, _ = dense(model, controls, readings)
    joint = np.zeros((STEPS, 4, 4))
    joint[:, :2, :2] = [cov[t, :, t] for t in range(1, STEPS + 1)]
    both = np.concatenate([mean[1:], readings], axis=1)

    def value(noise):
        return expected_log_density(both, joint, None, sees.matrices[X], sees.offset, noise)

    best = image.model.observation[0].cov
    for _ in range(300):
        move = rng.normal(size=(2, 2)) * 10.0 ** rng.uniform(-5, 0)
        near = best + move + move.T
        if kind == "diagonal":
            near = np.diag(np.clip(np.diag(near), max(lower, 1e-9), upper))
        elif kind == "scaled":
            near = np.clip(best[0, 0] / start[0, 0] + move[0, 0], max(lower, 1e-9), upper) * start
        else:
            values, vectors = np.linalg.eigh(near)
            near = vectors * np.clip(values, lower, upper) @ vectors.T
        assert value(near) <= value(best) + 1e-10
