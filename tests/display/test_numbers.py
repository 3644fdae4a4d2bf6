"""Numbers have as many digits as they are worth."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pgm.display import beside, column, count, number

reals = st.floats(-1e12, 1e12, allow_nan=False)


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.0, "0"),
        (-0.0, "0"),
        (1.0, "1"),
        (0.12345, "0.1235"),
        (-12345.678, "-12346"),
        (999999.4, "999999"),
        (1234567.0, "1.235e+06"),
        (0.00012346, "0.0001235"),
        (1e-12, "1e-12"),
        (1e300, "1e+300"),
        (math.nan, "nan"),
        (-math.inf, "-inf"),
    ],
)
def test_numbers_by_hand(value, text):
    assert number(value) == text


@given(reals)
def test_a_number_is_read_back_to_its_digits(value):
    np.testing.assert_allclose(float(number(value)), value, rtol=5.1e-4)


@given(st.lists(reals, min_size=1, max_size=9))
def test_a_column_is_read_back_to_its_digits(values):
    largest = max(map(abs, values))
    read = np.array([float(text) for text in column(values)])
    np.testing.assert_allclose(read, values, rtol=0.06, atol=5.1e-4 * largest)


@pytest.mark.parametrize(
    ("values", "texts"),
    [
        ([1.0, -2.0], ["1", "-2"]),
        ([1.5, -2.0, 0.0], ["1.5", "-2.0", "0"]),
        ([1000.0, 0.013], ["1000.000", "0.013"]),
        ([1.0, 1e-9], ["1", "1e-09"]),
        ([math.nan, 2.5], ["nan", "2.5"]),
        ([], []),
    ],
)
def test_columns_by_hand(values, texts):
    assert column(values) == texts


@pytest.mark.parametrize(
    ("mean", "std", "text"),
    [
        (12.345678, 0.1234, "12.346 ± 0.123"),
        (12345.678, 1234.0, "12346 ± 1234"),
        (1e9, 3.2e-5, "1.00000000"),
        (1.0, 0.0, "1 ± 0"),
        (0.1 + 0.2, 0.0, "0.3 ± 0"),
        (0.0, math.inf, "0 ± inf"),
        (math.nan, math.nan, "nan ± nan"),
        (1e-15, 0.2, "0.000 ± 0.200"),
        (-1e-15, 0.2, "0.000 ± 0.200"),
        (0.0, 2e9, "0 ± 2e+09"),
    ],
)
def test_means_by_their_deviations(mean, std, text):
    assert beside([mean], [std])[0].startswith(text)


@given(st.floats(-1e5, 1e5), st.floats(1e-4, 1e4))
def test_a_mean_is_read_back_within_a_hundredth_of_its_deviation(mean, std):
    for alike in (True, False):
        found, spread = map(float, beside([mean], [std], alike=alike)[0].split(" ± "))
        assert abs(found - mean) <= 0.0051 * std + 1e-12 * abs(mean)
        assert spread == pytest.approx(std, rel=0.0051)


def test_means_of_one_quantity_have_equal_decimals():
    cells = beside([1.0, 22.5, -3.0], [0.5, 0.123, 2.0])
    assert cells == [" 1.000 ± 0.500", "22.500 ± 0.123", "-3.000 ± 2.000"]
    assert beside([1.0, 22.5], [0.5, 0.123], alike=False) == [" 1.000 ± 0.500", "22.500 ± 0.123"]
    assert beside([1.0, 2.0], [1e-3, 10.0], alike=False) == [
        "1.00000 ± 0.00100",
        "    2.0 ±    10.0",
    ]


def test_counts():
    assert [count(k, "run") for k in (0, 1, 1000)] == ["0 runs", "1 run", "1,000 runs"]
    assert count(2, "entry", "entries") == "2 entries"
