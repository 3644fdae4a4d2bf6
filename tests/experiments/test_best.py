"""The best entries of a table: by hand, in groups, and none where there is nothing to choose."""

import doctest
import math

import pytest

from experiments import best
from experiments.best import best_cells

COLUMNS = ("rule", "s", "KL", "NEES")
ROWS = [
    ("Taylor", "0.1", "0.30 ±4%", "5.1"),
    ("Cubature", "0.1", "1e-2", "2.8 ± 0.4"),
    ("Taylor", "0.6", "1,200", "3.3"),
    ("Cubature", "0.6", "−4", "–"),
]


def test_lowest_highest_and_nearest():
    assert best_cells(COLUMNS, ROWS, {"KL": -math.inf}) == [(3, 2)]
    assert best_cells(COLUMNS, ROWS, {"KL": math.inf}) == [(2, 2)]
    assert best_cells(COLUMNS, ROWS, {"NEES": 3.0}) == [(1, 3)]


def test_each_group_has_its_own():
    found = best_cells(COLUMNS, ROWS, {"KL": -math.inf, "NEES": 3.0}, within=("s",))
    # A group whose other cells hold no number has nothing to choose.
    assert found == [(1, 2), (1, 3), (3, 2)]


def test_equal_ones_are_all_best_unless_all_are_equal():
    assert best_cells(("a",), [("1",), ("1.0",), ("2",)], {"a": -math.inf}) == [(0, 0), (1, 0)]
    assert best_cells(("a",), [("1",), ("1",)], {"a": -math.inf}) == []
    assert best_cells(("a",), [], {"a": -math.inf}) == []


def test_a_blank_first_cell_belongs_to_the_group_above():
    rows = [("grid", "2"), ("", "1"), ("ring", "5"), ("", "7")]
    assert best_cells(("n", "x"), rows, {"x": -math.inf}, within=("n",)) == [(1, 1), (2, 1)]


@pytest.mark.parametrize("words", [{"best": {"kl": 0.0}}, {"best": {}, "within": ("kl",)}])
def test_an_unknown_column_is_named(words):
    with pytest.raises(ValueError, match=r"no column 'kl'; it has rule, s, KL, NEES"):
        best_cells(COLUMNS, ROWS, **words)


def test_the_example():
    assert doctest.testmod(best).failed == 0
