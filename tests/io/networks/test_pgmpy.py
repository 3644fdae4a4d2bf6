"""Networks from and to pgmpy: names, states, axes, and the answers of its own inference."""

import sys

import numpy as np
import pytest
from files import networks, same
from hypothesis import given, settings
from hypothesis import strategies as st

import pgm
from models.discrete import asia, sprinkler

NAMES = st.text(st.characters(exclude_categories=["Cs"]), max_size=4)


@pytest.fixture(scope="module")
def peer():
    return pytest.importorskip("pgmpy.models"), pytest.importorskip("pgmpy.factors.discrete")


@given(networks(NAMES))
@settings(max_examples=8)
def test_there_and_back(network):
    pytest.importorskip("pgmpy")
    theirs = pgm.to_pgmpy(network)
    back = pgm.from_pgmpy(theirs)
    for cpd in network.cpds:
        other = back.cpd(cpd.child)
        assert (cpd.child, cpd.given) == (other.child, other.given)
        np.testing.assert_array_equal(cpd.table, other.table)
        probabilities = theirs.get_cpds(cpd.child.name)
        for index in np.ndindex(*cpd.table.shape):
            states = {
                v.name: v.states[k] for v, k in zip((*cpd.given, cpd.child), index, strict=True)
            }
            assert probabilities.get_value(**states) == cpd.table[index]


@pytest.mark.parametrize("network", [sprinkler(), asia()])
def test_its_inference_agrees(peer, network):
    inference = pytest.importorskip("pgmpy.inference")
    theirs = pgm.to_pgmpy(network)
    assert theirs.check_model()
    observed = network.variables[-1]
    ours = pgm.infer(pgm.compile(network), {observed: observed.states[1]})
    elimination = inference.VariableElimination(theirs)
    for variable in network.variables[:-1]:
        found = elimination.query(
            [variable.name], {observed.name: observed.states[1]}, show_progress=False
        )
        due = [found.get_value(**{variable.name: state}) for state in variable.states]
        np.testing.assert_allclose(ours[variable].probabilities, due, atol=1e-12)


def test_names_become_text(peer):
    models, factors = peer
    theirs = models.DiscreteBayesianNetwork([(1, ("b", 2))])
    theirs.add_cpds(
        factors.TabularCPD(1, 2, [[0.2], [0.8]], state_names={1: [True, False]}),
        factors.TabularCPD(
            ("b", 2), 2, [[0.3, 0.4], [0.7, 0.6]], evidence=[1], evidence_card=[2],
            state_names={("b", 2): [0, 1], 1: [True, False]},
        ),
    )  # fmt: skip
    a = pgm.Discrete("1", ("True", "False"))
    b = pgm.Discrete("('b', 2)", ("0", "1"))
    due = [pgm.TableCPD(a, table=[0.2, 0.8]), pgm.TableCPD(b, a, table=[[0.3, 0.7], [0.4, 0.6]])]
    same(pgm.BayesianNetwork(due), pgm.from_pgmpy(theirs))


def test_names_that_are_equal_as_text(peer):
    models, factors = peer
    theirs = models.DiscreteBayesianNetwork()
    theirs.add_nodes_from([1, "1"])
    theirs.add_cpds(*(factors.TabularCPD(name, 2, [[0.2], [0.8]]) for name in (1, "1")))
    with pytest.raises(pgm.ModelError, match="1 has two CPDs"):
        pgm.from_pgmpy(theirs)


def test_states_in_two_orders(peer):
    models, factors = peer
    theirs = models.DiscreteBayesianNetwork([("a", "b")])
    theirs.add_cpds(
        factors.TabularCPD("a", 2, [[0.2], [0.8]], state_names={"a": ["x", "y"]}),
        factors.TabularCPD(
            "b", 2, [[0.3, 0.4], [0.7, 0.6]], evidence=["a"], evidence_card=[2],
            state_names={"b": ["u", "v"], "a": ["y", "x"]},
        ),
    )  # fmt: skip
    with pytest.raises(pgm.ModelError, match=r"CPD of b names the states of a in another order"):
        pgm.from_pgmpy(theirs)


def test_what_is_no_network_of_pgmpy(peer):
    models, _ = peer
    theirs = models.DiscreteBayesianNetwork([("a", "b")])
    for wrong in (theirs, sprinkler(), None, 3):
        with pytest.raises(pgm.ModelError, match=r"a DiscreteBayesianNetwork of pgmpy .* is due"):
            pgm.from_pgmpy(wrong)
    theirs = pgm.to_pgmpy(sprinkler())
    theirs.add_node("lonely")
    with pytest.raises(pgm.ModelError, match="no CPD of 'lonely'; add it with add_cpds"):
        pgm.from_pgmpy(theirs)


def test_without_pgmpy(monkeypatch):
    monkeypatch.setitem(sys.modules, "pgmpy.models", None)
    monkeypatch.setitem(sys.modules, "pgmpy.factors.discrete", None)
    with pytest.raises(ImportError, match=r"to_pgmpy\(\) needs pgmpy: pip install 'pgmpy>=1.0'"):
        pgm.to_pgmpy(sprinkler())
