"""Declaring dynamic Bayesian networks: what they derive, and what they refuse."""

from itertools import pairwise

import numpy as np
import pytest

import pgm
from pgm import (
    DynamicBayesianNetwork,
    GaussianCPD,
    LinearGaussianCPD,
    NonlinearGaussianCPD,
)

X = pgm.Variable("x", components=("east", "north"))
U = pgm.Variable("u", components=("v", "omega"))
A, B, C, D, Z, W = pgm.variables("a b c d z w")


def never(*arguments):
    raise AssertionError("a user's function was called while the model was declared")


def start(variable):
    return GaussianCPD(variable, np.zeros(variable.dimension), np.eye(variable.dimension))


def linear(child, *given):
    shape = {parent: np.ones((child.dimension, parent.dimension)) for parent in given}
    return LinearGaussianCPD(child, shape, cov=np.eye(child.dimension))


def nonlinear(child, *given, **more):
    return NonlinearGaussianCPD(child, given, never, np.eye(child.dimension), **more)


def walk(variable):
    return linear(variable, variable.previous)


def test_what_a_model_derives():
    command = pgm.Variable("command", components=("v", "omega"))
    model = DynamicBayesianNetwork(
        prior=[start(X), start(A)],
        transition=[nonlinear(X, X.previous, U), linear(U, command), walk(A)],
        observation=[
            nonlinear(Z, X, A, B),
            NonlinearGaussianCPD(W, (U,), never, pgm.noise(never, given=C)),
        ],
    )
    assert model.states == (X, A)
    assert model.controls == (U,)
    assert model.sensors == (Z, W)
    assert model.inputs == (command, B, C)
    assert model.variables == (X, A, U, Z, W, command, B, C)
    assert model.cpds == model.prior + model.transition + model.observation
    assert [cpd.child for cpd in model.transition] == [U, X, A]


def test_parents_stand_before_children():
    chain = [linear(D, C, D.previous), linear(C, B), linear(B, A), linear(A, A.previous)]
    model = DynamicBayesianNetwork(prior=[linear(D, A), start(A)], transition=chain, observation=[])
    assert [cpd.child for cpd in model.prior] == [A, D]
    assert [cpd.child for cpd in model.transition] == [A, B, C, D]
    assert model.states == (A, D)
    assert model.controls == (B, C)


def test_the_given_order_stands_where_it_may():
    model = DynamicBayesianNetwork(
        prior=[start(v) for v in (C, A, B)], transition=[walk(v) for v in (B, C, A)]
    )
    assert [cpd.child for cpd in model.prior] == [C, A, B]
    assert [cpd.child for cpd in model.transition] == [B, C, A]


def test_depending_on_oneself_through_the_step_before_is_no_cycle():
    DynamicBayesianNetwork(
        prior=[start(A), start(B)],
        transition=[linear(A, A.previous, B.previous), linear(B, A, B.previous)],
    )


def test_one_cpd_needs_no_list():
    model = DynamicBayesianNetwork(start(A), walk(A), linear(Z, A))
    assert model.states == (A,)
    assert model.sensors == (Z,)
    assert DynamicBayesianNetwork(start(A), walk(A)).observation == ()


def test_replacing_makes_a_variant():
    model = DynamicBayesianNetwork([start(A)], [walk(A)], [linear(Z, A)])
    sharper = LinearGaussianCPD(Z, {A: 1.0}, cov=0.1)
    variant = model.replace(observation=[sharper])
    assert variant.observation == (sharper,)
    assert variant.prior == model.prior
    assert variant.transition == model.transition
    assert model.observation != variant.observation
    with pytest.raises(pgm.ModelError, match="sensors"):
        model.replace(sensors=[sharper])
    with pytest.raises(pgm.ModelError, match="no transition"):
        model.replace(transition=[])


def test_a_model_is_immutable():
    model = DynamicBayesianNetwork([start(A)], [walk(A)])
    with pytest.raises(AttributeError, match="immutable"):
        model.prior = ()
    assert isinstance(model.prior, tuple)


