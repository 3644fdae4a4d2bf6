"""The algebra of tables, against dense arrays, enumeration and exact fractions."""

import copy
import itertools
import math
import pickle
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.testing import assert_allclose, assert_array_equal

import pgm
from pgm import Discrete, Table
from tests.dense import algebra

A = Discrete("a", states=("no", "yes"))
B = Discrete("b", states=("low", "middle", "high"))
C = Discrete("c", states=4)
ONE = Discrete("one", states=("always",))
LETTERS = {A: "a", B: "b", C: "c", ONE: "o"}
SCOPES = [(), (A,), (B,), (A, B), (B, C), (C, A), (B, ONE), (C, B, A)]

ordinary = st.one_of(st.just(0.0), st.floats(0.0, 9.0).map(lambda value: round(value, 2)))
# What products of a few of these overflow or underflow.
extreme = st.sampled_from([0.0, 5e-324, 1e-310, 1e-300, 1e-160, 1e-8, 0.7, 1.0, 3.0, 1e150, 1e308])


def shape(scope):
    return tuple(v.size for v in scope)


@st.composite
def tables(draw, scope=None, entries=ordinary, positive=False):
    scope = draw(st.sampled_from(SCOPES)) if scope is None else scope
    values = draw(arrays(float, shape(scope), elements=entries))
    if positive:
        values = values + 0.1
    return Table(scope, values, draw(st.floats(-20, 20)))


def dense(table):
    """The entries as numbers, in the order of the table's own scope."""
    return table.values * np.exp(table.log_scale)[(..., *[None] * len(table.scope))]


def letters(scope):
    return "".join(LETTERS[v] for v in scope)


def wide(array, own, scope):
    """An array over its own scope as one over another, by enumeration of all states."""
    result = np.empty(shape(scope))
    for states in itertools.product(*(range(v.size) for v in scope)):
        at = dict(zip(scope, states, strict=True))
        result[states] = array[tuple(at[v] for v in own)]
    return result


def assert_entries(table, due, rtol=1e-12):
    assert table.values.shape == due.shape
    assert_allclose(dense(table), due, rtol=rtol, atol=0.0)


def assert_within_reach(table):
    """The largest entry is far from what numbers do not hold, whose products thus are numbers."""
    top = table.values.max()
    assert top == 0.0 or 1e-100 <= top <= 1e100
    if top == 0.0:
        assert table.log_scale == 0.0


@algebra
@given(tables(), tables())
def test_a_product_is_that_of_the_entries(f, g):
    product = f * g
    due = np.einsum(
        f"{letters(f.scope)},{letters(g.scope)}->{letters(product.scope)}", dense(f), dense(g)
    )
    assert set(product.scope) == {*f.scope, *g.scope}
    assert_entries(product, due)
    assert_within_reach(product)
    assert_entries((g * f).rearrange(product.scope), due)


@algebra
@given(tables(), tables(), tables())
def test_products_associate(f, g, h):
    left = (f * g) * h
    assert_entries(left, dense((f * (g * h)).rearrange(left.scope)))


@algebra
@given(tables(), tables())
def test_a_quotient_undoes_a_product_where_the_divisor_is_not_zero(f, g):
    quotient = (f * g) / g
    divisor = wide(dense(g), g.scope, quotient.scope)
    assert_entries(quotient, np.where(divisor > 0, wide(dense(f), f.scope, quotient.scope), 0.0))
    assert_within_reach(quotient)


@algebra
@given(tables(), tables(positive=True))
def test_a_quotient_is_that_of_the_entries(f, g):
    quotient = f / g
    due = wide(dense(f), f.scope, quotient.scope) / wide(dense(g), g.scope, quotient.scope)
    assert_entries(quotient, due)


@algebra
@given(tables((A, B)))
def test_a_wider_or_reordered_scope_changes_no_entry(f):
    for scope in itertools.permutations((A, B, C, ONE)):
        extended = f.extend(scope)
        assert extended.scope == scope
        assert_entries(extended, wide(dense(f), (A, B), scope))
    assert f.rearrange((B, A)).scope == (B, A)
    assert f.extend((A, B)) is f


