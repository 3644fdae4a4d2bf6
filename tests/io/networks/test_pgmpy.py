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


class Cpd:
    """A TabularCPD of pgmpy by the attributes that are read: parents' axes behind the child's."""

    def __init__(self, variable, values, given=(), states=("0", "1")):
        self.variable, self.variables = variable, [variable, *given]
        self.values = np.moveaxis(np.asarray(values, dtype=float), -1, 0)
        self.state_names = {node: list(states) for node in self.variables}


class Slices:
    """A DynamicBayesianNetwork of pgmpy by the attributes that are read."""

    def __init__(self, *cpds, nodes=()):
        self.cpds = cpds
        self.edges = [(parent, cpd.variable) for cpd in cpds for parent in cpd.variables[1:]]
        self.nodes = [*dict.fromkeys([*(cpd.variable for cpd in cpds), *nodes])]

    def get_cpds(self):
        return list(self.cpds)

    def get_interface_nodes(self, time_slice=0):
        return self.nodes


STAY, SAY = [[0.7, 0.3], [0.2, 0.8]], [[0.6, 0.4], [0.9, 0.1]]
Z0, Z1, X0, X1, Y0, Y1 = (("Z", 0), ("Z", 1), ("X", 0), ("X", 1), ("Y", 0), ("Y", 1))
START, STEP = Cpd(Z0, [0.5, 0.5]), Cpd(Z1, STAY, [Z0])
SENSOR = Cpd(X0, SAY, [Z0])


@pytest.mark.parametrize("more", [(), (Cpd(X1, SAY, [Z1]),)])
def test_two_slices_become_a_dynamic_network(more):
    z, x = (pgm.Discrete(name, ("0", "1")) for name in "ZX")
    found = pgm.from_pgmpy(Slices(START, SENSOR, STEP, *more))
    assert (found.states, found.sensors) == ((z,), (x,))
    posterior = pgm.filter(found, {x: ["0", "1"]})
    # The forward algorithm: readings are of steps 1 and 2.
    belief = np.array([0.5, 0.5])
    for state in (0, 1):
        belief = belief @ np.array(STAY) * np.array(SAY)[:, state]
        belief /= belief.sum()
    np.testing.assert_allclose(posterior[z].probabilities[-1], belief, atol=1e-12)


def test_variables_that_are_no_sensors_are_states():
    """A sensor that another law holds of later, and one between a state and a sensor."""
    later = pgm.from_pgmpy(Slices(START, SENSOR, STEP, Cpd(X1, STAY, [Z1])))
    assert [v.name for v in later.states] == ["Z", "X"]
    np.testing.assert_array_equal(later.transition[1].table, STAY)
    between = Slices(START, STEP, SENSOR, Cpd(Y0, STAY, [X0]))
    assert [v.name for v in pgm.from_pgmpy(between).sensors] == ["Y"]
    joined = Slices(START, SENSOR, Cpd(Z1, [STAY, SAY], [Z0, X0]), Cpd(X1, SAY, [Z1]))
    found = pgm.from_pgmpy(joined)
    assert not found.sensors
    z, x = found.states
    assert found.transition[0].parents == (z.previous, x.previous)


@pytest.mark.parametrize(
    ("network", "told"),
    [
        (Slices(START, SENSOR, nodes=[Z1]), None),
        (Slices(STEP, SENSOR), r"no CPD of \('Z', 0\); add it with add_cpds"),
        (Slices(START, STEP, nodes=[X0, X1]), r"no CPD of \('X', 0\)"),
        (Slices(START, STEP, Cpd(("Z", 2), STAY, [Z1])), r"has \('Z', 2\); slices 0 and 1"),
        (Slices(START, STEP, Cpd(X0, SAY, [Z1]), Cpd(X1, SAY, [Z1])), "of a later slice"),
        (
            Slices(START, STEP, Cpd(X0, SAY, [Z0], states=("1", "0"))),
            r"names the states of \('Z', 0\) as .* in one order",
        ),
    ],
)
def test_slices_that_make_no_dynamic_network(network, told):
    if told is None:  # a state that no edge leads on to is drawn anew in each slice
        assert pgm.from_pgmpy(network).transition[0].given == ()
        return
    with pytest.raises(pgm.ModelError, match=told):
        pgm.from_pgmpy(network)


def test_its_dynamic_inference_agrees(peer):
    models, factors = peer
    inference = pytest.importorskip("pgmpy.inference")
    rng = np.random.default_rng(0)

    def cpd(child, size, given=(), sizes=()):
        table = rng.random((size, int(np.prod(sizes))))
        given, sizes = (list(given), list(sizes)) if given else (None, None)
        return factors.TabularCPD(child, size, table / table.sum(axis=0), given, sizes)

    theirs = models.DynamicBayesianNetwork([(Z0, X0), (Z0, Z1), (Y0, Y1), (Z1, Y1), (Y0, X0)])
    theirs.add_cpds(
        cpd(Z0, 2), cpd(Y0, 3, [Z0], [2]), cpd(X0, 2, [Z0, Y0], [2, 3]),
        cpd(Z1, 2, [Z0], [2]), cpd(Y1, 3, [Y0, Z1], [3, 2]),
    )  # fmt: skip
    theirs.initialize_initial_state()
    ours = pgm.from_pgmpy(theirs)
    (x,), z = ours.sensors, next(v for v in ours.states if v.name == "Z")
    seen = [0, 1, 1, 0]
    posterior = pgm.smooth(ours, {x: pgm.sightings(seen, step=range(4))}, steps=3)
    answers = inference.DBNInference(theirs)
    for t in range(4):
        evidence = {("X", k): state for k, state in enumerate(seen)}
        due = answers.backward_inference([("Z", t)], evidence)["Z", t].values
        np.testing.assert_allclose(posterior[z].probabilities[t], due, atol=1e-9)
