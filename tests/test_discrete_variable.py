"""Discrete variables are values: they compare by name, states and step."""

import copy
import dataclasses
import pickle

import numpy as np
import pytest

import pgm
from pgm import Discrete

RAIN = Discrete("rain", states=("no", "yes"))


def test_states():
    assert RAIN.states == ("no", "yes")
    assert RAIN.size == 2
    assert [RAIN.index(state) for state in ("no", "yes", 0, 1, np.int64(1))] == [0, 1, 0, 1, 1]
    assert type(RAIN.index(np.int64(1))) is int
    assert isinstance(RAIN, pgm.Variable)


def test_a_number_of_states():
    die = Discrete("die", 6)
    assert die.states == ("0", "1", "2", "3", "4", "5")
    assert die.index("3") == die.index(3) == 3
    assert Discrete("die", np.int64(6)) == die
    assert Discrete("one", 1).states == ("0",)


@pytest.mark.parametrize(
    "states", [["no", "yes"], ("no", "yes"), np.array(["no", "yes"]), iter(["no", "yes"])]
)
def test_any_sequence_of_names(states):
    assert Discrete("rain", states) == RAIN


def test_one_state_is_enough():
    assert Discrete("sure", ("always",)).size == 1


def test_an_index_is_no_name():
    """States that look like numbers are found by name; whole numbers are places."""
    odd = Discrete("odd", states=("1", "0", "-1"))
    assert odd.index("0") == 1
    assert odd.index(0) == 0
    assert odd.index("-1") == 2
    with pytest.raises(pgm.ModelError):
        odd.index(-1)


@pytest.mark.parametrize(
    "state", ["maybe", "", 2, -1, 1.0, True, False, None, ("yes",), ["yes"], np.True_]
)
def test_unknown_states_are_refused(state):
    with pytest.raises(
        pgm.ModelError, match=r"rain has no state .*; its states are \('no', 'yes'"
    ) as e:
        RAIN.index(state)
    assert e.value.variable == RAIN


@pytest.mark.parametrize(
    "other",
    [
        Discrete("wet", RAIN.states),
        Discrete("rain", ("yes", "no")),
        Discrete("rain", ("no", "yes", "perhaps")),
        RAIN.at(0),
        RAIN.previous,
        pgm.Variable("rain"),
        pgm.Variable("rain", components=("no", "yes")),
        "rain",
    ],
)
def test_each_attribute_distinguishes(other):
    assert other != RAIN
    assert not RAIN == other  # noqa: SIM201, SIM300
    assert len({RAIN, other}) == 2


def test_equal_variables_are_one_key():
    twin = Discrete("rain", states=["no", "yes"])
    assert twin is not RAIN
    assert twin == RAIN
    assert hash(twin) == hash(RAIN)
    assert {RAIN: 1}[twin] == 1


def test_steps_and_lags():
    assert RAIN.at(3).previous == RAIN.at(2) == RAIN.previous.at(3)
    assert RAIN.previous.previous.at(5) == RAIN.at(3)
    assert RAIN.at(np.int64(3)) == RAIN.at(3) == Discrete("rain", RAIN.states, step=3)
    assert RAIN.previous == Discrete("rain", RAIN.states, lag=1)
    for moved in (RAIN.at(3), RAIN.previous, RAIN):
        assert type(moved) is Discrete
        assert moved.states == RAIN.states
        assert moved.template == RAIN
        assert moved.index("yes") == 1
    with pytest.raises(pgm.ModelError, match="before the first"):
        RAIN.at(0).previous  # noqa: B018
    with pytest.raises(pgm.ModelError, match="whole number"):
        RAIN.at(1.0)


def test_repr_tells_the_step():
    assert [repr(v) for v in (RAIN, RAIN.at(3), RAIN.previous)] == ["rain", "rain[3]", "rain[t-1]"]


@pytest.mark.parametrize(
    "way",
    [
        copy.copy,
        copy.deepcopy,
        *(lambda v, p=p: pickle.loads(pickle.dumps(v, p)) for p in range(2, 6)),
    ],
)
@pytest.mark.parametrize("variable", [RAIN, RAIN.at(2), RAIN.previous])
def test_copied_and_pickled(variable, way):
    twin = way(variable)
    assert type(twin) is Discrete
    assert twin == variable
    assert hash(twin) == hash(variable)
    assert (twin.step, twin.lag, twin.states) == (variable.step, variable.lag, variable.states)
    assert repr(twin) == repr(variable)


def test_immutable():
    for field in ("name", "states", "step"):
        with pytest.raises(dataclasses.FrozenInstanceError):
            setattr(RAIN, field, None)
    with pytest.raises((AttributeError, TypeError)):
        RAIN.colour = "grey"


@pytest.mark.parametrize(
    ("states", "words"),
    [
        ((), r"one or more names, or their number, not \(\)"),
        (0, "or their number, not 0"),
        (-2, "or their number, not -2"),
        (True, "not True"),
        (2.0, r"not 2\.0"),
        (None, "not None"),
        ("yes", "not 'yes'"),
        ((0, 1), r"not \(0, 1\)"),
        (("no", 1), r"not \('no', 1\)"),
        (("no", "yes", "no"), "two states are called 'no'"),
    ],
)
def test_malformed_states_are_refused(states, words):
    with pytest.raises(pgm.ModelError, match=words) as caught:
        Discrete("rain", states)
    assert "variable rain" in str(caught.value)
    assert caught.value.variable.name == "rain"


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"name": ""}, "non-empty"),
        ({"name": 3}, "string"),
        ({"name": "rain", "step": -1}, "before the first"),
        ({"name": "rain", "step": 1.0}, "whole number"),
        ({"name": "rain", "lag": -1}, "before the first"),
    ],
)
def test_malformed_names_and_steps_are_refused(arguments, words):
    with pytest.raises(pgm.ModelError, match=words):
        Discrete(states=2, **arguments)


def test_states_are_due():
    with pytest.raises(TypeError):
        Discrete("rain")
