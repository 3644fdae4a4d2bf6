"""Declaring networks without time: what they derive, and what they refuse."""

import copy
import pickle
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import pgm
from pgm import BayesianNetwork, GaussianCPD, LinearGaussianCPD, NonlinearGaussianCPD, TableCPD

A, B, C, D, U = pgm.variables("a b c d u")
X = pgm.Variable("x", components=("east", "north"))
RAIN, WET, GREY = (pgm.Discrete(name, states=("no", "yes")) for name in ("rain", "wet", "grey"))


def never(*arguments):
    raise AssertionError("a user's function was called while the model was declared")


def linear(child, *parents):
    shape = {parent: np.ones((child.dimension, parent.dimension)) for parent in parents}
    return LinearGaussianCPD(child, shape, cov=np.eye(child.dimension))


def table(child, *parents):
    return TableCPD(child, parents, table=np.full((2,) * (len(parents) + 1), 0.5))


def test_what_a_network_derives():
    noisy = NonlinearGaussianCPD(C, (B, X), never, pgm.noise(never, given=U))
    net = BayesianNetwork([noisy, linear(B, A), linear(A)])
    assert [cpd.child for cpd in net.cpds] == [A, B, C]
    assert net.variables == (A, B, C, X, U)
    assert net.inputs == (X, U)
    assert not net.discrete
    assert net.lead == ()
    assert BayesianNetwork([table(RAIN), table(WET, RAIN)]).discrete


def test_a_variable_and_its_cpd():
    cpd = linear(B, A)
    net = BayesianNetwork([linear(A, U), cpd])
    assert net.cpd(B) is cpd
    with pytest.raises(pgm.ModelError, match="no CPD of u, since it is an input") as caught:
        net.cpd(U)
    assert caught.value.variable == U
    with pytest.raises(pgm.ModelError, match="no CPD of c, which the network does not") as caught:
        net.cpd(C)
    assert caught.value.variable == C
    with pytest.raises(pgm.ModelError, match=r"'b', which is no variable; .* itself, b$"):
        net.cpd("b")
    unrolled = BayesianNetwork([linear(A.at(0)), linear(A.at(1), A.at(0))])
    with pytest.raises(pgm.ModelError, match=r"only as a\[0\], a\[1\]; name the step, a\.at\(k\)"):
        unrolled.cpd(A)


dags = st.integers(1, 9).flatmap(
    lambda n: st.tuples(
        st.permutations(range(n)),
        st.lists(st.tuples(st.integers(0, n - 1), st.integers(0, n - 1)), max_size=12),
    )
)


@given(dags)
def test_parents_stand_before_children_and_the_given_order_where_it_may(drawn):
    rank, pairs = drawn
    variables = pgm.variables([f"v{k}" for k in range(len(rank))])
    edges = {(i, j) for i, j in pairs if rank[i] < rank[j]}
    cpds = [
        linear(child, *(variables[i] for i, j in sorted(edges) if j == k))
        for k, child in enumerate(variables)
    ]
    due, left = [], list(range(len(rank)))
    while left:  # the first whose parents all stand
        first = next(k for k in left if not any((i, k) in edges for i in left))
        due.append(first)
        left.remove(first)
    assert BayesianNetwork(cpds).cpds == tuple(cpds[k] for k in due)


def test_steps_of_one_variable_share_its_name():
    net = BayesianNetwork([linear(A.at(1), A.at(0)), linear(A.at(0)), linear(B.at(1), A.at(1))])
    assert net.variables == (A.at(0), A.at(1), B.at(1))


def test_repr_is_the_factorisation():
    net = BayesianNetwork([linear(C, A, B), linear(B, A), linear(A, U)])
    assert repr(net) == "BayesianNetwork(p(a | u)  p(b | a)  p(c | a, b))"
    many = pgm.variables([f"v{k}" for k in range(40)])
    large = BayesianNetwork(linear(v) for v in many)
    title, first, *rest = repr(large).splitlines()
    assert title == "BayesianNetwork(40 CPDs, continuous)"
    assert first.startswith("  p(v0)  p(v1)  ")
    assert " ".join([first, *rest]).split()[-4:] == ["...", "40", "in", "all"]


