"""What is written out is what LAPACK finds, and is exactly symmetric."""

import numpy as np
import pytest

from pgm.kernels import gaussian, straight

SIZES = [(1, 1), (1, 4), (2, 1), (2, 2), (2, 3), (3, 1), (3, 2), (3, 3), (4, 2), (5, 1)]


def covariance(rng, size):
    factor = rng.normal(size=(size, size))
    cov = factor @ factor.T + 0.1 * np.eye(size)
    return 0.5 * (cov + cov.T)


@pytest.fixture
def by_lapack(monkeypatch):
    """Calls a kernel with nothing written out."""

    def call(kernel, *arguments):
        with monkeypatch.context() as patch:
            patch.setattr(gaussian, "updating", lambda *size: None)
            patch.setattr(gaussian, "predicting", lambda *size: None)
            return kernel(*arguments)

    return call


def case(size, height):
    rng = np.random.default_rng(10 * size + height)
    mean, cov = rng.normal(size=size), covariance(rng, size)
    return (
        mean,
        cov,
        rng.normal(size=(height, size)),
        rng.normal(size=height),
        covariance(rng, height),
    )


@pytest.mark.parametrize(("size", "height"), SIZES)
def test_an_update(by_lapack, size, height):
    arguments = case(size, height)
    written = straight.updating(size, height, gaussian.NEARLY_SINGULAR)
    assert written is not None
    found, due = written(*arguments), by_lapack(gaussian.update_one, *arguments)
    for one, other in zip(found, due, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-11, atol=1e-13)
        assert np.shape(one) == np.shape(other)
    assert (found[1] == found[1].T).all()
    assert found[0].dtype == found[1].dtype == np.float64


@pytest.mark.parametrize(("size", "height"), SIZES)
def test_a_prediction(by_lapack, size, height):
    _, cov, matrix, _, noise = case(size, height)
    written = straight.predicting(height, size)
    assert written is not None
    found = written(cov, matrix, noise)
    np.testing.assert_allclose(found, by_lapack(gaussian.predict, cov, matrix, noise), rtol=1e-12)
    assert (found == found.T).all()


@pytest.mark.parametrize("least", [1e-6, 0.5])
def test_pivots_that_are_too_small(by_lapack, monkeypatch, least):
    """The same are refused: none, the second of nearly equal readings, all that is not finite."""
    monkeypatch.setattr(gaussian, "NEARLY_SINGULAR", least)
    cov, noise = np.diag([1.0, 2.0]), 1e-9 * np.eye(2)
    for gap in (0.0, 1e-5, 1e-2, 3.0):
        arguments = np.zeros(2), cov, np.array([[1.0, 0.0], [1.0, gap]]), np.ones(2), noise
        found, due = gaussian.update_one(*arguments), by_lapack(gaussian.update_one, *arguments)
        assert (found is None) == (due is None)
    for bad in (np.nan, np.inf, -1.0):
        broken = cov.copy()
        broken[0, 0] = bad
        with np.errstate(invalid="ignore"):
            assert gaussian.update_one(np.zeros(2), broken, np.eye(2), np.ones(2), noise) is None


def test_what_is_large_is_not_written_out():
    assert straight.updating(7, 3, 1e-6) is None
    assert straight.updating(1, 40, 1e-6) is None
    assert straight.predicting(7, 7) is None
    assert straight.updating(3, 0, 1e-6) is None
