"""Robust noise of a user's own: the loss and its slope alone, everything else by integrals."""

from dataclasses import dataclass
from typing import ClassVar

import mpmath
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import quad
from scipy.optimize import minimize_scalar
from scipy.stats import kstest

import pgm
from pgm.cpds.radius import Radius

x, z = pgm.variables("x z")
Z2 = pgm.Variable("z", components=("a", "b"))


@dataclass(frozen=True)
class PseudoHuber(pgm.RobustNoise):
    delta: float

    def loss(self, square, count):
        return self.delta**2 * (np.sqrt(1.0 + square / self.delta**2) - 1.0)

    def slope(self, square, count):
        return 1.0 / np.sqrt(1.0 + square / self.delta**2)


class Graduated(pgm.TruncatedLeastSquares):
    """Truncated least squares by another name: nobody asks for its class."""


@pytest.mark.parametrize("noise", [pgm.StudentT(4.0), pgm.StudentT(1.5), pgm.Huber(1.5)])
@pytest.mark.parametrize("size", [1, 2, 5])
def test_the_scale_by_integrals_is_that_in_closed_form(noise, size):
    if noise.is_proper(size):
        due = -noise._log_scale(size)
        assert_allclose(Radius.of(noise, size).log_integral, due, rtol=1e-6, atol=1e-6)


def density(r, delta=2.0):
    return np.exp(-(delta**2) * (np.sqrt(1.0 + r**2 / delta**2) - 1.0))


def test_the_log_density_is_that_of_the_integral():
    noise = PseudoHuber(2.0)
    whole = quad(density, -np.inf, np.inf, epsabs=1e-13)[0]
    assert_allclose(noise.log_scale(1), -np.log(whole), rtol=1e-9)
    plane = quad(lambda r: 2.0 * np.pi * r * density(r), 0.0, np.inf, epsabs=1e-13)[0]
    assert_allclose(noise.log_scale(2), -np.log(plane), rtol=1e-9)


def test_draws_are_of_the_density():
    noise, rng = PseudoHuber(2.0), np.random.default_rng(3)
    drawn = noise.draw(rng.normal(size=(4000, 1)), rng)[:, 0]
    whole = quad(density, -np.inf, np.inf)[0]
    cdf = np.vectorize(lambda r: quad(density, -np.inf, r)[0] / whole)
    assert kstest(drawn[:800], cdf).pvalue > 1e-3
    turned = noise.draw(rng.normal(size=(4000, 2)), rng)
    assert abs(np.mean(turned[:, 0] * turned[:, 1])) < 0.15
    assert noise.draw(np.zeros((1, 2)), rng).tolist() == [[0.0, 0.0]]


@pytest.mark.parametrize("reading", [0.5, 3.0, 40.0, 1e6])
def test_a_filter_settles_at_the_likeliest_state(reading):
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(x, 1.0, 4.0)],
        [pgm.LinearGaussianCPD(x, {x.previous: 1.0}, cov=0.5)],
        [pgm.LinearGaussianCPD(z, {x: 1.0}, cov=2.0, noise=PseudoHuber(2.0))],
    )
    found = pgm.smooth(model, {z: [[reading]]}, iterations=200, tolerance=1e-12)

    def cost(v):
        return (v - 1.0) ** 2 / 9.0 + PseudoHuber(2.0).loss((reading - v) ** 2 / 2.0, 1)

    due = minimize_scalar(cost, bracket=(0.0, 2.0), tol=1e-12).x
    assert_allclose(found[x].mean[1, 0], due, rtol=1e-6)
    square = (reading - due) ** 2 / 2.0
    assert_allclose(found.weights[z], [1.0 / np.sqrt(1.0 + square / 4.0)], rtol=1e-5)


def test_particles_and_grids_take_its_density():
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(x, 1.0, 4.0)],
        [pgm.LinearGaussianCPD(x, {x.previous: 1.0}, cov=0.5)],
        [pgm.LinearGaussianCPD(z, {x: 1.0}, cov=2.0, noise=PseudoHuber(2.0))],
    )
    grid = pgm.filter(model, {z: [[5.0]]}, belief=pgm.Grid({"x": (-20.0, 22.0, 1600)}))
    draws = pgm.filter(model, {z: [[5.0]]}, belief=pgm.Particles(20_000, seed=1))
    assert_allclose(draws[x].mean[1], grid[x].mean[1], atol=0.06)
    assert_allclose(draws.log_evidence, grid.log_evidence, atol=0.03)
    sample = model.sample({}, steps=500, rng=0)
    assert np.isfinite(sample[z]).all()


def test_a_graduated_loss_of_ones_own_goes_by_stages():
    def mean(noise):
        sensor = pgm.LinearGaussianCPD(z, {x: 1.0}, cov=1.0, noise=noise)
        model = pgm.DynamicBayesianNetwork(
            [pgm.GaussianCPD(x, 0.0, 100.0)],
            [pgm.LinearGaussianCPD(x, {x.previous: 1.0}, cov=0.0)],
            [sensor],
        )
        seen = pgm.sightings([[0.2], [0.1], [30.0], [-0.3]], step=[1, 1, 1, 1])
        return pgm.smooth(model, {z: seen}, steps=1, iterations=60)[x].mean[1, 0]

    assert mean(Graduated(3.0)) == mean(pgm.TruncatedLeastSquares(3.0))
    assert abs(mean(Graduated(3.0))) < 0.2