@algebra
@given(tables((C, B, A)))
def test_marginals_are_sums_and_maxima(f):
    for count in range(4):
        for keep in itertools.permutations((A, B, C), count):
            due = np.einsum(f"cba->{letters(keep)}", dense(f))
            marginal = f.marginal(*keep)
            assert marginal.scope == keep
            assert_entries(marginal, due)
            drop = [v for v in (B, C, A) if v not in keep]
            axes = tuple("cba".index(LETTERS[v]) for v in drop)
            best = f.maximise(*drop)
            assert best.scope == tuple(v for v in (C, B, A) if v in keep)
            assert_entries(best, dense(f).max(axis=axes))
            if drop:
                assert_within_reach(marginal)
                assert_within_reach(best)


@algebra
@given(tables((A, B, C)))
def test_variables_are_summed_and_maximised_out_in_any_order(f):
    assert_entries(f.marginalise(A, B), dense(f.marginalise(B).marginalise(A)))
    assert_entries(f.marginalise(B, A), dense(f.marginal(C)))
    assert_entries(f.maximise(A, C), dense(f.maximise(C).maximise(A)))


@algebra
@given(tables((A, B)), tables((B, C)))
def test_a_sum_moves_past_a_factor_without_the_variable(f, g):
    """The distributive law, which variable elimination is made of."""
    early = f * g.marginalise(C)
    assert_entries((f * g).marginalise(C), dense(early))
    assert_entries((f * g).maximise(C), dense(f * g.maximise(C)))


@algebra
@given(tables((C, B, A)), st.integers(0, 1), st.integers(0, 2))
def test_reducing_puts_states_in(f, a, b):
    assert_array_equal(f.reduce({A: a}).values, f.values[:, :, a])
    assert f.reduce({A: a}).scope == (C, B)
    for evidence in ({A: a, B: b}, {B: B.states[b], A: A.states[a]}):
        reduced = f.reduce(evidence)
        assert reduced.scope == (C,)
        assert_entries(reduced, dense(f)[:, b, a])
    assert_entries(f.reduce({A: a}).marginalise(C), dense(f.marginalise(C).reduce({A: a})))
    assert f.reduce({}).scope == f.scope


@algebra
@given(tables())
def test_total_logs_and_normalisation(f):
    total = dense(f).sum()
    with np.errstate(divide="ignore"):
        assert_allclose(f.log_total, np.log(total), rtol=1e-12, atol=1e-12)
        assert_allclose(f.log_values, np.log(dense(f)), rtol=1e-12, atol=1e-12)
    if total == 0.0:
        with pytest.raises(pgm.NumericalError, match="all zero"):
            f.normalised()
        return
    normalised = f.normalised()
    assert normalised.log_scale == 0.0
    assert_allclose(normalised.values, dense(f) / total, rtol=1e-12)
    assert_array_equal(f.probabilities, normalised.values)
    assert_allclose(normalised.log_total, 0.0, atol=1e-14)


@algebra
@given(tables())
def test_the_largest_entry(f):
    if not f.values.any():
        with pytest.raises(pgm.NumericalError, match="all zero"):
            f.argmax()
        return
    best = f.argmax()
    assert tuple(best) == f.scope
    # The first of equal ones, in the order of the states.
    every = itertools.product(*(v.states for v in f.scope))
    due = max(every, key=lambda states: f.values[tuple(map(Discrete.index, f.scope, states))])
    assert tuple(best.values()) == due


def exact(scope, values):
    """The entries as fractions, by state indices."""
    return {index: Fraction(float(values[index])) for index in np.ndindex(*shape(scope))}


def log(fraction):
    return math.log(fraction.numerator) - math.log(fraction.denominator)


def assert_exact(table, due):
    """Compare with fractions; what is below 1e-300 of the largest may be lost."""
    top = max(due.values())
    if top == 0:
        assert_array_equal(table.values, 0.0)
        assert table.log_scale == 0.0
        assert table.log_total == -np.inf
        return
    entries = table.log_values
    for index, entry in due.items():
        if entry > top * Fraction(1e-300):
            assert_allclose(entries[index], log(entry), rtol=1e-13, atol=1e-12)
        elif entry == 0:
            assert table.values[index] == 0.0
    assert_allclose(table.log_total, log(sum(due.values())), rtol=1e-13, atol=1e-12)


