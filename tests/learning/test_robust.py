"""Robust noise and gates as parts of E and M steps."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import minimize
from scipy.special import erfinv
from scipy.stats import f

import pgm
from pgm.learning import Coefficients, Covariance, DegreesOfFreedom, Offset
from pgm.learning.model import Learner
from pgm.linearisation.weights import Weights

X = pgm.Variable("x", ("a", "b"))
Z = pgm.Variable("z", ("p", "q"))
S, Y = pgm.variables("s y")
SETTLED = pgm.Smoothing(iterations=500, tolerance=1e-11)


def walk(cov, noise, spread=0.3):
    return pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(S, 0.0, 1.0)],
        [pgm.LinearGaussianCPD(S, {S.previous: 0.9}, cov=spread)],
        [pgm.LinearGaussianCPD(Y, {S: 1.0}, cov=cov, noise=noise)],
    )


def dense(weight, cov, readings, spread=0.3):
    """Mean and variance of the walk's states at 1..T, and ln p, of noise R / w."""
    steps = len(readings)
    lower = np.tril(0.9 ** np.abs(np.subtract.outer(np.arange(steps), np.arange(steps))))
    prior = spread * lower @ lower.T + np.outer(0.9 ** np.arange(1, steps + 1), lower[:, 0] * 0.9)
    total = prior + np.diag(cov / weight)
    gain = np.linalg.solve(total, prior).T
    log_p = -0.5 * (
        readings @ np.linalg.solve(total, readings) + np.linalg.slogdet(2 * np.pi * total)[1]
    )
    return gain @ readings, np.diagonal(prior - gain @ prior), log_p


def bound(cov, noise, readings):
    """The largest lower bound of the evidence, over the weights, of a dense twin."""
    weight = np.ones_like(readings)
    for _ in range(500):
        mean, var, log_p = dense(weight, cov, readings)
        square = ((readings - mean) ** 2 + var) / cov
        surplus = noise.surplus(square, np.ones(square.shape, int), weight).sum()
        before, weight = weight, noise.weight(square, np.ones(square.shape, int))
        if np.abs(weight - before).max() < 1e-12:
            break
    return log_p + surplus


def test_variance_and_degrees_of_freedom_maximise_the_bound_of_a_dense_twin():
    model = walk(1.0, pgm.StudentT(1.5))
    evidence = model.sample(steps=40, rng=3).evidence
    readings = np.ravel(evidence[Y])
    start = walk(2.0, pgm.StudentT(6.0))
    learn = {Y: (Covariance(), DegreesOfFreedom())}
    found = pgm.fit(start, evidence, learn=learn, schedule=SETTLED, tolerance=1e-10)
    sensor = found.model.observation[0]
    best = minimize(
        lambda p: -bound(np.exp(p[0]), pgm.StudentT(float(np.exp(p[1]))), readings),
        [np.log(2.0), np.log(6.0)],
        method="Nelder-Mead",
        options={"xatol": 1e-7, "fatol": 1e-11},
    )
    assert found.log_evidence[-1] == pytest.approx(-best.fun, abs=1e-7)
    assert [sensor.cov[0, 0], sensor.noise.dof] == pytest.approx(np.exp(best.x), rel=1e-3)
    assert (np.diff(found.log_evidence) > 0.0).all()


