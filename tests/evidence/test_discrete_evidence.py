"""Evidence of discrete networks: what it may be, how it is laid out, and what is refused."""

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_array_equal

import pgm
from pgm import Discrete, soft
from pgm.evidence import bind_discrete
from tests.dense import algebra

RAIN = Discrete("rain", states=("no", "yes"))
WIND = Discrete("wind", states=("calm", "fresh", "storm"))
SKY = Discrete("sky", states=("0", "-1", "1"))
ONE = Discrete("one", states=("always",))
KNOWN = frozenset({RAIN, WIND, SKY, ONE})


def bind(evidence):
    return bind_discrete(KNOWN, evidence)


@pytest.mark.parametrize(
    ("value", "index"),
    [
        ("fresh", 1),
        (2, 2),
        (np.int8(2), 2),
        (np.uint64(1), 1),
        (np.array(1), 1),
        (np.str_("storm"), 2),
        (np.array("storm"), 2),
        (np.array("storm", dtype=object), 2),
    ],
)
def test_a_single_state_is_a_plain_index(value, index):
    bound = bind({WIND: value})
    assert bound.states == {WIND: index}
    assert type(bound.states[WIND]) is int
    assert bound.lead == ()
    assert bound.runs == 1
    assert bound.weights == {}


@pytest.mark.parametrize(
    "variables", [KNOWN, set(KNOWN), list(KNOWN), tuple(KNOWN), dict.fromkeys(KNOWN), iter(KNOWN)]
)
def test_the_variables_may_come_in_any_collection(variables):
    assert bind_discrete(variables, {WIND: "calm", RAIN: 1}).states == {WIND: 0, RAIN: 1}


def test_no_evidence():
    bound = bind({})
    assert (bound.lead, bound.runs, bound.states, bound.weights) == ((), 1, {}, {})


@pytest.mark.parametrize("missing", [-1, np.int64(-1), np.array(-1), np.array([-1, -1]), [[-1]]])
def test_what_is_observed_in_no_run_is_left_out(missing):
    bound = bind({WIND: missing, RAIN: "yes"})
    assert bound.states == {RAIN: 1}
    assert bound.lead == np.shape(missing)


@pytest.mark.parametrize(
    "value",
    [
        [0, 2, -1, 1],
        (0, 2, -1, 1),
        np.array([0, 2, -1, 1], dtype=np.int8),
        np.array([0, 2, -1, 1], dtype=object),
        ["calm", "storm", -1, "fresh"],
        ["calm", 2, -1, "fresh"],
        [np.str_("calm"), np.int64(2), -1, 1],
        np.array(["calm", 2, -1, "fresh"], dtype=object),
    ],
)
def test_a_state_for_each_run(value):
    bound = bind({WIND: value})
    assert bound.lead == (4,)
    assert bound.runs == 4
    assert_array_equal(bound.states[WIND], [0, 2, -1, 1])
    assert bound.states[WIND].dtype == np.intp


@pytest.mark.parametrize("kind", [list, np.array, lambda names: np.array(names, dtype=object)])
def test_names_for_each_run(kind):
    names = [["calm", "storm"], ["fresh", "calm"]]
    bound = bind({WIND: kind(names)})
    assert bound.lead == (2, 2)
    assert_array_equal(bound.states[WIND], [0, 2, 1, 0])


def test_numpys_variable_strings():
    names = np.array(["storm", "calm"], dtype=np.dtypes.StringDType())
    assert_array_equal(bind({WIND: names}).states[WIND], [2, 0])


def test_names_that_look_like_numbers_are_names():
    bound = bind({SKY: ["-1", "0", -1, 0, "1", 1]})
    assert_array_equal(bound.states[SKY], [1, 0, -1, 0, 2, 1])
    assert bind({SKY: "-1"}).states == {SKY: 1}
    assert bind({SKY: -1}).states == {}


leads = st.sampled_from([(), (1,), (3,), (2, 1), (2, 3), (1, 3)])


@st.composite
def evidence(draw):
    """Evidence for some variables, with its entry at every run of every variable's own axes."""
    found = {}
    for variable in draw(st.sets(st.sampled_from([RAIN, WIND, SKY, ONE]))):
        lead = draw(leads)
        count = int(np.prod(lead))
        if draw(st.booleans()):
            rows = draw(
                st.lists(st.integers(-1, variable.size - 1), min_size=count, max_size=count)
            )
            found[variable] = np.reshape(rows, lead).astype(int)
        else:
            weights = st.lists(
                st.integers(0, 5), min_size=variable.size, max_size=variable.size
            ).filter(any)
            rows = [draw(weights) for _ in range(count)]
            found[variable] = np.reshape(rows, (*lead, variable.size)).astype(float)
    return found