@algebra
@given(tables((A, B), extreme), tables((B, C), extreme))
def test_extreme_entries_neither_overflow_nor_vanish(f, g):
    f, g = Table(f.scope, f.values), Table(g.scope, g.values)
    p, q = exact(f.scope, f.values), exact(g.scope, g.values)
    joint = {(a, b, c): p[a, b] * q[b, c] for a, b, c in np.ndindex(2, 3, 4)}
    assert_exact(f * g, joint)
    assert_exact(f.marginalise(A), {(b,): p[0, b] + p[1, b] for b in range(3)})
    assert_exact(f.maximise(B), {(a,): max(p[a, b] for b in range(3)) for a in range(2)})
    assert_exact(f, p)
    kept = {(a, b): p[a, b] if g.values[b, 0] > 0 else Fraction(0) for a, b in p}
    quotient = {(a, b): kept[a, b] / q[b, 0] if q[b, 0] else Fraction(0) for a, b in p}
    assert_exact(
        Table((A, B), np.where(g.values[:, 0] > 0, f.values, 0.0)) / g.reduce({C: 0}), quotient
    )


def test_ordinary_tables_keep_their_values_and_their_log_scale():
    f = Table((A, B), [[0.1, 0.2, 0.05], [0.3, 0.25, 0.1]], 2.0)
    results = {
        "marginal": (f.marginal(A), [0.35, 0.65], 2.0),
        "maximum": (f.maximise(A), [0.3, 0.25, 0.1], 2.0),
        "product": (f.marginal(A) * Table(A, [1e-40, 2.0], 1.0), [3.5e-41, 1.3], 3.0),
        "small": (f.marginal(A) * Table(A, [1e-40, 2e-40]), [3.5e-41, 1.3e-40], 2.0),
        "quotient": (f.marginal(A) / Table(A, [1e40, 2e40], 1.0), [3.5e-41, 3.25e-41], 1.0),
    }
    for name, (table, values, scale) in results.items():
        assert_allclose(table.values, values, rtol=1e-14, err_msg=name)
        assert table.log_scale == scale, name
    for entry in (1e-101, 1e101):
        rescaled = Table((A, B), np.full((2, 3), entry)).maximise(A)
        assert_array_equal(rescaled.values, 1.0)
        assert_allclose(rescaled.log_scale, np.log(entry))


def test_small_products_keep_entries_that_numbers_do_not_hold():
    """The largest is an ordinary number; the other is lost but for the exponents."""
    product = Table(A, [1e-60, 1e-200]) * Table(A, [1e-30, 1e-150])
    assert_allclose(product.log_values, np.log(10) * np.array([-90, -350]), rtol=1e-14)
    quotient = Table(A, [1e-90, 1e-250]) / Table(A, [1.0, 1e100])
    assert_allclose(quotient.log_values, np.log(10) * np.array([-90, -350]), rtol=1e-14)
    runs = Table(A, [[1e-60, 1e-200], [1.0, 0.5]], lead=2) * Table(A, [1e-30, 1e-150])
    assert_array_equal(runs.values[0], product.values)
    assert_array_equal(runs.values[1], [1e-30, 0.5e-150])
    assert runs.log_scale[1] == 0.0


def test_too_many_axes_are_refused():
    many = [Discrete(f"v{k}", 1) for k in range(61)]
    with pytest.raises(pgm.ModelError, match=r"over 61 variables: NumPy's arrays have axes for 60"):
        Table.vacuous(many)
    assert Table.vacuous(many[:60]).log_total == 0.0


