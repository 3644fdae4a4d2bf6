"""Parts of stacked Gaussians, against the same parts of their arrays."""

import numpy as np
import pytest
from numpy.testing import assert_array_equal

import pgm
from tests.dense import random_covariance

x = pgm.Variable("x", components=("east", "north"))
RNG = np.random.default_rng(0)
MEAN, COV = RNG.normal(size=(3, 4, 6, 2)), random_covariance(RNG, 2, lead=(3, 4, 6))
STEPS = np.arange(2, 8)
STACK = pgm.Gaussian(x, MEAN, COV, steps=STEPS)
EVEN = np.arange(6) % 2 == 0


ALL = slice(None)


@pytest.mark.parametrize(
    ("index", "axes", "steps"),
    [
        (1, (1, ALL, ALL), STEPS),
        (np.s_[1:], (np.s_[1:], ALL, ALL), STEPS),
        (np.s_[0, 2], (0, 2, ALL), STEPS),
        (np.s_[..., 3], (ALL, ALL, 3), None),
        (np.s_[..., -1], (ALL, ALL, -1), None),
        (np.s_[..., 1:5:2], (ALL, ALL, np.s_[1:5:2]), STEPS[1:5:2]),
        (np.s_[:, 1, ::-1], (ALL, 1, np.s_[::-1]), STEPS[::-1]),
        (np.s_[2, 3, 5], (2, 3, 5), None),
        (np.s_[..., EVEN], (ALL, ALL, np.s_[::2]), STEPS[::2]),
        (np.s_[..., [4, 4, 0]], (ALL, ALL, [4, 4, 0]), STEPS[[4, 4, 0]]),
        (np.s_[2, ..., [1]], (2, ALL, np.s_[1:2]), STEPS[1:2]),
        (np.s_[np.int64(2), ..., np.int64(1)], (2, ALL, 1), None),
        (np.s_[..., []], (ALL, ALL, np.s_[:0]), STEPS[:0]),
        (np.s_[()], (ALL, ALL, ALL), STEPS),
        (..., (ALL, ALL, ALL), STEPS),
    ],
)
def test_parts_are_those_of_the_arrays(index, axes, steps):
    found, (first, second, third) = STACK[index], axes
    assert_array_equal(found.mean, MEAN[:, :, third][:, second][first])
    assert_array_equal(found.cov, COV[:, :, third][:, second][first])
    if steps is None:
        assert found.steps is None
    else:
        assert_array_equal(found.steps, steps)
    for array in (found.mean, found.cov):
        assert not array.flags.writeable


def test_rows_of_several_axes_are_taken_axis_by_axis():
    found = STACK[[0, 2], :, EVEN]
    assert_array_equal(found.mean, MEAN[np.ix_([0, 2], range(4), [0, 2, 4])])
    assert_array_equal(found.steps, STEPS[EVEN])


def test_a_posterior_over_time():
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(x, [0, 0], np.eye(2))],
        [pgm.LinearGaussianCPD(x, {x.previous: 1.0}, cov=np.eye(2))],
    )
    found = pgm.filter(model, {}, steps=9)[x]
    assert_array_equal(found[3:6].steps, [3, 4, 5])
    assert_array_equal(found[3:6].cov, found.cov[3:6])
    assert found[4].mean.shape == (2,)


@pytest.mark.parametrize(
    ("index", "words"),
    [
        (3, r"Gaussian\(x\), runs \(3, 4\), steps 2..7: index 3 is out of bounds"),
        (np.s_[..., [0, 9]], "index 9 is out of bounds"),
        (np.s_[0, 0, 0, 0], r"has 3 leading axes; \[0, 0, 0, 0\]"),
        (np.s_[..., 0, ...], r"has 3 leading axes; \[\.\.\., 0, \.\.\.\]"),
        (np.s_[..., EVEN[:4]], "boolean"),
        ("east", "'east' picks nothing; give a number"),
        (1.0, "1.0 picks nothing"),
        (True, "True picks nothing"),
        (None, "None picks nothing"),
        (np.s_["a":], "picks nothing"),
        ([[0, 1]], "picks nothing"),
        (x, "x picks nothing"),
    ],
)
def test_places_that_there_are_not(index, words):
    with pytest.raises(pgm.ModelError, match=words):
        STACK[index]


def test_one_gaussian_has_no_parts():
    with pytest.raises(pgm.ModelError, match=r"has 0 leading axes; \[0\]"):
        STACK[0, 0, 0][0]
    with pytest.raises(TypeError, match="not iterable"):
        iter(STACK)