def logs(weights):
    with np.errstate(divide="ignore"):
        return np.log(weights)


@algebra
@given(evidence())
def test_every_run_has_its_own_entry(found):
    """Each flat row of the layout against indexing the user's arrays after broadcasting."""
    given_ = {v: soft(a) if a.dtype == float else a for v, a in found.items()}
    bound = bind(given_)
    own = {v: a.shape[:-1] if a.dtype == float else a.shape for v, a in found.items()}
    assert bound.lead == np.broadcast_shapes(*own.values())
    assert bound.runs == np.prod(bound.lead)
    for row, run in enumerate(np.ndindex(bound.lead)):
        for variable, array in found.items():
            hard = array.dtype != float
            if not hard:
                array = logs(array)
            at = np.broadcast_to(array, bound.lead if hard else (*bound.lead, variable.size))[run]
            kept = bound.states if hard else bound.weights
            if variable not in kept:
                assert hard
                assert (array == -1).all()
                continue
            column = kept[variable]
            if isinstance(column, int):
                assert array.shape == ()
                assert column == at
            else:
                assert len(column) in (1, bound.runs)
                assert_array_equal(column[row if len(column) > 1 else 0], at)


def test_runs_of_one_are_not_repeated():
    bound = bind({WIND: [1], RAIN: np.zeros((5, 1), int), SKY: soft([[1, 2, 3]])})
    assert bound.lead == (5, 1)
    assert bound.states[WIND].shape == (1,)
    assert bound.states[RAIN].shape == (5,)
    assert bound.weights[SKY].shape == (1, 3)


def test_soft_evidence():
    value = soft([0.2, 0.0, 3.0])
    bound = bind({WIND: value, RAIN: soft([[[1, 0]], [[0.5, 0.5]]])})
    assert bound.lead == (2, 1)
    assert bound.states == {}
    assert_array_equal(bound.weights[WIND], logs([[0.2, 0.0, 3.0]]))
    assert_array_equal(bound.weights[RAIN], logs([[1.0, 0.0], [0.5, 0.5]]))
    with pytest.raises(AttributeError):
        value.weights = [1.0, 1.0, 1.0]


def test_the_layout_keeps_no_one_elses_arrays_and_is_read_only():
    indices, weights = np.array([0, 1]), np.ones((2, 3))
    bound = bind({RAIN: indices, WIND: soft(weights)})
    indices[0], weights[0, 0] = 1, 7.0
    assert bound.states[RAIN][0] == 0
    assert bound.weights[WIND][0, 0] == 0.0
    for array in (bound.states[RAIN], bound.weights[WIND]):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0
    with pytest.raises(AttributeError):
        bound.lead = (3,)


@pytest.mark.parametrize(
    ("value", "words"),
    [
        (
            "gale",
            r"wind is 'gale', which is none of its states \('calm', 'fresh', 'storm'\), 0 to 2",
        ),
        (3, "wind is 3, which is none"),
        (-2, "wind is -2, which is none"),
        (10**30, "wind"),
        (np.int64(3), "wind is 3, which is none"),
        (np.uint64(2**63), f"wind is {2**63}, which is none"),
        ([0, 1, 3, 4], r"wind is 3 \(first in run 2\), which is none"),
        ([[0, 1], [-2, 7]], r"wind is -2 \(first in run \(1, 0\)\)"),
        (["calm", "gale"], r"wind is 'gale' \(first in run 1\)"),
        (np.array([["calm", "gale"]]), r"wind is 'gale' \(first in run \(0, 1\)\)"),
        (["calm", 5], r"wind is 5 \(first in run 1\)"),
        (1.0, "not a value of type float64"),
        (np.nan, "not a value of type float64"),
        ([1.0, 0.0], r"not an array of shape \(2,\) of type float64"),
        ([1, np.nan], "float64"),
        (True, "not a value of type bool"),
        ([True, False], "of type bool"),
        (["calm", True], "not True"),
        (["calm", 1.0], r"not 1\.0"),
        (["calm", None], "not None"),
        (None, "not None"),
        (1j, "complex"),
        (b"calm", "not a value of type"),
        ({"calm": 1}, "not {'calm': 1}"),
        (pgm.constant(1), r"a constant of wind, .* for dynamic networks; give .*{wind: 'calm'}"),
        (pgm.sightings([1], step=[0]), "sightings of wind, .* for dynamic networks; give"),
        ([[0, 1], [2]], "rows of unequal length"),
        ([["calm"], "calm"], "rows of unequal length"),
    ],
)
def test_what_is_no_state_is_refused(value, words):
    with pytest.raises(pgm.EvidenceError, match=words) as caught:
        bind({RAIN: "no", WIND: value})
    assert caught.value.variable == WIND
    assert "'storm'" in str(caught.value)