@pytest.mark.filterwarnings("ignore::pgm.ConvergenceWarning")
@pytest.mark.parametrize(
    "noise", [pgm.StudentT(3.0), pgm.Huber(1.0), pgm.Cauchy(2.0)], ids=lambda n: type(n).__name__
)
def test_plain_steps_never_lower_the_bound(noise):
    """Of everything at once, with readings and components of readings missing.

    Of losses all but their covariance is likeliest.
    """
    rng = np.random.default_rng(4)
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(X, [0, 0], 1.0)],
        [pgm.LinearGaussianCPD(X, {X.previous: [[0.9, 0.2], [0, 0.8]]}, cov=0.3)],
        [pgm.LinearGaussianCPD(Z, {X: [[1, 0], [0.5, 1]]}, cov=[[1, 0.3], [0.3, 1]], noise=noise)],
    )
    readings = np.array(model.sample(steps=60, rng=rng).evidence[Z])
    readings[rng.random(60) < 0.1] += 15.0
    readings[rng.random(readings.shape) < 0.1] = np.nan
    every = (Coefficients(), Offset(), Covariance())
    found = pgm.fit(
        model,
        {Z: readings},
        learn={X: every, Z: every if noise.distribution else every[:2]},
        schedule=pgm.Smoothing(iterations=300, tolerance=1e-9),
        iterations=5,
        accelerate=False,
    )
    assert (np.diff(found.log_evidence) > 0.0).all()
    assert found.status.halved == 0
    assert found.model.observation[0].noise == noise


def test_the_gradient_is_that_of_the_bound():
    rng = np.random.default_rng(5)
    model = walk(1.5, pgm.StudentT(4.0))
    readings = np.array(model.sample(steps=25, rng=rng).evidence[Y])
    readings[7] = np.nan
    learn = {Y: (Coefficients(), Offset(), Covariance(), DegreesOfFreedom())}
    rule = pgm.Taylor(expected=True)
    learner = Learner(model, [{Y: readings}], learn, rule, SETTLED, None, [None], single=True)
    _, gradient = learner.improved(learner.expected(learner.start))
    point, h = learner.vector(learner.start), 1e-4

    def log_evidence(vector):
        return learner.expected(learner.at(learner.start, vector)).log_evidence

    slopes = [
        (log_evidence(point + h * e) - log_evidence(point - h * e)) / (2 * h)
        for e in np.eye(point.size)
    ]
    np.testing.assert_allclose(gradient, slopes, rtol=1e-5, atol=1e-5)


def test_outliers_do_not_raise_the_noise_of_what_moves():
    """Gaussian learning takes wrong readings for noise of both; robust learning for what they are.

    The likeliest noise of the readings without the wrong ones is the reference.
    """
    rng = np.random.default_rng(6)
    clean = np.array(walk(1.0, None).sample(steps=120, rng=rng).evidence[Y])
    wrong = rng.random(len(clean)) < 0.1
    dirty = clean + 30.0 * (wrong * rng.choice([-1, 1], len(wrong)))[:, None]
    right = np.where(wrong[:, None], np.nan, clean)

    def learnt(noise, readings, **settings):
        start = walk(2.0, noise)
        learn = {Y: Covariance()}
        found = pgm.fit(start, {Y: readings}, learn=learn, tolerance=1e-3, **settings)
        return found.model.observation[0].cov[0, 0]

    due = learnt(None, right)
    assert learnt(None, dirty) > 50.0
    assert 0.3 * due < learnt(pgm.StudentT(1.0), dirty) < 1.1 * due
    gated = learnt(None, dirty, schedule=pgm.Smoothing(gate=0.99))
    assert gated == pytest.approx(due, rel=0.1)


@dataclass(frozen=True)
class Welsch(pgm.RobustNoise):
    """A loss of one's own, that forgets outliers faster than any power of them."""

    width: float

    def loss(self, square, count):
        return -0.5 * self.width**2 * np.expm1(-square / self.width**2)

    def slope(self, square, count):
        return np.exp(-square / self.width**2)

    def is_proper(self, size):
        return False


LOSSES = {
    pgm.Huber(1.345): 3,
    pgm.Cauchy(2.385): 2,
    pgm.Cauchy(1.0): 2,
    pgm.TruncatedLeastSquares(2.5): 1,
    Welsch(3.0): 1,
}


def lone(noise, cov, known):
    """States that know nothing of each other, and are known but for a variance."""
    return pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(S, 0.0, known)],
        [pgm.LinearGaussianCPD(S, {S.previous: 0.0}, cov=known)],
        [pgm.LinearGaussianCPD(Y, {S: 1.0}, cov=cov, noise=noise)],
    )