class Flat(pgm.RobustNoise):
    """Whose density has no integral."""

    def loss(self, square, count):
        return np.minimum(square, 4.0)

    def slope(self, square, count):
        return np.where(square < 4.0, 2.0, 0.0)


class Half(Flat):
    graduated: ClassVar[bool] = True


@dataclass(frozen=True)
class Scaled(pgm.RobustNoise):
    """A Gaussian's, whose residuals have a precision of their own."""

    precision: float

    def loss(self, square, count):
        return 0.5 * self.precision * square

    def slope(self, square, count):
        return np.full_like(square, self.precision)


class Mixed(pgm.RobustNoise):
    """Two Gaussians of deviations 10⁻⁴ and 10⁴, of equal mass."""

    def __init__(self, size):
        total = np.logaddexp(0.0, size * np.log(1e-8))
        self.parts = [(-total, 1e8), (size * np.log(1e-8) - total, 1e-8)]

    def loss(self, square, count):
        each = [weight - 0.5 * precision * square for weight, precision in self.parts]
        return -np.logaddexp(*each)

    def slope(self, square, count):
        raise NotImplementedError


def test_an_integral_that_is_not_finite_is_told():
    with pytest.raises(pgm.ModelError, match=r"no finite integral .* let is_proper\(2\) be False"):
        Flat().log_scale(2)


SIZES = [1, 2, 6, 20, 100]


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("precision", [1e-40, 1e-12, 1.0, 1e3, 1e6, 1e12, 1e40])
def test_a_gaussian_of_any_scale_has_its_scale_and_its_draws(precision, size):
    noise = Scaled(precision)
    due = 0.5 * size * np.log(precision / (2.0 * np.pi))
    assert_allclose(noise.log_scale(size), due, rtol=1e-10, atol=1e-10)
    white = np.random.default_rng(4).normal(size=(50, size))
    drawn = noise.draw(white, np.random.default_rng(5))
    assert_allclose(drawn, white / np.sqrt(precision), rtol=1e-4)


@pytest.mark.parametrize("size", SIZES)
def test_two_scales_far_apart_are_both_found(size):
    """A mixture of Gaussians, whose loss is concave in the square, has its mass at two radii."""
    noise = Mixed(size)
    due = np.logaddexp(*(w - 0.5 * size * np.log(a / (2.0 * np.pi)) for w, a in noise.parts))
    assert_allclose(noise.log_scale(size), -due, rtol=1e-10, atol=1e-10)
    drawn = noise.draw(np.random.default_rng(4).normal(size=(20_000, size)), None)
    narrow = np.linalg.norm(drawn, axis=1) < 1.0
    assert_allclose(narrow.mean(), 0.5, atol=0.02)
    assert_allclose(np.mean(drawn[narrow] ** 2) * 1e8, 1.0, rtol=0.05)
    assert_allclose(np.mean(drawn[~narrow] ** 2) * 1e-8, 1.0, rtol=0.05)


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("power", [0.02, 0.1, 0.5])
def test_the_scale_of_a_power_is_that_of_a_gamma_function(power, size):
    """∫ e^{−r^{2p}} dr = S Γ(d / 2p) / 2p, with the surface S of the unit sphere."""
    with mpmath.workdps(40):
        sphere = 2 * mpmath.pi ** (mpmath.mpf(size) / 2) / mpmath.gamma(mpmath.mpf(size) / 2)
        whole = sphere * mpmath.gamma(mpmath.mpf(size) / (2 * power)) / (2 * power)
        due = float(-mpmath.log(whole))
    noise = changed(loss=lambda n, s, k: s**power)
    assert_allclose(noise.log_scale(size), due, rtol=1e-9)


@pytest.mark.parametrize("dof", [0.2, 0.3, 1.0])
def test_the_scale_of_a_tail_without_moments(dof):
    noise = changed(loss=lambda n, s, k: 0.5 * (dof + 1.0) * np.log1p(s / dof))
    assert_allclose(noise.log_scale(1), pgm.StudentT(dof).log_scale(1), rtol=1e-9)


def test_an_integral_that_was_not_found_is_told_as_that():
    """The density is proper, and most of it lies beyond the numbers of float64."""
    noise = changed(loss=lambda n, s, k: 0.5 * 1.01 * np.log1p(s / 0.01))
    with pytest.raises(pgm.ModelError, match=r"was found, between radii .* if it has none"):
        noise.log_scale(1)
    with pytest.raises(pgm.ModelError, match=r"of 1 components: no finite integral"):
        Scaled(1e305).log_scale(1)  # whose mass lies below them
    with pytest.raises(pgm.ModelError, match=r"the loss of .* squares .* is NaN at a square of 1"):
        changed(loss=lambda n, s, k: np.where(s < 1.0, 0.0, np.nan)).log_scale(1)
    with pytest.raises(pgm.ModelError, match=r"of 1 components: no finite integral"):
        changed(loss=lambda n, s, k: -s).log_scale(1)
    with pytest.raises(pgm.ModelError, match=r"is of shape \(\)"):
        changed(loss=lambda n, s, k: None).log_scale(1)
    with pytest.raises(pgm.ModelError, match=r"is of shape \(\)"):
        changed(loss=lambda n, s, k: 3.0).log_scale(1)