def test_products_of_small_entries_do_not_become_zero():
    rng = np.random.default_rng(3)
    belief, logs = Table.vacuous(A), np.zeros(2)
    for _ in range(1000):
        values = 1e-300 * rng.uniform(0.5, 1.0, 2)
        belief *= Table(A, values)
        logs += np.log(values)
    assert logs.max() < -600_000
    assert_allclose(belief.log_total, np.logaddexp.reduce(logs), rtol=1e-14)
    assert_allclose(belief.log_values, logs, rtol=1e-14)
    assert_allclose(belief.probabilities[0] / belief.probabilities[1], np.exp(np.subtract(*logs)))


def test_small_entries_that_meet_only_small_entries_do_not_vanish():
    f = Table(B, [1.0, 1e-200, 0.0]) * Table(B, [0.0, 1e-200, 1.0])
    assert_allclose(f.log_total, 2 * np.log(1e-200), rtol=1e-14)
    assert f.argmax() == {B: "middle"}


def test_entries_far_below_the_largest_keep_their_ratio():
    product = Table(A, [1.0, 1e-200]) * Table(A, [1e-200, 1e-150])
    assert_allclose(np.subtract(*product.log_values), 150 * np.log(10), rtol=1e-13)
    quotient = Table(B, [1e-300, 2e-300, 0.0]) / Table(B, [1e300, 1e300, 1.0])
    assert_allclose(quotient.probabilities, [1 / 3, 2 / 3, 0.0])
    assert_allclose(quotient.log_total, np.log(3) - 600 * np.log(10), rtol=1e-13)


def test_only_the_run_in_need_is_rescued():
    f = Table(B, [[1.0, 1e-200, 0.0], [0.5, 0.25, 0.25], [1.0, 0.0, 0.0]], lead=3)
    product = f * Table(B, [0.0, 1e-200, 1.0])
    assert_allclose(product.log_total[0], 2 * np.log(1e-200))
    assert_allclose(product.log_total[1], np.log(0.25))
    assert product.log_total[2] == -np.inf


def test_a_quotient_beyond_all_numbers_keeps_its_logarithm():
    quotient = Table(A, [1.0, 1.0]) / Table(A, [1.0, 5e-324])
    assert_allclose(quotient.log_total, -np.log(5e-324), rtol=1e-14)
    assert quotient.argmax() == {A: "yes"}


@pytest.mark.parametrize(
    "zero",
    [
        Table(A, [0.0, 0.0], 7.0),
        Table(A, [0.2, 0.8], -np.inf),
        Table._make((A,), np.zeros(2), -np.inf),
    ],
)
def test_an_all_zero_table_is_legal(zero):
    other = Table((A, B), np.arange(6.0).reshape(2, 3), 3.0)
    results = [zero * other, other * zero, zero / other.extend((B, A)).marginal(A), zero / zero]
    results += [zero.extend((B, A)) * other, (zero * other).marginal(B), zero.maximise(A)]
    for result in results:
        assert_array_equal(result.values, 0.0)
        assert result.log_scale == 0.0
    for table in (zero, *results):
        assert table.log_total == -np.inf
        assert_array_equal(table.log_values, -np.inf)
    assert zero["yes"] == 0.0
    with pytest.raises(pgm.NumericalError, match="neither probabilities"):
        zero.normalised()
    with pytest.raises(pgm.NumericalError, match="divisor is zero"):
        other / zero


def test_the_run_without_a_total_is_named():
    with pytest.raises(pgm.NumericalError, match=r"over \(a\) is all zero \(first in run 2\)"):
        Table(A, [[1, 0], [0, 1], [0, 0], [0, 0]], lead=4).normalised()
    with pytest.raises(pgm.NumericalError, match=r"first in run \(0, 1\)"):
        Table(A, [[[1, 0], [0, 0]]], lead=(1, 2)).argmax()


def test_dividing_by_zero_names_the_states():
    with pytest.raises(pgm.NumericalError, match=r"where a='yes', b='low', the divisor is zero"):
        Table((A, B), [[0, 1, 1], [1, 1, 1]]) / Table(B, [0, 1, 1])
    with pytest.raises(pgm.NumericalError, match="where b='high'"):
        Table(B, np.ones((4, 3)), lead=4) / Table(B, [1, 1, 0])