def test_repr_is_the_factorisation():
    model = DynamicBayesianNetwork(
        [start(X), start(A)],
        [nonlinear(X, X.previous, U), walk(A)],
        [nonlinear(Z, X, A)],
    )
    rows = [row.split() for row in repr(model).splitlines()]
    assert rows == [
        ["DynamicBayesianNetwork"],
        ["states", "x,", "a"],
        ["inputs", "u"],
        ["prior", "p(x)", "p(a)"],
        ["transition", "p(x", "|", "x[t-1],", "u)", "p(a", "|", "a[t-1])"],
        ["observation", "p(z", "|", "x,", "a)"],
    ]


def lines(model):
    return {row.split()[0]: row.split(maxsplit=1)[1] for row in repr(model).splitlines()[1:]}


NOTE = "; nothing depends on it: a sensor belongs in observation="


def test_a_hidden_variable_without_children_is_shown_as_one():
    """Such as a sensor that stands in transition=; what other CPDs depend on is a control."""
    sensor = [walk(A), linear(Z, A)]
    assert lines(DynamicBayesianNetwork([start(A)], sensor))["hidden"] == f"z{NOTE}"
    right = lines(DynamicBayesianNetwork([start(A)], sensor[:1], sensor[1:]))
    assert "hidden" not in right
    assert "controls" not in right
    both = lines(
        DynamicBayesianNetwork([start(A)], [linear(A, A.previous, B), start(B), *sensor[1:]])
    )
    assert both["controls"] == "b"
    assert both["hidden"] == f"z{NOTE}"
    used = lines(DynamicBayesianNetwork([start(A)], sensor, [linear(W, Z)]))
    assert used["controls"] == "z"
    assert "hidden" not in used
    earlier = [linear(A, A.previous, Z.previous), linear(Z, Z.previous, A)]
    assert "hidden" not in lines(DynamicBayesianNetwork([start(A), start(Z)], earlier))


def test_the_unrolled_network():
    model = DynamicBayesianNetwork(
        [start(X), linear(A, X)],
        [nonlinear(X, X.previous, U), walk(A), linear(U, C)],
        [nonlinear(Z, X, B), linear(W, U)],
    )
    graph = model.to_networkx(steps=2)
    edges = {(X.at(0), A.at(0)), (X.at(0), Z.at(0)), (B.at(0), Z.at(0))}
    for t in (1, 2):
        edges |= {
            (X.at(t - 1), X.at(t)),
            (U.at(t), X.at(t)),
            (A.at(t - 1), A.at(t)),
            (C.at(t), U.at(t)),
            (X.at(t), Z.at(t)),
            (B.at(t), Z.at(t)),
            (U.at(t), W.at(t)),
        }
    assert set(graph.edges) == edges
    kinds = {X: "state", A: "state", U: "control", Z: "sensor", W: "sensor"}
    for node, attributes in graph.nodes(data=True):
        assert attributes["kind"] == kinds.get(node.template, "input")
        assert attributes["step"] == node.step
    assert set(model.to_networkx(steps=0)) == {X.at(0), A.at(0), Z.at(0), B.at(0)}


@pytest.mark.parametrize(
    ("prior", "transition", "observation", "words", "variable"),
    [
        ([start(A)], [], [], "a has a prior but no transition", A),
        ([], [walk(A)], [], r"needs a\[t-1\].*no prior", A),
        ([start(A)], [walk(A), linear(B, A, B.previous)], [], "b has no prior", B),
        ([start(A)], [linear(A, C.previous)], [], "c has no prior", C),
        ([start(A), start(A)], [walk(A)], [], "a has two CPDs", A),
        ([start(A)], [walk(A), linear(A, C)], [], "a has two CPDs", A),
        ([start(A)], [walk(A)], [linear(Z, A), linear(Z, A)], "z has two CPDs", Z),
        ([start(A)], [walk(A)], [linear(A, C)], "a has two CPDs", A),
        ([start(A)], [walk(A)], [linear(Z, A.previous)], "cannot be a sensor's parent", A.previous),
        ([start(A)], [walk(A)], [linear(Z, A), linear(W, Z)], "sensor's measurement", Z),
        ([start(A)], [linear(A, A.previous, Z)], [linear(Z, A)], "sensor's measurement", Z),
        ([linear(A, C)], [walk(A)], [], "cannot be a parent in the prior", C),
        ([linear(A, A.previous)], [walk(A)], [], "cannot be a parent in the prior", A.previous),
        (
            [start(A)],
            [linear(A, A.previous.previous)],
            [],
            "more than one step",
            A.previous.previous,
        ),
        ([start(A)], [linear(A, A.previous, C.at(3))], [], r"single step of c\[3\]", C.at(3)),
        ([start(A.at(0))], [walk(A)], [], r"single step of a\[0\]", A.at(0)),
    ],
)
def test_malformed_networks_are_refused(prior, transition, observation, words, variable):
    with pytest.raises(pgm.ModelError, match=words) as caught:
        DynamicBayesianNetwork(prior, transition, observation)
    assert caught.value.variable == variable
    assert caught.value.cpd in (*prior, *transition, *observation)