class Plain(pgm.RobustNoise):
    """A pseudo-Huber loss that is no value, and can be changed."""

    def __init__(self, delta):
        self.delta = delta

    loss, slope = PseudoHuber.loss, PseudoHuber.slope


@dataclass
class Open(pgm.RobustNoise):
    """A dataclass that is not frozen, which has no hash."""

    delta: float

    loss, slope = PseudoHuber.loss, PseudoHuber.slope


@pytest.mark.parametrize("kind", [Plain, Open])
def test_a_noise_that_is_changed_has_another_scale(kind):
    noise, rng = kind(1.0), np.random.default_rng(0)
    for delta in (2.0, 50.0, 2.0):
        noise.delta = delta
        due = PseudoHuber(delta)
        assert noise.log_scale(1) == due.log_scale(1)
        assert_allclose(noise.draw(np.ones((1, 1)), rng), due.draw(np.ones((1, 1)), rng))


def test_a_noise_without_a_hash_goes_through_inference():
    def evidence(noise):
        sensor = pgm.LinearGaussianCPD(z, {x: 1.0}, cov=1.0, noise=noise)
        step = pgm.LinearGaussianCPD(x, {x.previous: 1.0}, cov=0.5)
        model = pgm.DynamicBayesianNetwork([pgm.GaussianCPD(x, 0.0, 4.0)], [step], [sensor])
        robot = pgm.OnlineFilter(model)
        online = robot.update(robot.predict(robot.initial()), {z: [8.0]}).log_evidence
        return online, pgm.smooth(model, {z: [[1.0], [8.0]]}, iterations=50).log_evidence

    due = evidence(PseudoHuber(2.0))
    plain, unknown = Plain(2.0), Plain(2.0)
    unknown.note = lambda: None  # which cannot be written down
    for noise in (plain, unknown, Open(2.0)):
        assert evidence(noise) == due


def test_a_graduated_noise_without_stages_is_refused_with_its_cpd():
    with pytest.raises(pgm.ModelError, match="define first_stage, next_stage, staged, staged_loss"):
        pgm.LinearGaussianCPD(z, {x: 1.0}, cov=1.0, noise=Half())


@pytest.mark.parametrize("stage", ["first_stage", "next_stage", "staged", "staged_loss"])
def test_the_stages_of_a_graduated_loss_have_to_be_there(stage):
    with pytest.raises(NotImplementedError, match=f"it needs {stage}"):
        getattr(Half(), stage)(*[np.ones(1)] * (1 + stage.startswith("staged")))


def changed(**methods):
    """A pseudo-Huber noise with other methods."""
    return type("Changed", (PseudoHuber,), methods)(2.0)


@pytest.mark.parametrize(
    ("noise", "text"),
    [
        (changed(slope=lambda n, s, k: 0.5 / np.sqrt(1.0 + s / 4.0)), "twice the derivative"),
        (changed(loss=lambda n, s, k: 2.0 * PseudoHuber.loss(n, s, k)), "twice the derivative"),
        (changed(loss=lambda n, s, k: 1.0 + PseudoHuber.loss(n, s, k)), "of a square of 0 is 1"),
        (changed(slope=lambda n, s, k: -PseudoHuber.slope(n, s, k)), "negative or grows"),
        (changed(slope=lambda n, s, k: 1.0 + s), "negative or grows"),
        (changed(slope=lambda n, s, k: np.sqrt(s, out=s)), "slope.* failed: ValueError"),
        (changed(loss=lambda n, s, k: s[..., None]), "returns shape"),
        (changed(slope=lambda n, s, k: s * np.nan), "the slope of a square of 0 is nan"),
        (changed(slope=lambda n, s, k: 1.0 / np.sqrt(s)), "of a square of 0 is inf.* not finite"),
    ],
)
def test_a_loss_and_a_slope_that_do_not_fit_are_refused(noise, text):
    with pytest.raises(pgm.ModelError, match=text):
        pgm.LinearGaussianCPD(z, {x: 1.0}, cov=1.0, noise=noise)


@pytest.mark.parametrize(
    "noise",
    [
        pgm.StudentT(1e-3),
        pgm.StudentT(1e6),
        pgm.Huber(1e-3),
        pgm.Huber(1e6),
        pgm.Cauchy(1e-3),
        pgm.TruncatedLeastSquares(1e-2),
        pgm.TruncatedLeastSquares(40.0),
    ],
)
def test_known_noise_is_sound(noise):
    noise.require_sound(1)
    noise.require_sound(3)