@pytest.mark.parametrize("lead", [(5,), (2, 3), (1,)])
def test_a_batch_is_its_singles(lead):
    rng = np.random.default_rng(1)

    def draw(scope):
        values = rng.uniform(size=(*lead, *shape(scope))) * 10.0 ** rng.integers(
            -9, 9, (*lead, 1, 1)
        )
        return Table(scope, values, rng.normal(scale=300.0, size=lead), lead=lead)

    def results(f, g):
        product = f * g
        return {
            "product": product,
            "quotient": f / g,
            "marginal": product.marginal(C, A),
            "maximum": product.maximise(B),
            "reduced": product.reduce({B: "high"}),
            "rearranged": product.rearrange((C, A, B)),
            "normalised": product.normalised(),
        }

    f, g = draw((A, B)), draw((B, C))
    batch = results(f, g)
    for k in np.ndindex(lead):
        one, other = (Table(t.scope, t.values[k], t.log_scale[k]) for t in (f, g))
        for name, single in results(one, other).items():
            assert batch[name].scope == single.scope
            assert_allclose(batch[name].values[k], single.values, rtol=1e-14, err_msg=name)
            assert_allclose(batch[name].log_scale[k], single.log_scale, rtol=1e-14, err_msg=name)
        assert_allclose(f.log_total[k], one.log_total, rtol=1e-14)
        best = f.argmax()
        assert {v: v.states[index[k]] for v, index in best.items()} == one.argmax()


def test_leading_axes_broadcast():
    f = Table(A, np.ones((4, 1, 2)), np.zeros(3), lead=(4, 3))
    assert f.values.shape == (4, 3, 2)
    assert f.log_scale.shape == (4, 3)
    g = Table((B, A), np.arange(18.0).reshape(3, 3, 2) + 1, lead=3)
    for product in (f * g, g * f, g / f):
        assert product.log_scale.shape == (4, 3)
        assert product.values.shape[:2] == (4, 3)
        assert_allclose(dense(product.rearrange((B, A)))[2, 1], g.values[1], rtol=1e-14)
    assert (Table.vacuous((A, B)) * g).log_total.shape == (3,)
    with pytest.raises(pgm.ModelError, match="do not broadcast"):
        Table(A, np.ones((2, 2)), lead=2) * Table(A, np.ones((3, 2)), lead=3)
    with pytest.raises(pgm.ModelError, match="do not broadcast"):
        Table(A, np.ones((2, 2)), np.zeros(3), lead=2)


def test_no_run_is_no_trouble():
    none = Table((A, B), np.ones((0, 2, 3)), lead=0)
    assert none.argmax()[B].shape == (0,)
    assert (none * Table.vacuous((B, C))).marginal(C).values.shape == (0, 4)
    assert none.normalised().log_total.shape == (0,)


def test_constants():
    one = Table.vacuous((A, B))
    assert_array_equal(one.values, np.ones((2, 3)))
    f = Table((B, A), np.arange(6.0).reshape(3, 2), 0.1)
    for same in (f * one, f / one, one * f):
        assert_entries(same.rearrange((B, A)), dense(f))
    assert_allclose(Table.uniform((A, B)).values, 1 / 6)
    assert Table.vacuous(()).log_total == 0.0
    assert Table.vacuous(ONE).normalised()["always"] == 1.0


def test_reading_entries():
    f = Table((A, B), [[1, 2, 3], [4, 5, 6]], log_scale=np.log(10))
    assert_allclose(f["yes", "low"], 40.0)
    assert f["yes", "low"] == f[1, 0] == f["yes", 0]
    g = Table(A, [0.25, 0.75])
    assert g["yes"] == g[1] == 0.75
    assert g["yes",] == 0.75
    assert isinstance(g["yes"], float)
    assert f"{g['yes']:.2f}" == "0.75"
    runs = Table(A, [[0.25, 0.75], [0.5, 0.5]], log_scale=[0.0, 1.0], lead=2)
    assert_allclose(runs["no"], [0.25, 0.5 * np.e])
    assert Table((), 3.0)[()] == 3.0


