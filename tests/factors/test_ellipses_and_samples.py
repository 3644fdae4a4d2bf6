"""Gaussians as regions and as draws, against geometry and sample moments."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

import pgm
from pgm import Gaussian
from tests.dense import random_covariance

A = pgm.Variable("a")
B = pgm.Variable("b", components=("east", "north"))
X = pgm.Variable("x", components=("east", "north", "heading"), angles=("heading",))
COV = np.array([[4.0, 1.5, -0.3], [1.5, 2.0, 0.2], [-0.3, 0.2, 0.5]])


@pytest.mark.parametrize(
    ("pair", "index"), [(None, [0, 1]), (("heading", "east"), [2, 0]), (("north", "east"), [1, 0])]
)
@pytest.mark.parametrize("confidence", [0.5, 0.95])
def test_points_on_the_ellipse_have_one_mahalanobis_distance(confidence, pair, index):
    belief = Gaussian(X, [1.0, -2.0, 0.5], COV)
    centre, half_axes, orientation = belief.ellipse(confidence, components=pair)
    assert half_axes[0] >= half_axes[1]
    angle = np.linspace(0, 2 * np.pi, 13)
    turn = np.array(
        [
            [np.cos(orientation), -np.sin(orientation)],
            [np.sin(orientation), np.cos(orientation)],
        ]
    )
    offset = (np.stack([np.cos(angle), np.sin(angle)], axis=-1) * half_axes) @ turn.T
    inverse = np.linalg.inv(COV[np.ix_(index, index)])
    distance = np.einsum("ki,ij,kj->k", offset, inverse, offset)
    assert_allclose(distance, -2 * np.log(1 - confidence), rtol=1e-9)
    assert_allclose(centre, belief.mean[index])


def test_the_ellipse_of_95_percent():
    ellipse = Gaussian(B, [0, 0], [[9.0, 0.0], [0.0, 4.0]]).ellipse()
    assert_allclose(ellipse.half_axes**2 / [9.0, 4.0], 5.991, atol=5e-4)
    assert_allclose(ellipse.orientation, 0.0, atol=1e-15)
    upright = Gaussian(B, [0, 0], [[4.0, 0.0], [0.0, 9.0]]).ellipse()
    assert_allclose(upright.orientation, np.pi / 2)
    tilted = Gaussian(B, [0, 0], [[2.0, 1.0], [1.0, 2.0]]).ellipse()
    assert_allclose(tilted.orientation, np.pi / 4)


def test_the_orientation_is_that_of_an_axis_without_direction():
    due = np.radians(np.arange(-89.0, 90.0))
    cos, sin = np.cos(due), np.sin(due)
    long, short = np.stack([cos, sin], axis=-1), np.stack([-sin, cos], axis=-1)
    cov = 9.0 * long[:, :, None] * long[:, None] + 4.0 * short[:, :, None] * short[:, None]
    assert_allclose(Gaussian(B, np.zeros((179, 2)), cov).ellipse().orientation, due, atol=1e-14)


@pytest.mark.parametrize("tiny", [0.0, 1e-16, -1e-16, 1e-300, -1e-300])
@pytest.mark.parametrize(("east", "north"), [(4.0, 9.0), (9.0, 4.0)])
def test_the_orientation_is_above_minus_a_right_angle(east, north, tiny):
    belief = Gaussian(B, [0, 0], [[east, tiny], [tiny, north]])
    assert -np.pi / 2 < belief.ellipse().orientation <= np.pi / 2


def test_ellipses_of_flat_and_of_many_gaussians():
    flat = Gaussian(B, [0, 0], [[1.0, 1.0], [1.0, 1.0]]).ellipse()
    assert_allclose(flat.half_axes, [np.sqrt(2 * 5.991464547), 0.0], atol=1e-6)
    many = Gaussian(X, np.zeros((4, 5, 3)), COV).ellipse()
    assert many.centre.shape == many.half_axes.shape == (4, 5, 2)
    assert many.orientation.shape == (4, 5)


@pytest.mark.parametrize(
    ("scope", "arguments", "words"),
    [
        (A, {}, "two"),
        (B, {"confidence": 0.0}, "between 0 and 1"),
        (B, {"confidence": 1.0}, "between 0 and 1"),
        (B, {"confidence": 95}, "between 0 and 1"),
        (B, {"components": ("east", "up")}, "up"),
        ((B, X), {"components": ("east", "north")}, "east"),
        (B, {"components": ("east", "east")}, "east"),
    ],
)
def test_ellipses_that_cannot_be_drawn(scope, arguments, words):
    size = sum(v.dimension for v in (scope if isinstance(scope, tuple) else (scope,)))
    with pytest.raises(pgm.ModelError, match=words):
        Gaussian(scope, np.zeros(size), np.eye(size)).ellipse(**arguments)


@pytest.mark.parametrize("rank", [0, 1, 2, 3])
def test_sample_moments(rank):
    rng = np.random.default_rng(rank)
    mean, cov = rng.normal(size=3), random_covariance(rng, 3, rank)
    count = 40_000
    x = Gaussian((A, B), mean, cov).sample(count, rng=rng)
    assert x.shape == (count, 3)
    spread = np.sqrt(np.diag(cov) / count)
    assert (np.abs(x.mean(axis=0) - mean) <= 5 * spread + 1e-12).all()
    error = np.sqrt((np.outer(np.diag(cov), np.diag(cov)) + cov**2) / count)
    assert (np.abs(np.cov(x.T) - cov) <= 5 * error + 1e-12).all()
    assert np.linalg.matrix_rank(x - mean, tol=1e-6) == rank


def test_samples_are_reproducible_and_of_the_shape_asked_for():
    belief = Gaussian(B, np.zeros((5, 2)), np.eye(2))
    assert belief.sample(rng=1).shape == (5, 2)
    assert belief.sample((3, 4), rng=1).shape == (3, 4, 5, 2)
    np.testing.assert_array_equal(belief.sample(7, rng=3), belief.sample(7, rng=3))
    assert (belief.sample(7, rng=3) != belief.sample(7, rng=4)).all()
    rng = np.random.default_rng(3)
    np.testing.assert_array_equal(belief.sample(7, rng=rng), belief.sample(7, rng=3))
    assert (belief.sample(7, rng=rng) != belief.sample(7, rng=3)).all()
