"""CPDs of discrete variables: what they hold, and what they refuse."""

import copy
import pickle

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import pgm
from pgm import Discrete, TableCPD

CLOUDY = Discrete("cloudy", states=("no", "yes"))
RAIN = Discrete("rain", states=("none", "some", "much"))
WET = Discrete("wet", states=("no", "yes"))
ROWS = [[0.7, 0.2, 0.1], [0.1, 0.3, 0.6]]


def test_the_last_axis_is_the_child():
    cpd = TableCPD(RAIN, given=(CLOUDY,), table=ROWS)
    assert cpd.child == RAIN
    assert cpd.given == cpd.parents == (CLOUDY,)
    assert cpd.scope == (RAIN, CLOUDY)
    assert_array_equal(cpd.table, ROWS)
    assert cpd.table.dtype == float
    assert cpd.discrete
    three = TableCPD(WET, (RAIN, CLOUDY), table=np.full((3, 2, 2), 0.5))
    assert three.given == (RAIN, CLOUDY)
    assert three.table.shape == (3, 2, 2)


def test_without_parents():
    cpd = TableCPD(RAIN, table=[0.5, 0.25, 0.25])
    assert cpd.given == ()
    assert_array_equal(cpd.table, [0.5, 0.25, 0.25])


def test_a_single_parent_needs_no_tuple():
    assert TableCPD(RAIN, CLOUDY, table=ROWS).given == (CLOUDY,)


def test_a_variable_of_one_state():
    one = Discrete("one", states=("always",))
    assert_array_equal(TableCPD(one, table=[1]).table, [1.0])
    assert TableCPD(RAIN, one, table=[[0, 1, 0]]).table.shape == (1, 3)
    assert TableCPD(one, RAIN, table=np.ones((3, 1))).table.shape == (3, 1)


def test_deterministic_tables_are_ordinary():
    assert_array_equal(TableCPD(WET, CLOUDY, table=[[1, 0], [0, 1]]).table, np.eye(2))


@pytest.mark.parametrize("size", [2, 3, 6, 7, 13, 30, 1000])
def test_entries_of_six_decimals_are_kept_as_they_are(size):
    table = np.full(size, round(1 / size, 6))
    assert_array_equal(TableCPD(Discrete("many", size), table=table).table, table)


def test_entries_that_are_all_rounded_the_same_way():
    """The worst that rounding to six decimals does, whose sum in floating point is beyond it."""
    for size in range(2, 200):
        for error in (5e-7, -5e-7):
            table = np.full(size, 1 / size + error)
            assert_array_equal(TableCPD(Discrete("many", size), table=table).table, table)


@pytest.mark.parametrize("last", [0.3334, 0.33333])
def test_cruder_thirds_are_refused(last):
    with pytest.raises(pgm.ModelError, match=r"divide the table by table\.sum\(-1, keepdims=True"):
        TableCPD(RAIN, table=[1 / 3, 1 / 3, last])


@pytest.mark.parametrize("error", [1.4e-6, -1.4e-6])
def test_a_tiny_deviation_is_kept_as_it_is(error):
    table = np.array([0.5, 0.25, 0.25 + error])
    assert_array_equal(TableCPD(RAIN, table=table).table, table)


@pytest.mark.parametrize("error", [1.6e-6, -1.6e-6, 0.5])
def test_columns_must_sum_to_one(error):
    table = np.array(ROWS)
    table[1, 2] += error
    with pytest.raises(
        pgm.ModelError, match=r"TableCPD\(rain \| cloudy\): .* for cloudy='yes'"
    ) as e:
        TableCPD(RAIN, CLOUDY, table=table)
    assert f"sum to {table[1].sum():.9g}" in str(e.value)
    assert e.value.variable == RAIN
    assert e.value.cpd.child == RAIN
    with pytest.raises(pgm.ModelError, match=r"TableCPD\(rain\): the probabilities sum to"):
        TableCPD(RAIN, table=table[1])