def test_two_variables_of_one_name_are_refused():
    other = pgm.Variable("a", components=("east", "north"))
    with pytest.raises(pgm.ModelError, match="two different variables are called 'a'") as caught:
        DynamicBayesianNetwork([start(A)], [walk(A)], [linear(Z, A, other)])
    assert caught.value.variable.name == "a"
    turned = pgm.Variable("a", angles=("a",))
    with pytest.raises(pgm.ModelError, match="two different variables"):
        DynamicBayesianNetwork([start(A)], [linear(A, turned.previous)])


@pytest.mark.parametrize("where", ["prior", "transition"])
def test_cycles_are_refused(where):
    cycle = [linear(A, C), linear(B, A), linear(C, B)]
    rest = [start(v) for v in (A, B, C)] if where == "transition" else [walk(v) for v in (A, B, C)]
    prior, transition = (rest, cycle) if where == "transition" else (cycle, rest)
    with pytest.raises(pgm.ModelError, match="cycle") as caught:
        DynamicBayesianNetwork(prior, transition)
    assert caught.value.variable in (A, B, C)
    assert caught.value.cpd in cycle
    path = str(caught.value).split("cycle, ")[1].split(";")[0].split(" -> ")
    assert path[0] == path[-1]
    assert sorted(path[1:]) == ["a", "b", "c"]
    edges = {(repr(cpd.given[0]), repr(cpd.child)) for cpd in cycle}
    assert set(pairwise(path)) == edges


@pytest.mark.parametrize("parent", [A, A.previous, B])
def test_noise_of_a_hidden_parent_is_refused(parent):
    noisy = NonlinearGaussianCPD(X, (X.previous,), never, pgm.noise(never, given=parent))
    with pytest.raises(pgm.ModelError, match="noise may depend on inputs alone") as caught:
        DynamicBayesianNetwork([start(X), start(A)], [noisy, walk(A), linear(B, C)])
    assert caught.value.variable == parent
    assert caught.value.cpd is noisy


def test_noise_of_a_state_is_refused_in_the_prior_too():
    noisy = LinearGaussianCPD(B, {A: 1.0}, cov=pgm.noise(never, given=A))
    with pytest.raises(pgm.ModelError, match="noise"):
        DynamicBayesianNetwork([start(A), noisy], [walk(A), walk(B)])


def test_noise_of_a_sensor_may_not_depend_on_what_it_sees():
    noisy = NonlinearGaussianCPD(Z, (A,), never, pgm.noise(never, given=A))
    with pytest.raises(pgm.ModelError, match="noise may depend on inputs alone"):
        DynamicBayesianNetwork([start(A)], [walk(A)], [noisy])


@pytest.mark.parametrize("where", ["prior", "transition", "observation"])
@pytest.mark.parametrize("stranger", [A, "p(a)", 3])
def test_only_cpds_are_taken(where, stranger):
    parts = {"prior": [start(A)], "transition": [walk(A)], "observation": [linear(Z, A)]}
    parts[where] = [*parts[where], stranger]
    with pytest.raises(pgm.ModelError, match=f"{where} holds CPDs"):
        DynamicBayesianNetwork(**parts)


def test_runs_of_the_prior_must_broadcast():
    many, few = GaussianCPD(A, np.zeros((3, 1)), 1), GaussianCPD(B, np.zeros((2, 1)), 1)
    with pytest.raises(pgm.PgmError):
        DynamicBayesianNetwork([many, few], [walk(A), walk(B)]).sample(steps=1, rng=0)