def test_replacing_makes_a_variant():
    net = BayesianNetwork([linear(A), linear(B, A), linear(C, B)])
    new, other = linear(B), linear(A, B, U)
    variant = net.replace(new, other)
    assert variant.cpds == (new, other, net.cpd(C))
    assert variant.inputs == (U,)
    assert [cpd.child for cpd in net.cpds] == [A, B, C]
    assert net.cpd(B) is not new
    assert net.replace().cpds == net.cpds


@pytest.mark.parametrize(
    ("cpds", "words"),
    [
        ([linear(D)], "no CPD of d, which the network does not have"),
        ([linear(U)], "no CPD of u, since it is an input"),
        ([linear(B), linear(B, A)], "b has two CPDs"),
        ([linear(A, B)], "cycle"),
        (["p(a)"], "replace holds CPDs"),
    ],
)
def test_replacing_what_is_not_there(cpds, words):
    with pytest.raises(pgm.ModelError, match=words):
        BayesianNetwork([linear(A, U), linear(B, A)]).replace(*cpds)


def test_as_a_graph():
    noisy = NonlinearGaussianCPD(C, B, never, pgm.noise(never, given=U))
    graph = BayesianNetwork([noisy, linear(B, A), linear(A)]).to_networkx()
    assert list(graph) == [A, B, C, U]
    assert set(graph.edges) == {(A, B), (B, C), (U, C)}
    kinds = dict(graph.nodes(data="kind"))
    assert kinds == {A: "variable", B: "variable", C: "variable", U: "input"}


TWICE = linear(B, A)
SECOND = linear(B)


@pytest.mark.parametrize(
    ("cpds", "words", "variable", "cpd"),
    [
        ([TWICE, linear(A), SECOND], "b has two CPDs", B, SECOND),
        ([linear(A), SECOND, TWICE], "b has two CPDs", B, TWICE),
    ],
)
def test_two_cpds_of_a_child_are_refused(cpds, words, variable, cpd):
    with pytest.raises(pgm.ModelError, match=words) as caught:
        BayesianNetwork(cpds)
    assert caught.value.variable == variable
    assert caught.value.cpd is cpd


def test_two_variables_of_one_name_are_refused():
    wide = pgm.Variable("a", components=("east", "north"))
    with pytest.raises(pgm.ModelError, match=r"called 'a'.*\('a'\).*\('east', 'north'\)"):
        BayesianNetwork([linear(A), linear(wide)])
    with pytest.raises(pgm.ModelError, match=r"called 'a'.*angles \('a'\)"):
        BayesianNetwork([linear(A), linear(B, pgm.Variable("a", angles=("a",)))])
    other = pgm.Discrete("rain", states=("none", "some", "much"))
    words = r"called 'rain'.*states \('no', 'yes'\).*states \('none', 'some', 'much'\)"
    with pytest.raises(pgm.ModelError, match=words) as caught:
        BayesianNetwork([table(RAIN), TableCPD(other, table=[0.2, 0.3, 0.5])])
    assert caught.value.variable == other
    same = pgm.Variable("rain")
    with pytest.raises(pgm.ModelError, match=r"states \('no', 'yes'\), one with components"):
        BayesianNetwork([table(RAIN), linear(same)])


def test_cycles_are_refused():
    cycle = [linear(A, C), linear(B, A), linear(C, B)]
    with pytest.raises(pgm.ModelError, match="take a parent out of one of them") as caught:
        BayesianNetwork([linear(D), *cycle, linear(X, C)])
    path = str(caught.value).split("cycle, ")[1].split(";")[0].split(" -> ")
    assert set(pairwise(path)) == {("c", "a"), ("a", "b"), ("b", "c")}
    assert len(path) == 4
    assert caught.value.cpd in cycle
    assert caught.value.variable == caught.value.cpd.child
    with pytest.raises(pgm.ModelError, match="cycle, rain -> wet -> rain"):
        BayesianNetwork([table(RAIN, WET), table(WET, RAIN)])