@pytest.mark.parametrize("noise", LOSSES, ids=repr)
def test_the_covariance_of_a_loss_is_that_of_gaussian_readings(noise):
    """Of the quantiles of N(0, 1), and of these with outliers, a tenth of all."""
    readings = np.sqrt(2.0) * erfinv(np.linspace(-1.0, 1.0, 181)[1:-1])
    dirty = np.append(readings, np.full(20, 20.0))
    for some, most in ((readings, 0.05), (dirty, 0.12)):
        learn = {Y: Covariance()}
        found = pgm.fit(lone(noise, 3.0, 1e-6), {Y: some[:, None]}, learn=learn)
        assert "fixed point" in found.status.stopped
        assert found.status.converged
        assert found.model.observation[0].cov[0, 0] == pytest.approx(1.0, rel=most)


@pytest.mark.parametrize("noise", LOSSES, ids=repr)
def test_the_covariance_of_a_loss_solves_its_equation(noise):
    """R Σ κ w^p = Σ w^p E[r²], with κ by quadrature; a lone state is known but for its prior."""
    power, model = LOSSES[noise], lone(noise, 1.0, 0.2)
    readings = np.random.default_rng(9).standard_t(4, size=60)
    found = pgm.fit(model, {Y: readings[:, None]}, learn={Y: Covariance()}, schedule=SETTLED)
    cov, belief = found.model.observation[0].cov[0, 0], found.posterior[S]
    residual = readings - belief.mean[1:, 0]
    var = belief.cov[1:, 0, 0]

    def weight(square):
        return noise.slope(np.asarray(square), 1) ** power

    def expected(function):
        edges = [0.0, *sorted({getattr(noise, "threshold", 1.0), 3.0, 6.0, 12.0})]
        return sum(quad(function, *ends)[0] for ends in pairwise(edges))

    def kappa(share):
        def square(x):
            return (1.0 - share) * x * x + share

        top = expected(lambda x: weight(square(x)) * square(x) * np.exp(-0.5 * x * x))
        return top / expected(lambda x: weight(square(x)) * np.exp(-0.5 * x * x))

    moments = residual**2 + var
    own = weight(moments / cov)
    due = own @ moments / sum(w * kappa(v / cov) for w, v in zip(own, var, strict=True))
    assert cov == pytest.approx(due, rel=3e-3 if power == 1 else 3e-4)


def test_a_loss_takes_from_a_vector_what_it_takes_from_its_components():
    """Of a component that is always missing nothing is learnt, and the other is as alone."""
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(X, [0, 0], 1.0)],
        [pgm.LinearGaussianCPD(X, {X.previous: 0.9}, cov=0.3)],
        [pgm.LinearGaussianCPD(Z, {X: 1.0}, cov=2.0, noise=pgm.Huber(1.5))],
    )
    single = walk(2.0, pgm.Huber(1.5))
    readings = np.array(single.sample(steps=40, rng=8).evidence[Y])
    due = pgm.fit(single, {Y: readings}, learn={Y: Covariance()}).model.observation[0].cov[0, 0]
    wide = np.concatenate([readings, np.full_like(readings, np.nan)], axis=1)
    found = pgm.fit(model, {Z: wide}, learn={Z: Covariance("diagonal")})
    np.testing.assert_allclose(np.diag(found.model.observation[0].cov), [due, 2.0], rtol=1e-6)


def test_coefficients_beside_the_covariance_of_a_loss_are_of_its_weights():
    """An offset where Σ w r = 0, though rows enter the covariance by a power of w."""
    readings = np.array(walk(1.0, None).sample(steps=40, rng=10).evidence[Y]) + 3.0
    readings[::9] += 15.0
    learn = {Y: (Offset(), Covariance())}
    schedule = pgm.Smoothing(iterations=100, tolerance=1e-8)
    found = pgm.fit(walk(2.0, pgm.Huber(1.5)), {Y: readings}, learn=learn, schedule=schedule)
    sensor, weight = found.model.observation[0], found.posterior.weights[Y]
    residual = readings[:, 0] - sensor.offset[0] - found.posterior[S].mean[1:, 0]
    assert weight @ residual == pytest.approx(0.0, abs=5e-3)


