"""Semirings against plain arithmetic."""

import numpy as np
import pytest

from pgm.kernels.semirings import LOG_SUM_PRODUCT, MAX_PRODUCT, SUM_PRODUCT, log_sum

VALUES = np.array([[0.2, 0.0, 3.0], [0.0, 0.0, 0.5]])


def test_logarithms_are_what_numbers_are():
    logs = LOG_SUM_PRODUCT.entries(VALUES)
    for axis in (0, 1, (0, 1)):
        out = np.empty(VALUES.sum(axis=axis).shape)
        found = LOG_SUM_PRODUCT.total(logs, axis, out)
        np.testing.assert_allclose(np.exp(found), VALUES.sum(axis=axis), rtol=1e-15)
        np.testing.assert_array_equal(SUM_PRODUCT.total(VALUES, axis, None), VALUES.sum(axis=axis))
        np.testing.assert_allclose(
            np.exp(MAX_PRODUCT.total(logs, axis, None)), VALUES.max(axis=axis), rtol=1e-15
        )
    assert np.array_equal(LOG_SUM_PRODUCT.logs(logs), logs)
    np.testing.assert_array_equal(SUM_PRODUCT.logs(VALUES[:, 2]), np.log(VALUES[:, 2]))


def test_zero_over_zero_is_zero():
    for semiring in (SUM_PRODUCT, LOG_SUM_PRODUCT):
        entries = semiring.entries(np.array([0.0, 0.5]))
        ratio = semiring.over(entries, semiring.divisor(entries))
        assert ratio.tolist() == [semiring.zero, semiring.one]


def test_sums_of_what_numbers_do_not_hold():
    logs = np.array([[-5000.0, -5001.0], [-np.inf, -np.inf], [800.0, -np.inf]])
    found = log_sum(logs, 1)
    assert found[0] == pytest.approx(-5000.0 + np.log1p(np.exp(-1.0)), rel=1e-15)
    assert found[1:].tolist() == [-np.inf, 800.0]


@pytest.mark.parametrize("count", [1, 2, 7, 8, 33, 1000])
@pytest.mark.parametrize("place", [0, -1])
def test_numpy_reports_underflow_everywhere(count, place):
    """Falling back to logarithms relies on it, in loops over vectors and their ends."""
    small, ones = np.ones(count), np.ones(count)
    small[place] = 1e-200
    with np.errstate(under="raise"):
        for multiply in (
            lambda: small * small,
            lambda: np.multiply.reduce(np.stack([small, ones, small]), 0),
            lambda: np.stack([small, ones]) * small,
            lambda: small / (1.0 / small),
            lambda: 1e-110 * (small * 1e-110),
        ):
            with pytest.raises(FloatingPointError, match="underflow"):
                multiply()


@pytest.mark.parametrize("log", [-709.0, -5000.0, 709.0, np.inf])
def test_logarithms_of_what_numbers_do_not_hold_are_refused(log):
    """Falling back to logarithms relies on this, too."""
    with pytest.raises(FloatingPointError):
        SUM_PRODUCT.of_logs(np.array([0.0, log]))
    assert SUM_PRODUCT.of_logs(np.array([0.0, -np.inf, -700.0])).tolist() == [
        1.0,
        0.0,
        np.exp(-700.0),
    ]
    assert LOG_SUM_PRODUCT.of_logs(np.array([log])).tolist() == [log]