def test_entries_that_only_the_product_can_hold():
    assert_allclose(
        Table(A, [1e300, 0.0], -1000.0)["no"], np.exp(300 * np.log(10) - 1000), rtol=1e-12
    )
    assert_allclose(
        Table(A, [1e-200, 0.0], 800.0)["no"], np.exp(800 - 200 * np.log(10)), rtol=1e-12
    )
    assert Table(A, [1.0, 0.0], 800.0)["yes"] == 0.0
    assert Table(A, [1.0, 0.0], -1e300)["no"] == 0.0
    with pytest.raises(pgm.NumericalError, match="a='no' is too large for a number"):
        Table(A, [1.0, 0.0], 1e300)["no"]


@pytest.mark.parametrize("states", ["yes", (), ("yes", "low", "no"), 0])
def test_a_state_for_each_variable_is_due(states):
    with pytest.raises(pgm.ModelError, match=r"\(a, b\) is read at one state of each"):
        Table.vacuous((A, B))[states]


@pytest.mark.parametrize("state", ["maybe", 2, -1, 1.0, True, None])
def test_unknown_states_are_refused(state):
    with pytest.raises(pgm.ModelError, match="a has no state"):
        Table.vacuous(A)[state]
    with pytest.raises(pgm.ModelError, match="a has no state"):
        Table.vacuous((A, B)).reduce({A: state})


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (((A, B), np.ones((3, 2))), r"shape \(3, 2\); it must end in \(2, 3\)"),
        ((A, 1.0), "must end in"),
        ((A, [1, 2, 3]), "must end in"),
        ((A, [[1, 2], [3]]), "must be numbers"),
        ((A, "yes"), "must be numbers"),
        ((A, [0.5, -0.5]), "negative"),
        ((A, [0.5, np.nan]), "NaN"),
        ((A, [0.5, np.inf]), "infinite"),
        ((A, [0.5, 0.5], np.nan), "log_scale must be finite"),
        ((A, [0.5, 0.5], np.inf), "log_scale must be finite"),
        ((A, [0.5, 0.5], "much"), "must be numbers"),
        (((A, A), np.ones((2, 2))), "twice"),
        (("a", [0.5, 0.5]), "holds variables"),
        ((pgm.Variable("x"), [0.5]), "x is continuous"),
    ],
)
def test_malformed_tables_are_refused(arguments, words):
    with pytest.raises(pgm.ModelError, match=words):
        Table(*arguments)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda f: f.marginal(C), r"c is not in the scope \(a, b\)"),
        (lambda f: f.marginalise(A, C), "c is not in the scope"),
        (lambda f: f.maximise(C), "c is not in the scope"),
        (lambda f: f.reduce({C: 0}), "c is not in the scope"),
        (lambda f: f.marginalise(A, A), "twice"),
        (lambda f: f.marginal("a"), "holds variables"),
        (lambda f: f.extend((A, C)), r"it lacks \(b\)"),
        (lambda f: f.extend((A, B, pgm.Variable("x"))), "x is continuous"),
    ],
)
def test_variables_that_a_table_lacks(call, words):
    with pytest.raises(pgm.ModelError, match=words):
        call(Table.vacuous((A, B)))


def test_a_table_multiplies_with_tables_alone():
    f = Table.vacuous(A)
    for call in (lambda: f * 2.0, lambda: 2.0 * f, lambda: f / 2.0, lambda: f * np.ones(2)):
        with pytest.raises(TypeError):
            call()


def test_tables_are_immutable_and_keep_no_one_elses_arrays():
    values, scale = np.array([0.5, 0.5]), np.array(1.0)
    f = Table(A, values, scale)
    values[0], scale[...] = 7.0, 7.0
    assert_array_equal(f.values, 0.5)
    assert f.log_scale == 1.0
    with pytest.raises(AttributeError, match="immutable"):
        f.values = values
    results = (f, f * f, f / f, f.extend((A, B)), f.reduce({A: 0}), f.normalised(), f.marginal())
    for table in results:
        for part in (table.values, table.log_scale):
            with pytest.raises(ValueError, match="read-only"):
                part[...] = 1.0


