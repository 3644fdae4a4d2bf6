"""How nonlinear CPDs are over beliefs, against integrals on a dense grid and by hand."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

import pgm
from pgm.examples import squares, walk

x, z = pgm.variables("x z")
u = pgm.Variable("u")
p = pgm.Variable("p", components=("east", "north"))
r = pgm.Variable("r", components=("range", "bearing"), angles=("bearing",))


def of_line(function, mean, cov, noise):
    """The trace tr S(S + R)⁻¹, S = cov h − cov(h, x) P⁻¹ cov(x, h), by quadrature of 40ⁿ points."""
    nodes, weights = np.polynomial.hermite_e.hermegauss(40)
    grid = np.stack(np.meshgrid(*[nodes] * len(mean), indexing="ij"), axis=-1)
    mass = np.prod(np.stack(np.meshgrid(*[weights] * len(mean), indexing="ij")), axis=0)
    mass = mass.ravel() / mass.sum()
    off = grid.reshape(-1, len(mean)) @ np.linalg.cholesky(cov).T
    value = function(mean + off)
    value = value - mass @ value
    cross = (mass[:, None] * value).T @ off
    error = (mass[:, None] * value).T @ value - cross @ np.linalg.solve(cov, cross.T)
    return np.trace(error @ np.linalg.inv(error + noise))


def seen(function, child, parent, cov, prior, motion):
    sensor = pgm.NonlinearGaussianCPD(child, given=parent, function=function, cov=cov)
    return pgm.DynamicBayesianNetwork([prior], [motion], [sensor])


def ranged(x):
    return np.stack([np.hypot(x[..., 0], x[..., 1]), np.arctan2(x[..., 1], x[..., 0])], axis=-1)


def test_a_square_over_its_predicted_belief():
    """Of x ~ N(m, P) the best line leaves of x² the variance 2P²; here P = 1 + 1."""
    model = pgm.DynamicBayesianNetwork(
        walk.prior,
        walk.transition,
        [pgm.NonlinearGaussianCPD(z, given=x, function=lambda x: x**2, cov=3.0)],
    )
    found = pgm.filter(model, {z: [[4.0], [np.nan]]}).nonlinearity
    assert list(found) == [z]  # the walk is affine
    assert_allclose(found[z], [8.0 / 11.0, np.nan])
    with pytest.raises(pgm.EvidenceError, match=r"no nonlinearity of x.*\[z\]"):
        found[x]


def test_a_range_and_a_bearing_by_quadrature():
    mean, cov, noise = np.array([4.0, 1.0]), np.array([[0.2, 0.1], [0.1, 0.3]]), [0.01, 0.002]
    prior = pgm.GaussianCPD(p, mean=mean, cov=cov)
    still = pgm.LinearGaussianCPD(p, given={p.previous: np.eye(2)}, cov=0.0)
    model = seen(ranged, r, p, noise, prior, still)
    due = of_line(ranged, mean, cov, np.diag(noise))
    assert 0.2 < due < 0.3
    found = pgm.filter(model, {r: [[4.0, 0.2]]})
    assert_allclose(found.nonlinearity[r], [due], rtol=0.03)
    # Of the range alone, where no bearing was read.
    alone = of_line(lambda x: ranged(x)[..., :1], mean, cov, np.diag(noise[:1]))
    found = pgm.filter(model, {r: [[4.0, np.nan]]})
    assert_allclose(found.nonlinearity[r], [alone], rtol=0.03)


def test_a_smoother_that_iterates_is_judged_at_its_own_beliefs():
    smoothed = pgm.smooth(squares, {z: [[9.0], [16.0]]}, iterations=20)
    cov = smoothed[x].cov[1:, 0, 0]
    assert_allclose(smoothed.nonlinearity[z], 2 * cov**2 / (2 * cov**2 + 1e-6), rtol=1e-6)
    once = pgm.smooth(squares, {z: [[9.0], [16.0]]})
    cov = once.predicted[x].cov[1:, 0, 0]
    assert_allclose(once.nonlinearity[z], 2 * cov**2 / (2 * cov**2 + 1e-6), rtol=1e-6)


@pytest.mark.parametrize("hidden", [False, True], ids=["states", "a hidden control"])
def test_motion_starts_from_the_step_before(hidden):
    """Of x u, x ~ N(a, P) and u ~ N(b, Q), the best line leaves P Q, of x² it leaves 2P²."""
    prior, sensor = pgm.GaussianCPD(x, 1.0, 0.5), pgm.LinearGaussianCPD(z, given={x: 1.0}, cov=1.0)
    if hidden:
        motion = [
            pgm.GaussianCPD(u, 2.0, 0.25),
            pgm.NonlinearGaussianCPD(
                x, given=(x.previous, u), function=lambda x, u: x * u, cov=0.1
            ),
        ]
    else:
        motion = [pgm.NonlinearGaussianCPD(x, given=x.previous, function=lambda x: x**2, cov=0.1)]
    model = pgm.DynamicBayesianNetwork([prior], motion, [sensor])
    for ask in (pgm.filter, pgm.smooth):
        found = ask(model, {z: [[1.5], [2.0]]}, iterations=1)
        before = found.filtered[x].cov[:-1, 0, 0]
        error = before * 0.25 if hidden else 2 * before**2
        assert_allclose(found.nonlinearity[x], error / (error + 0.1), rtol=1e-6)
    found = pgm.smooth(model, {z: [[1.5], [2.0]]}, iterations=30)
    if hidden:
        both = [found.joint(x.at(t), u.at(t + 1)).cov for t in range(2)]
        error = np.array([c[0, 0] * c[1, 1] + c[0, 1] ** 2 for c in both])
    else:
        error = 2 * found[x].cov[:-1, 0, 0] ** 2
    assert_allclose(found.nonlinearity[x], error / (error + 0.1), rtol=1e-6)


def test_rows_are_in_the_order_of_the_evidence_and_runs_come_first():
    shown = pgm.sightings([[[4.0], [1.0], [9.0]]] * 10, step=[2, 1, 3])
    found = pgm.filter(squares, {z: shown}, steps=3)
    cov = found.predicted[x].cov[:, [2, 1, 3], 0, 0]
    assert found.nonlinearity[z].shape == (10, 3)
    assert_allclose(found.nonlinearity[z], 2 * cov**2 / (2 * cov**2 + 1e-6), rtol=1e-6)


def test_a_belief_of_many_components():
    """The sum of squares of n components of variance P has an error of 2n P², here by draws."""
    wide = pgm.Variable("wide", components=tuple("abcdef"))
    prior = pgm.GaussianCPD(wide, np.zeros(6), 0.5 * np.eye(6))
    still = pgm.LinearGaussianCPD(wide, given={wide.previous: np.eye(6)}, cov=0.0)
    total = seen(lambda x: (x**2).sum(axis=-1, keepdims=True), z, wide, 3.0, prior, still)
    assert_allclose(pgm.filter(total, {z: [[3.0]]}).nonlinearity[z], 0.5, atol=0.08)


def test_without_noise_and_without_numbers():
    """An exact reading is governed by its error alone; of a function without value all is NaN."""
    model = seen(np.exp, z, x, 0.0, walk.prior[0], walk.transition[0])
    assert_allclose(pgm.filter(model, {z: [[1.0]]}).nonlinearity[z], 1.0)
    with np.errstate(invalid="ignore"):
        model = seen(lambda x: np.sqrt(2.0 + x), z, x, 1.0, walk.prior[0], walk.transition[0])
        assert np.isnan(pgm.filter(model, {z: [[1.0]]}).nonlinearity[z]).all()


def test_other_beliefs_have_none():
    grid = pgm.Grid({"x": (-9.0, 9.0, 50)})
    with pytest.raises(pgm.EvidenceError, match="nonlinearities of CPDs that were linearised"):
        pgm.filter(walk, {z: [[1.0]]}, belief=grid).nonlinearity  # noqa: B018
