"""Variables are values: they compare by what they are, and refuse what they cannot be."""

import dataclasses

import numpy as np
import pytest

import pgm

X = pgm.Variable("x", components=("east", "north", "heading"), angles=("heading",))


def test_components_and_angles():
    assert X.dimension == 3
    np.testing.assert_array_equal(X.angle_mask, [False, False, True])
    assert X.angle_mask.dtype == bool


def test_a_scalar_has_one_component_of_its_own_name():
    a = pgm.Variable("a")
    assert a.components == ("a",)
    assert a.dimension == 1
    assert not a.angle_mask.any()
    assert pgm.Variable("phi", angles=("phi",)).angle_mask.all()


def test_lists_of_names_are_taken_as_tuples():
    assert pgm.Variable("x", ["east", "north", "heading"], ["heading"]) == X


@pytest.mark.parametrize(
    "other",
    [
        pgm.Variable("y", X.components, X.angles),
        pgm.Variable("x", ("east", "north", "angle"), ("angle",)),
        pgm.Variable("x", ("north", "east", "heading"), ("heading",)),
        pgm.Variable("x", X.components),
        X.previous,
        X.at(0),
    ],
)
def test_each_attribute_distinguishes(other):
    assert other != X
    assert len({X, other}) == 2


def test_equal_variables_are_one_key():
    twin = pgm.Variable("x", components=("east", "north", "heading"), angles=("heading",))
    assert twin == X
    assert {X: 1}[twin] == 1


def test_steps_and_lags():
    assert X.at(3).previous == X.at(2) == X.previous.at(3)
    assert X.previous.previous.at(5) == X.at(3)
    assert X.at(np.int64(3)) == X.at(3)
    assert X.previous != X
    for copy in (X.at(3), X.previous, X):
        assert copy.template == X


def test_repr_tells_the_step():
    assert [repr(v) for v in (X, X.at(3), X.previous, X.previous.previous)] == [
        "x",
        "x[3]",
        "x[t-1]",
        "x[t-2]",
    ]


def test_a_variable_is_immutable():
    with pytest.raises(dataclasses.FrozenInstanceError):
        X.name = "y"


@pytest.mark.parametrize("names", ["a b c", "a, b, c", "a,b , c", ["a", "b", "c"], iter("abc")])
def test_variables_of_names(names):
    assert pgm.variables(names) == (pgm.Variable("a"), pgm.Variable("b"), pgm.Variable("c"))


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"name": ""}, "non-empty"),
        ({"name": 3}, "string"),
        ({"name": "x", "components": "east"}, "tuple of names"),
        ({"name": "x", "components": (1, 2)}, "tuple of names"),
        ({"name": "x", "angles": "x"}, "tuple of names"),
        ({"name": "x", "components": ("east", "east")}, "repeat"),
        ({"name": "x", "components": ("east",), "angles": ("heading",)}, "heading"),
        ({"name": "x", "step": -1}, "before the first"),
    ],
)
def test_refusals(arguments, words):
    with pytest.raises(pgm.ModelError, match=words) as caught:
        pgm.Variable(**arguments)
    if arguments["name"] == "x":
        assert caught.value.variable.name == "x"
        assert "x" in str(caught.value)


def test_there_is_nothing_before_step_zero():
    with pytest.raises(pgm.ModelError, match="before the first") as caught:
        X.at(0).previous  # noqa: B018
    assert caught.value.variable.name == "x"


@pytest.mark.parametrize(
    ("error", "base"),
    [
        (pgm.ModelError, ValueError),
        (pgm.GraphError, ValueError),
        (pgm.EvidenceError, ValueError),
        (pgm.LinearisationError, ValueError),
        (pgm.NumericalError, ArithmeticError),
        (pgm.ExecutorError, RuntimeError),
    ],
)
def test_errors_say_what_they_are_about(error, base):
    caught = error("words", variable=X, cpd="cpd", cluster=4, step=2)
    assert isinstance(caught, pgm.PgmError)
    assert isinstance(caught, base)
    assert (str(caught), caught.variable, caught.cpd) == ("words", X, "cpd")
    assert (caught.cluster, caught.step) == (4, 2)
    assert error("words").step is None


@pytest.mark.parametrize(
    "kind", [{}, {"components": ("n", "e")}, {"components": ("n", "e"), "angles": {"e"}}], ids=str
)
def test_variables_of_one_kind_are_those_that_are_made_one_by_one(kind):
    made = pgm.variables((f"x{k}" for k in range(4)), **kind)
    due = tuple(pgm.Variable(f"x{k}", **kind) for k in range(4))
    assert made == due
    assert list(map(hash, made)) == list(map(hash, due))
    assert [v.angles for v in made] == [v.angles for v in due]
    assert [v.at(2).previous for v in made] == [v.at(1) for v in due]


def test_a_component_that_is_given_is_that_of_all():
    assert [v.components for v in pgm.variables("a b", components=("a",))] == [("a",), ("a",)]
    assert [v.components for v in pgm.variables("a b", components=iter(()))] == [("a",), ("b",)]
    assert pgm.variables("", components=("a",)) == ()


@pytest.mark.parametrize(
    ("names", "kind", "text"),
    [
        ("a b a", {}, "name 'a' repeats"),
        (["a", ""], {}, "name must be a non-empty string, not ''"),
        (["a", 3], {"components": ("n", "e")}, "name must be a non-empty string, not 3"),
        ("a b", {"angles": ("a",)}, 'give components=\\("angle",\\)'),
        ("a b", {"components": ("n", "n")}, "repeat a name"),
        ("a b", {"components": ("n", "e"), "angles": ("x",)}, "are not among its components"),
        ("a b", {"components": {"n", "e"}}, "is a set, which has no order"),
    ],
)
def test_variables_that_are_none_are_refused(names, kind, text):
    with pytest.raises(pgm.ModelError, match=text):
        pgm.variables(names, **kind)