@pytest.mark.parametrize(
    ("weights", "words"),
    [
        ([0.5, 0.5], r"shape \(2,\); the last axis must hold one for each of the states \('calm'"),
        (1.0, r"shape \(\)"),
        ([0.5, -0.5, 1.0], "negative, NaN or infinite$"),
        ([0.5, np.nan, 1.0], "negative, NaN or infinite$"),
        ([[1, 1, 1], [1, np.inf, 1]], r"infinite \(first in run 1\)"),
        ([0.0, 0.0, 0.0], "all zero, which is impossible evidence; .* needs a positive one"),
        ([[[1, 0, 0], [0, 0, 0]]], r"all zero \(first in run \(0, 1\)\)"),
        ("calm", "one for each of the states .*, must be numbers, not texts"),
        ({"calm": 1, "fresh": 0, "storm": 1}, r"in the order of the states \('calm', 'fresh'"),
        ([[1, 1, 1], [1]], "must be numbers"),
        (None, "must be numbers, not NoneType"),
    ],
)
def test_malformed_weights_are_refused(weights, words):
    with pytest.raises(pgm.EvidenceError, match=words) as caught:
        bind({WIND: soft(weights)})
    assert caught.value.variable == WIND
    assert "soft evidence for wind" in str(caught.value)


@pytest.mark.parametrize("value", ["no", 0, [0, 1], soft([1, 1])])
@pytest.mark.parametrize(
    "stranger",
    [Discrete("hail", 2), Discrete("rain", 2), RAIN.at(0), RAIN.previous, pgm.Variable("rain")],
)
def test_unknown_variables_are_refused(stranger, value):
    words = "which the network (does not have|has only as rain)"
    with pytest.raises(pgm.EvidenceError, match=words) as caught:
        bind({WIND: "calm", stranger: value})
    assert caught.value.variable == stranger


@pytest.mark.parametrize("key", ["rain", 0, None, ("rain", "no")])
def test_a_key_that_is_no_variable_is_refused(key):
    with pytest.raises(pgm.EvidenceError, match="which is no variable"):
        bind({key: "yes"})


def test_runs_must_broadcast():
    words = r"do not broadcast to one set of runs: rain \(2,\), sky \(3,\)"
    with pytest.raises(pgm.EvidenceError, match=words):
        bind({RAIN: [0, 1], WIND: 2, SKY: soft(np.ones((3, 3))), ONE: np.array(0)})


@pytest.mark.parametrize(
    "value", [[], np.zeros((3, 0), int), np.empty(0, dtype=object), soft(np.ones((0, 3)))]
)
def test_a_run_at_least_is_due(value):
    with pytest.raises(pgm.EvidenceError, match="there is no run in it"):
        bind({WIND: value, RAIN: [1]})


def test_all_states_by_name_index_and_array_agree():
    for variable in KNOWN:
        every = bind({variable: list(variable.states)}).states.get(variable)
        assert_array_equal(every, np.arange(variable.size))
        for index, name in enumerate(variable.states):
            found = [bind({variable: way}).states[variable] for way in (name, index)]
            assert found == [index, index]


def test_single_states_and_arrays_mix():
    pairs = itertools.product(("no", 1, np.array([1, 0])), ("calm", 2, np.array([-1, 2])))
    for rain, wind in pairs:
        bound = bind({RAIN: rain, WIND: wind})
        stacked = [value for value in (rain, wind) if isinstance(value, np.ndarray)]
        assert bound.lead == ((2,) if stacked else ())
        for variable, value in ((RAIN, rain), (WIND, wind)):
            assert isinstance(bound.states[variable], int) != isinstance(value, np.ndarray)
