"""Evidence of continuous networks without time: what it may be, how it is laid out, refusals."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_array_equal

import pgm
from pgm import EvidenceError
from pgm.evidence import bind_values
from tests.dense import algebra

a, b, c, u, w, other = pgm.variables("a b c u w other")
p = pgm.Variable("p", ("p0", "p1"))
CPDS = (
    pgm.GaussianCPD(a, 0.0, 1.0),
    pgm.LinearGaussianCPD(
        b, {a: 1.0, u: 1.0}, cov=pgm.noise(lambda w: 1.0 + w[..., None] ** 2, given=(w,))
    ),
    pgm.LinearGaussianCPD(p, {a: [[1.0], [2.0]]}, cov=np.eye(2)),
    pgm.LinearGaussianCPD(
        c, {a: 1.0}, cov=pgm.noise(lambda b: 1.0 + b[..., None] ** 2, given=(b,))
    ),
)


def test_no_evidence_is_one_run():
    bound = bind_values(CPDS, {})
    assert (bound.lead, bound.runs, dict(bound.values)) == ((), 1, {})


def test_the_axes_of_the_model_count():
    bound = bind_values(CPDS, {a: 1.0}, lead=(3, 1))
    assert (bound.lead, bound.runs) == ((3, 1), 3)
    assert_array_equal(bound.values[a], [[1.0]])
    bound = bind_values(CPDS, {p: np.zeros((4, 2))}, lead=(3, 1))
    assert (bound.lead, bound.runs) == ((3, 4), 12)


@pytest.mark.parametrize(
    "value", [1, 1.0, True, np.float32(1.0), np.array(1), [1], np.array([1.0]), pgm.constant(1.0)]
)
def test_a_scalar_is_a_number_or_has_its_axis(value):
    assert_array_equal(bind_values(CPDS, {a: value}).values[a], [[1.0]])


def test_runs_are_flattened_and_what_all_share_is_kept_once():
    values = np.arange(12.0).reshape(2, 3, 2)
    bound = bind_values(CPDS, {p: values, a: np.ones((1, 1, 1)), b: [[1.0], [2.0], [3.0]]})
    assert bound.lead == (2, 3)
    assert_array_equal(bound.values[p], values.reshape(6, 2))
    assert bound.values[a].shape == (1, 1)
    assert_array_equal(bound.values[b][:, 0], [1, 2, 3, 1, 2, 3])


@algebra
@given(st.lists(st.integers(1, 3), max_size=3), st.data())
def test_runs_are_those_of_broadcasting(lead, data):
    def shape():
        cut = data.draw(st.integers(0, len(lead)))
        return [n if data.draw(st.booleans()) else 1 for n in lead[cut:]]

    rng = np.random.default_rng(0)
    evidence = {v: rng.normal(size=(*shape(), v.dimension)) for v in (a, b, p)}
    bound = bind_values(CPDS, evidence)
    wide = np.broadcast_shapes(*(x.shape[:-1] for x in evidence.values()))
    assert bound.lead == wide
    for v, x in evidence.items():
        due = np.broadcast_to(x, (*wide, v.dimension)).reshape(-1, v.dimension)
        assert_array_equal(np.broadcast_to(bound.values[v], due.shape), due)


def test_values_are_read_only_copies_or_views():
    value = np.array([1.0, 2.0])
    bound = bind_values(CPDS, {p: value})
    with pytest.raises(ValueError, match="read-only"):
        bound.values[p][...] = 0.0


def test_what_is_needed_and_given():
    bound = bind_values(CPDS, {u: 1.0, w: 2.0, b: 0.0}, needed=[u, w, b])
    assert set(bound.values) == {u, w, b}


def refused(evidence, *words, variable=None, needed=(), lead=()):
    with pytest.raises(EvidenceError) as caught:
        bind_values(CPDS, evidence, lead, needed)
    for word in words:
        assert word in str(caught.value)
    assert caught.value.variable == variable
    return caught.value


def test_an_input_without_evidence():
    error = refused({}, "no evidence for u", "no CPD explains", variable=u, needed=[u])
    assert error.cpd is CPDS[1]


@pytest.mark.parametrize(("variable", "cpd"), [(w, CPDS[1]), (b, CPDS[3])])
def test_noise_of_what_is_not_known(variable, cpd):
    words = f"no evidence for {variable!r}", "noise can depend on known values alone"
    assert refused({}, *words, variable=variable, needed=[variable]).cpd is cpd


@pytest.mark.parametrize(
    ("evidence", "variable", "words"),
    [
        ({other: 1.0}, other, ["other", "it has a, b, c, p, u, w"]),
        ({"a": 1.0}, None, ["'a'", "which is no variable", "use the variable itself, a"]),
        ({a: "high"}, a, ["numbers", "str"]),
        ({a: pgm.soft([1, 0])}, a, ["soft", "a, which is continuous", "given={a: 1.0}"]),
        ({a: pgm.sightings([[1.0]])}, a, ["sightings of a", "(..., 1)"]),
        ({p: pgm.sightings([[1.0, 2.0]])}, p, ["sightings of p", "(..., 2)"]),
        ({a: [1.0, 2.0]}, a, ["(2,)", "value[..., None]"]),
        ({p: 1.0}, p, ["()", "('p0', 'p1')"]),
        ({p: [[1.0], [2.0]]}, p, ["(2, 1)", "(..., 2)"]),
        ({b: np.nan}, b, ["NaN", "c depends on it", "was not observed out of the evidence"]),
        ({a: None}, a, ["NaN", "leave a variable that was not observed out of the evidence"]),
        ({a: pgm.constant(np.nan)}, a, ["NaN", "out of the evidence, in all runs alike"]),
        ({a: [[1.0], [np.nan]]}, a, ["NaN"]),
        ({a: -np.inf}, a, ["infinite"]),
        ({a: np.zeros((2, 1)), b: np.zeros((3, 1))}, None, ["a (2,)", "b (3,)", "broadcast"]),
        ({a: np.zeros((2, 0, 1))}, None, ["(2, 0)", "no run"]),
    ],
)
def test_refusals(evidence, variable, words):
    refused(evidence, *words, variable=variable)


def test_axes_that_do_not_fit_the_model_s():
    refused({a: np.zeros((2, 1)), b: 1.0}, "a (2,)", "the model (3,)", lead=(3,))