def test_a_table_is_no_sequence():
    with pytest.raises(TypeError):
        list(Table.vacuous(A))
    with pytest.raises(TypeError):
        "yes" in Table.vacuous(A)  # noqa: B015


@pytest.mark.parametrize(
    "way", [copy.copy, copy.deepcopy, lambda table: pickle.loads(pickle.dumps(table))]
)
def test_tables_are_copied_and_pickled(way):
    f = Table((A, B), np.arange(6.0).reshape(2, 3), -3.0)
    twin = way(f)
    assert twin.scope == f.scope
    assert_array_equal(twin.values, f.values)
    assert twin["yes", "high"] == f["yes", "high"]


@pytest.mark.parametrize(
    ("table", "text"),
    [
        (Table(A, [0.2921, 0.7079]), "Table(a: no 0.292, yes 0.708)"),
        (Table(A, [0.5, 1.0], np.log(0.5)), "Table(a: no 0.25, yes 0.5)"),
        (Table(A, [0.25, 1.0], -1000.0), "Table(a: no 0.25, yes 1; times exp(-1000))"),
        (Table(A, [0.0, 0.0]), "Table(a: no 0, yes 0)"),
        (Table(A.at(3), [0.5, 0.5]), "Table(a[3]: no 0.5, yes 0.5)"),
        (Table(Discrete("d", 8), range(8)), "Table(d: 0 0, 1 1, 2 2, 3 3, 4 4, 5 5, ... 8 states)"),
        (
            Table((A, B), np.arange(6.0).reshape(2, 3)),
            "Table(a, b) of (2, 3) states\n"
            "  a    b: low  middle  high\n"
            "  no        0       1     2\n"
            "  yes       3       4     5",
        ),
        (
            Table((B, A), np.ones((2, 3, 2)), [np.log(2.0), -90.0], lead=2).reduce({B: "low"}),
            "Table(a), (2,) of them\n"
            "       a: no  yes     times\n"
            "  [0]      2    2\n"
            "  [1]      1    1  exp(-90)",
        ),
        (
            Table((A, B), np.ones((2, 1, 2, 3)), lead=(2, 1)).reduce({B: "low"}),
            "Table(a), (2, 1) of them\n"
            "          a: no  yes\n"
            "  [0, 0]      1    1\n"
            "  [1, 0]      1    1",
        ),
        (Table(A, np.ones((0, 2)), lead=0), "Table(a), (0,) of them"),
        (Table.vacuous(()), "Table()\n  1"),
    ],
)
def test_reprs(table, text):
    assert repr(table) == text


@pytest.mark.parametrize(
    ("table", "title", "rows"),
    [
        (Table.vacuous((B, C, A)), "Table(b, c, a) of (3, 4, 2) states", 12),
        (Table(A, np.ones((9, 2)), lead=9), "Table(a), (9,) of them", 9),
        (Table(A, np.ones((90, 2)), lead=90), "Table(a), (90,) of them", 12),
    ],
)
def test_long_tables_show_their_ends(table, title, rows):
    lines = repr(table).splitlines()
    assert lines[0] == title
    assert len(lines) == 2 + rows
    assert ("  ..." in lines) == (table.log_scale.size > 9)


def test_the_sprinkler_by_hand():
    """The wet grass of Murphy's tutorial: P(rain | wet) = 0.7079, P(sprinkler | wet) = 0.4298."""
    cloudy, sprinkler, rain, wet = (
        Discrete(name, ("no", "yes")) for name in ("cloudy", "sprinkler", "rain", "wet")
    )
    joint = (
        Table(cloudy, [0.5, 0.5])
        * Table((cloudy, sprinkler), [[0.5, 0.5], [0.9, 0.1]])
        * Table((cloudy, rain), [[0.8, 0.2], [0.2, 0.8]])
        * Table((sprinkler, rain, wet), [[[1, 0], [0.1, 0.9]], [[0.1, 0.9], [0.01, 0.99]]])
    )
    seen = joint.reduce({wet: "yes"})
    assert_allclose(np.exp(seen.log_total), 0.6471, atol=1e-12)
    assert round(float(seen.marginal(rain).normalised()["yes"]), 4) == 0.7079
    assert round(float(seen.marginal(sprinkler).normalised()["yes"]), 4) == 0.4298


