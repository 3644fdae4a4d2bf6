"""Robust noise of a user's own: the loss and its slope alone, everything else by integrals."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import quad
from scipy.optimize import minimize_scalar
from scipy.stats import kstest

import pgm
from pgm.cpds.robust import Radius

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


def test_an_integral_that_is_not_finite_is_told():
    with pytest.raises(pgm.ModelError, match=r"no finite integral: let is_proper\(2\) be False"):
        Flat().log_scale(2)


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
        (changed(slope=lambda n, s, k: s * np.nan), "not finite"),
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