def test_secants_find_the_fixed_point_of_plain_steps_sooner():
    readings = np.array(walk(1.0, None).sample(steps=30, rng=11).evidence[Y])
    learn = {S: Covariance(), Y: Covariance()}
    start = walk(2.0, pgm.Huber(1.5), spread=1.0)
    fast, slow = (
        pgm.fit(start, {Y: readings}, learn=learn, accelerate=each) for each in (True, False)
    )
    assert fast.status.converged
    assert slow.status.converged
    assert fast.status.e_steps < 0.7 * slow.status.e_steps
    for role in ("transition", "observation"):
        due, found = (getattr(each.model, role)[0].cov for each in (slow, fast))
        np.testing.assert_allclose(found, due, rtol=2e-2)


@pytest.mark.parametrize("dof", [1.0, 4.0])
def test_the_information_of_student_t_noise_is_fishers(dof):
    """Of vectors whose squares are the quantiles of their distribution, some components missing."""
    cpd = pgm.LinearGaussianCPD(Z, {X: 1.0}, cov=2.0, noise=pgm.StudentT(dof))
    level = (np.arange(2000) + 0.5) / 2000
    for taken in ([True, True], [True, False]):
        size = sum(taken)
        square = size * f.ppf(level, size, dof)[:, None]
        mask = np.broadcast_to(taken, (len(level), 1, 2))
        weights = Weights.of(cpd, np.full((1, 1, 2, 2), 2.0 * np.eye(2)), mask, square.shape)
        weights.take(square)
        assert weights.information == pytest.approx((dof + size) / (dof + size + 2), rel=1e-3)


def test_noise_beside_student_t_readings_solves_its_equation():
    """Q = Σ E[(x − .9 x⁻)²] / T by a dense twin whose readings count with their information."""
    noise = pgm.StudentT(4.0)
    readings = np.array(walk(1.0, None).sample(steps=40, rng=12).evidence[Y])
    readings[::8] += 9.0
    learn = {S: Covariance(), Y: Covariance()}
    found = pgm.fit(walk(1.5, noise), {Y: readings}, learn=learn, schedule=SETTLED)
    assert found.status.converged
    spread, cov = (
        getattr(found.model, role)[0].cov[0, 0] for role in ("transition", "observation")
    )
    count = len(readings)
    step = np.eye(count + 1)[1:] - 0.9 * np.eye(count + 1)[:-1]

    def joint(counts):
        known = np.diag(np.append(1.0, counts / cov))
        return np.linalg.inv(known + step.T @ step / spread)

    weight = found.posterior.weights[Y]
    smoothed = joint(weight)
    mean = smoothed @ np.append(0.0, weight * readings[:, 0] / cov)
    residual = readings[:, 0] - mean[1:]
    square = (residual**2 + np.diagonal(smoothed)[1:]) / cov
    np.testing.assert_allclose(weight, noise.weight(square, 1), rtol=1e-5)
    told = np.mean(weight**2 * square)
    by_score = joint(np.full(count, told))
    due = np.mean((step @ mean) ** 2) + np.trace(step @ by_score @ step.T) / count
    assert spread == pytest.approx(due, rel=2e-3)
    due = np.mean(weight * residual**2 + told * np.diagonal(by_score)[1:])
    assert cov == pytest.approx(due, rel=2e-3)