def test_the_largest_entries_of_many_stacks_of_one_are_their_own():
    rng = np.random.default_rng(1)
    a, b = (pgm.Discrete(name, states=tuple("abcd"[:size])) for name, size in (("a", 3), ("b", 4)))
    values = rng.random((9000, 1, 3, 4))
    found = pgm.Table((a, b), values, lead=(9000, 1)).argmax()
    expected = values.reshape(9000, 12).argmax(axis=1)
    assert np.array_equal(found[a][:, 0] * 4 + found[b][:, 0], expected)


def test_draws_have_the_probabilities_of_states():
    rng = np.random.default_rng(0)
    a, b = pgm.Discrete("a", 3), pgm.Discrete("b", 4)
    values = rng.random((2, 3, 4))
    values[0, 1, 2] = values[1, 2, 3] = 0.0
    table = pgm.Table((a, b), values, [1000.0, -1000.0], lead=2)
    drawn = table.sample(20_000, rng=1)
    assert drawn.shape == (20_000, 2, 2)
    for run in range(2):
        found = np.zeros((3, 4))
        np.add.at(found, tuple(drawn[:, run].T), 1.0 / 20_000)
        due = values[run] / values[run].sum()
        assert (found[due == 0.0] == 0.0).all()
        np.testing.assert_allclose(found, due, atol=5.0 * np.sqrt(0.1 / 20_000))
    assert table.sample((2, 3), rng=0).shape == (2, 3, 2, 2)
    assert pgm.Table(a, [0.0, 1.0, 0.0]).sample(rng=0).tolist() == [1]
    with pytest.raises(pgm.NumericalError):
        pgm.Table(a, [0.0, 0.0, 0.0]).sample(rng=0)


def test_every_marginal_can_be_drawn_from():
    """Of each family, (*size, ..., components)."""
    from pgm.examples import rain, still, walk, wet, x, z

    seen = {z: [[4.0], [3.0]]}
    for belief, posterior in {
        "moments": pgm.filter(walk, seen),
        "grid": pgm.filter(walk, seen, belief=pgm.Grid({"x": (-8.0, 12.0, 40)})),
        "particles": pgm.filter(walk, seen, belief=pgm.Particles(50)),
    }.items():
        assert posterior[x].sample(5, rng=0).shape == (5, 3, 1), belief
    assert pgm.filter(still, {wet: [1, 0]})[rain].sample(5, rng=0).shape == (5, 3, 1)


def test_beliefs_of_impossible_evidence_have_neither_draws_nor_a_largest_entry():
    seen = pgm.Discrete("seen", states=2)
    sensor = pgm.TableCPD(seen, given=B, table=[[1.0, 0.0]] * 3)
    still = pgm.TableCPD(B, given=B.previous, table=np.eye(3))
    prior = pgm.TableCPD(B, table=[0.0, 0.5, 0.5])
    net = pgm.BayesianNetwork([prior, sensor])
    model = pgm.DynamicBayesianNetwork(prior=[prior], transition=[still], observation=[sensor])
    allow = {"impossible": "allow"}
    evidence = {seen: [0, 1, -1]}
    runs = {seen: [[0, 0], [1, 0]]}
    for belief, place in (
        (pgm.infer(pgm.compile(net), evidence, **allow)[B], " at index 1"),
        (pgm.query(net, B, evidence, **allow), " at index 1"),
        (pgm.query(net, B, {seen: 1}, **allow), ","),
        (pgm.filter(model, evidence, **allow)[B], " at index 2"),
        (pgm.filter(model, runs, **allow)[B], r" at index \(1, 1\)"),
    ):
        for call in (belief.argmax, lambda belief=belief: belief.sample(4, rng=0)):
            with pytest.raises(pgm.NumericalError, match=rf"over \(b\) is NaN{place}.*impossible"):
                call()
        assert np.isnan(belief.probabilities).any()