def test_messages_do_not_grow_with_the_network():
    many = pgm.variables([f"v{k}" for k in range(300)])
    with pytest.raises(pgm.ModelError, match=r"v7 -> \.\.\. \(300 variables in all\)") as caught:
        BayesianNetwork([linear(v, many[k - 1]) for k, v in enumerate(many)])
    messages = [caught.value]
    net = BayesianNetwork([*map(linear, many), linear(A, *many), linear(B, U)])
    for way in (
        lambda: net.cpd(C),
        lambda: net.separated(A, C),
        lambda: net.sample(inputs={U: 1.0, C: 1.0}, rng=0),
        lambda: net.replace(linear(A, *many, A.previous)),
    ):
        with pytest.raises(pgm.PgmError) as caught:
            way()
        messages.append(caught.value)
    for message in messages:
        assert len(str(message)) < 300


def test_a_cycle_through_the_noise_is_one():
    noisy = LinearGaussianCPD(A, {}, cov=pgm.noise(never, given=B))
    with pytest.raises(pgm.ModelError, match="cycle"):
        BayesianNetwork([noisy, linear(B, A)])


def test_noise_may_depend_on_a_variable_that_evidence_may_be_given_of():
    noisy = NonlinearGaussianCPD(B, A, never, pgm.noise(never, given=A))
    assert BayesianNetwork([linear(A), noisy]).inputs == ()


def test_kinds_may_be_mixed():
    assert BayesianNetwork([linear(A), table(RAIN)]).mixed
    for cpd in (linear(A), table(RAIN)):
        assert not BayesianNetwork([cpd]).mixed
    named = BayesianNetwork([table(RAIN), *(linear(pgm.Variable(f"x{k}")) for k in range(20))])
    assert repr(named).startswith("BayesianNetwork(21 CPDs, mixed)")


def test_discrete_parents_need_cpds():
    cpd = table(WET, RAIN, GREY)
    with pytest.raises(pgm.ModelError, match="parent grey has no CPD") as caught:
        BayesianNetwork([table(RAIN), cpd])
    assert caught.value.variable == GREY
    assert caught.value.cpd is cpd


def test_a_network_without_time_has_no_step_before():
    cpd = linear(A, A.previous)
    with pytest.raises(pgm.ModelError, match=r"a\[t-1\] is of a step before") as caught:
        BayesianNetwork([cpd])
    assert caught.value.variable == A.previous
    assert caught.value.cpd is cpd


@pytest.mark.parametrize(
    ("cpds", "words"),
    [
        ([], "at least one CPD"),
        ([linear(A), "p(b)"], "holds CPDs, not 'p\\(b\\)'"),
        ([A], "holds CPDs, not a"),
        ([pgm.CanonicalForm((A,), [[1.0]], [0.0])], "not CanonicalForm\\(a\\): .*MarkovNetwork"),
        (3, "sequence of CPDs, not 3"),
    ],
)
def test_only_cpds_are_taken(cpds, words):
    with pytest.raises(pgm.ModelError, match=words):
        BayesianNetwork(cpds)


def test_runs_must_broadcast():
    many, few = GaussianCPD(A, np.zeros((3, 1)), 1), GaussianCPD(B, np.zeros((2, 1)), 1)
    with pytest.raises(pgm.ModelError, match=r"axes of runs .*: a \(3,\), b \(2,\); give"):
        BayesianNetwork([many, few])
    assert BayesianNetwork([many, linear(B, A)]).lead == (3,)


def test_a_network_is_immutable():
    net = BayesianNetwork([linear(A)])
    with pytest.raises(AttributeError, match="immutable"):
        net.cpds = ()
    with pytest.raises(TypeError):
        net._by_child[B] = linear(B)


@pytest.mark.parametrize(
    "way", [copy.copy, copy.deepcopy, lambda net: pickle.loads(pickle.dumps(net))]
)
def test_copies_answer_alike(way):
    net = BayesianNetwork([linear(B, A, U), linear(A), linear(C, B)])
    twin = way(net)
    assert twin.variables == net.variables
    assert repr(twin) == repr(net)
    assert twin.cpd(B).parents == (A, U)
    inputs = {U: 2.0}
    for variable, draws in net.sample(3, inputs=inputs, rng=0).items():
        np.testing.assert_array_equal(twin.sample(3, inputs=inputs, rng=0)[variable], draws)
    with pytest.raises(TypeError):
        twin._by_child[D] = linear(D)