def test_a_table_whose_first_axis_is_the_child_is_refused():
    with pytest.raises(pgm.ModelError, match=r"\(3, 2\); the axes \(cloudy, rain\) need \(2, 3\)"):
        TableCPD(RAIN, CLOUDY, table=np.transpose(ROWS))
    square = np.array([[0.9, 0.2], [0.1, 0.8]])  # columns sum to one, rows do not
    with pytest.raises(pgm.ModelError, match="the last axis, the child's"):
        TableCPD(WET, CLOUDY, table=square)


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ([0.5, 0.5], r"shape \(2,\)"),
        (1.0, r"shape \(\)"),
        ([], r"shape \(0,\)"),
        ([[0.2, 0.3, 0.5]], r"shape \(1, 3\)"),
        ([1.5, -0.5, 0.0], "negative"),
        ([np.nan, 0.5, 0.5], "NaN"),
        ([np.inf, 0.0, 0.0], "infinite"),
        (["many", "few", "none"], "must be numbers"),
        ([[0.5, 0.5], [1.0]], "must be numbers, not rows of unequal length"),
        (None, "must be numbers, not NoneType"),
    ],
)
def test_malformed_tables_are_refused(table, words):
    with pytest.raises(pgm.ModelError, match=words) as caught:
        TableCPD(RAIN, table=table)
    assert "rain" in str(caught.value)
    assert caught.value.cpd.child == RAIN


@pytest.mark.parametrize(
    ("child", "given", "words"),
    [
        ("rain", (), "child is a variable"),
        (pgm.Variable("x"), (), "x is continuous"),
        (RAIN, pgm.Variable("x"), "x is continuous"),
        (RAIN, RAIN, "own parent"),
        (RAIN, (CLOUDY, CLOUDY), "TableCPD of rain: given holds cloudy twice"),
        (RAIN, "cloudy", r"TableCPD of rain: given holds variables, not 'cloudy'; give the"),
        (RAIN, ("cloudy",), r"TableCPD of rain: given holds variables, not 'cloudy'"),
        (RAIN, 3, r"TableCPD of rain: given holds variables, not 3"),
        (RAIN, None, r"TableCPD of rain: given holds variables, not None"),
        (RAIN.previous, (), r"cannot be rain\[t-1\]"),
    ],
)
def test_malformed_families_are_refused(child, given, words):
    with pytest.raises(pgm.ModelError, match=words):
        TableCPD(child, given, table=np.full((2, 3), 1 / 3))


def test_a_gaussian_cpd_takes_no_discrete_variable():
    with pytest.raises(pgm.ModelError, match=r"rain is discrete.*TableCPD.*SwitchingCPD"):
        pgm.GaussianCPD(RAIN, 0.0, 1.0)
    with pytest.raises(pgm.ModelError, match="rain is discrete"):
        pgm.LinearGaussianCPD(pgm.Variable("x"), given={RAIN: 1.0}, cov=1.0)


def test_a_copy_at_a_step():
    cpd = TableCPD(RAIN, RAIN.previous, table=np.full((3, 3), 1 / 3))
    placed = cpd.at(4)
    assert (placed.child, placed.given) == (RAIN.at(4), (RAIN.at(3),))
    assert placed.table is cpd.table
    assert placed.origin is cpd
    assert cpd.origin is cpd


def test_immutable_and_compared_by_identity():
    table = np.array(ROWS)
    cpd = TableCPD(RAIN, CLOUDY, table=table)
    twin = TableCPD(RAIN, CLOUDY, table=table)
    table[0] = 0.0
    assert_array_equal(cpd.table, ROWS)
    with pytest.raises(ValueError, match="read-only"):
        cpd.table[0, 0] = 1.0
    with pytest.raises(AttributeError, match="immutable"):
        cpd.table = table
    assert cpd == cpd
    assert cpd != twin
    assert len({cpd, twin}) == 2


@pytest.mark.parametrize(
    "way", [copy.copy, copy.deepcopy, lambda cpd: pickle.loads(pickle.dumps(cpd))]
)
def test_copied_and_pickled(way):
    cpd = TableCPD(RAIN, CLOUDY, table=ROWS)
    twin = way(cpd)
    assert repr(twin) == repr(cpd) == "TableCPD(rain | cloudy)"
    assert twin.scope == cpd.scope
    assert_array_equal(twin.table, cpd.table)


def test_the_table_is_a_factor_over_parents_and_child():
    cpd = TableCPD(RAIN, CLOUDY, table=ROWS)
    factor = pgm.Table((*cpd.given, cpd.child), cpd.table)
    assert_allclose(factor.marginalise(RAIN).log_values, [0.0, 0.0], atol=1e-15)
    assert factor["yes", "much"] == 0.6