@pytest.mark.slow
def test_noise_of_a_motion_beside_student_t_readings_is_that_of_the_right_ones():
    """A tenth of them is far off; by the bound it was .6 of what the others tell."""
    rng = np.random.default_rng(13)
    moved = 0.2 * rng.normal(size=(800, 1))
    readings = np.cumsum(moved, axis=0) + rng.normal(size=moved.shape)
    wrong = rng.random(moved.shape) < 0.1
    dirty = readings + wrong * rng.uniform(4.0, 40.0, moved.shape)

    def learnt(noise, readings):
        model = pgm.DynamicBayesianNetwork(
            [pgm.GaussianCPD(S, 0.0, 1e-4)],
            [pgm.LinearGaussianCPD(S, {S.previous: 1.0}, cov=0.03)],
            [pgm.LinearGaussianCPD(Y, {S: 1.0}, cov=1.5, noise=noise)],
        )
        learn = {S: Covariance(), Y: Covariance()}
        schedule = pgm.Smoothing(iterations=50, tolerance=1e-3)
        found = pgm.fit(model, {Y: readings}, learn=learn, schedule=schedule, tolerance=1e-3)
        return found.model.transition[0].cov[0, 0]

    due = learnt(None, np.where(wrong, np.nan, readings))
    assert learnt(pgm.StudentT(4.0), dirty) == pytest.approx(due, rel=0.15)


def test_a_gate_takes_from_a_vector_what_it_takes_from_its_components():
    """Of static components that know nothing of each other, one of them missing at times."""
    rng = np.random.default_rng(8)
    both = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(X, [0, 0], 1.0)],
        [pgm.LinearGaussianCPD(X, {X.previous: 1.0}, cov=0.3)],
        [pgm.LinearGaussianCPD(Z, {X: 1.0}, cov=2.0)],
    )
    lone = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(S, 0.0, 1.0)],
        [pgm.LinearGaussianCPD(S, {S.previous: 1.0}, cov=0.3)],
        [pgm.LinearGaussianCPD(Y, {S: 1.0}, cov=2.0)],
    )
    readings = np.array(lone.sample(steps=200, rng=rng).evidence[Y])
    schedule = pgm.Smoothing(gate=0.9)
    due = pgm.fit(lone, {Y: readings}, learn={Y: Covariance()}, schedule=schedule)
    wide = np.concatenate([readings, np.full_like(readings, np.nan)], axis=1)
    found = pgm.fit(both, {Z: wide}, learn={Z: Covariance("diagonal")}, schedule=schedule)
    np.testing.assert_allclose(found.model.observation[0].cov[0, 0], due.model.observation[0].cov)


def test_what_cannot_be_learnt_of_robust_noise():
    readings = {Y: np.ones((3, 1))}

    def refused(model, learn, told, **settings):
        with pytest.raises(pgm.ModelError, match=told):
            pgm.fit(model, readings, learn=learn, **settings)

    refused(walk(1.0, None), {Y: DegreesOfFreedom()}, "has Gaussian noise; degrees of freedom")
    refused(walk(1.0, pgm.Huber(1.0)), {Y: DegreesOfFreedom()}, "are learnt of noise=pgm.StudentT")
    refused(walk(1.0, pgm.StudentT(0.5)), {Y: DegreesOfFreedom()}, "not within 1 to 100")
    for bounds in ((0.0, 1.0), (3.0, 2.0)):
        with pytest.raises(pgm.ModelError, match="0 < lower < upper"):
            DegreesOfFreedom(*bounds)
    mode = pgm.Discrete("mode", ("calm", "wild"))
    stays = [[0.9, 0.1], [0.1, 0.9]]
    moves = pgm.LinearGaussianCPD(S, {S.previous: 1.0}, cov=1.0)
    switching = pgm.DynamicBayesianNetwork(
        [pgm.TableCPD(mode, table=[0.5, 0.5]), pgm.GaussianCPD(S, 0.0, 1.0)],
        [
            pgm.TableCPD(mode, mode.previous, table=stays),
            pgm.SwitchingCPD(S, mode, cases=dict.fromkeys(mode.states, moves)),
        ],
        [pgm.LinearGaussianCPD(Y, {S: 1.0}, cov=1.0, noise=pgm.StudentT(4.0))],
    )
    refused(switching, {Y: Covariance()}, "of which nothing is learnt beside discrete variables")
    with pytest.raises(pgm.ModelError, match="expected="):
        pgm.Taylor(expected=1)
