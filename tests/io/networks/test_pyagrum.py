"""Networks from and to pyAgrum: axes, kinds of variables, what is refused, and its files.

The tests with pyAgrum itself are skipped where it is not installed: it is in the extra `files`, and
not in `test`, since it brings large packages.
"""

import sys

import numpy as np
import pytest
from files import networks, same
from hypothesis import given, settings
from hypothesis import strategies as st

import pgm
from models.discrete import asia, sprinkler

NAMES = st.text(st.characters(exclude_categories=["Cs"]), max_size=4).filter(
    lambda name: "\0" not in name
)


@pytest.fixture(scope="module")
def peer():
    return pytest.importorskip("pyagrum", reason="pip install 'sepset[files]'")


# By the attributes that are read, so that these tests need no pyAgrum.


class Variable:
    def __init__(self, name, labels):
        self._name, self._labels = name, tuple(labels)

    def name(self):
        return self._name

    def labels(self):
        return self._labels


class Tensor:
    """The values (sizes of `names` in turn), whose array has the axes in reverse."""

    def __init__(self, names, values):
        self.names, self.values = tuple(names), np.asarray(values, dtype=float)

    def reorganize(self, names):
        order = [self.names.index(name) for name in names]
        return Tensor(names, self.values.transpose(order))

    def toarray(self):
        return self.values.T


class Model:
    def __init__(self, variables):
        self._variables = variables

    def nodes(self):
        return set(range(len(self._variables)))

    def variable(self, node):
        return self._variables[node]


class Directed(Model):
    def __init__(self, variables, tensors):
        super().__init__(variables)
        self._tensors = tensors

    def cpt(self, node):
        return self._tensors[node]


class Undirected(Model):
    def __init__(self, variables, tensors):
        super().__init__(variables)
        self._tensors = tensors

    def addFactor(self, scope):
        raise NotImplementedError

    def factors(self):
        return list(range(len(self._tensors)))

    def factor(self, scope):
        return self._tensors[scope]


A, B, C = Variable("a b", ("x", "y,z")), Variable("b", ("0", "1", "2")), Variable("é", "uvwt")
TABLE = np.random.default_rng(0).dirichlet(np.ones(4), size=(3, 2))  # given b, "a b"


def directed(*changes):
    """Three variables of different sizes, the last one given the others, b before "a b"."""
    tensors = [
        Tensor(["a b"], [0.25, 0.75]),
        Tensor(["b"], [0.5, 0.125, 0.375]),
        Tensor(["é", "b", "a b"], np.moveaxis(TABLE, -1, 0)),
    ]
    for place, tensor in changes:
        tensors[place] = tensor
    return Directed([A, B, C], tensors)


def test_the_axes_of_a_cpt():
    a, b, c = (pgm.Discrete(v.name(), v.labels()) for v in (A, B, C))
    due = [
        pgm.TableCPD(a, table=[0.25, 0.75]),
        pgm.TableCPD(b, table=[0.5, 0.125, 0.375]),
        pgm.TableCPD(c, given=(b, a), table=TABLE),
    ]
    same(pgm.from_pyagrum(directed()), pgm.BayesianNetwork(due))


def test_a_markov_random_field():
    values = np.arange(1.0, 7.0).reshape(3, 2)
    found = pgm.from_pyagrum(Undirected([A, B, C], [Tensor(["b", "a b"], values)]))
    assert type(found) is pgm.MarkovNetwork
    factor, alone = found.factors
    assert [v.name for v in factor.scope] == ["b", "a b"]
    np.testing.assert_array_equal(factor.values, values)
    assert [v.name for v in alone.scope] == ["é"]
    posterior = pgm.infer(pgm.compile(found), {})
    np.testing.assert_allclose(posterior.log_evidence, np.log(values.sum() * 4))
    np.testing.assert_allclose(posterior[factor.scope[1]].probabilities, values.sum(0) / 21)


def test_tables_that_are_none():
    wrong = {
        "has not been filled": np.zeros((4, 3, 2)),
        "sum to 2;.*normalizeAsCPT": np.full((4, 3, 2), 0.5),
        "negative, NaN or infinite": np.full((4, 3, 2), np.nan),
    }
    for words, values in wrong.items():
        with pytest.raises(pgm.ModelError, match=words) as caught:
            pgm.from_pyagrum(directed((2, Tensor(["é", "b", "a b"], values))))
        assert "é" in str(caught.value)
    for words, values in (("zero throughout", np.zeros(2)), ("negative, NaN", [-1.0, 2.0])):
        with pytest.raises(pgm.ModelError, match=words):
            pgm.from_pyagrum(Undirected([A], [Tensor(["a b"], values)]))


def test_a_part_of_a_network():
    part = Directed([C], [Tensor(["é", "b", "a b"], np.moveaxis(TABLE, -1, 0))])
    with pytest.raises(pgm.ModelError, match=r"CPT of 'é' has the parent 'b', which .* not have"):
        pgm.from_pyagrum(part)


def test_variables_that_are_none():
    for variable, words in (
        (Variable("d", ("[0;1[", "[0;1[")), r"two states are called '\[0;1\['"),
        (Variable("", "xy"), "non-empty"),
    ):
        one = Directed([variable], [Tensor([variable.name()], [0.5, 0.5])])
        with pytest.raises(pgm.ModelError, match=words):
            pgm.from_pyagrum(one)


def test_what_is_no_network_of_pyagrum(tmp_path):
    for wrong in (sprinkler(), None, 3):
        with pytest.raises(pgm.ModelError, match="a BayesNet or a MarkovRandomField of pyAgrum is"):
            pgm.from_pyagrum(wrong)
    for path in ("network.net", tmp_path / "network.net"):
        with pytest.raises(pgm.ModelError, match=r"loadBN\('.*network\.net'\)\)"):
            pgm.from_pyagrum(path)


def test_without_pyagrum(monkeypatch):
    monkeypatch.setitem(sys.modules, "pyagrum", None)
    with pytest.raises(ImportError, match=r"to_pyagrum\(\) needs pyagrum: pip install .*\[files\]"):
        pgm.to_pyagrum(sprinkler())


def test_a_single_state_has_no_place_there():
    one = pgm.Discrete("one", ("always",))
    with pytest.raises(pgm.ModelError, match="one has the single state 'always'") as caught:
        pgm.to_pyagrum(pgm.BayesianNetwork([pgm.TableCPD(one, table=[1.0])]))
    assert caught.value.variable == one


# With pyAgrum.


@given(networks(NAMES))
@settings(max_examples=20, deadline=None)
def test_there_and_back(network):
    pytest.importorskip("pyagrum", reason="pip install 'sepset[files]'")
    if any(v.size == 1 for v in network.variables):
        with pytest.raises(pgm.ModelError, match="single state"):
            pgm.to_pyagrum(network)
        return
    theirs = pgm.to_pyagrum(network)
    same(pgm.from_pyagrum(theirs), network)
    for cpd in network.cpds:  # by the names of states, whatever the axes are
        probabilities = theirs.cpt(cpd.child.name)
        for index in np.ndindex(*cpd.table.shape):
            scope = zip((*cpd.given, cpd.child), index, strict=True)
            assert probabilities[{v.name: k for v, k in scope}] == cpd.table[index]


@pytest.mark.parametrize("network", [sprinkler(), asia()])
def test_its_inference_agrees(peer, network):
    theirs = pgm.to_pyagrum(network)
    assert not theirs.check()
    seen = network.variables[-1]
    engine = peer.LazyPropagation(theirs)
    engine.setEvidence({seen.name: seen.states[1]})
    engine.makeInference()
    ours = pgm.infer(pgm.compile(network), {seen: seen.states[1]})
    np.testing.assert_allclose(ours.log_evidence, np.log(engine.evidenceProbability()), atol=1e-12)
    for variable in network.variables[:-1]:
        due = engine.posterior(variable.name).tolist()
        np.testing.assert_allclose(ours[variable].probabilities, due, atol=1e-12)


def test_kinds_of_variables(peer):
    theirs = peer.BayesNet()
    theirs.add(peer.LabelizedVariable("a b, c|{}", "with words", ["x y", "", "z;"]))
    theirs.add(peer.RangeVariable("range", "", 3, 5))
    theirs.add(peer.IntegerVariable("integer", "", [7, -2]))
    theirs.add(peer.DiscretizedVariable("parts", "", [0.0, 1.5, 3.0, 4.5, 6.0]))
    theirs.add(peer.NumericalDiscreteVariable("numbers", "", [0.5, 2.25]))
    for parent in ("range", "a b, c|{}", "parts"):
        theirs.addArc(parent, "integer")
    theirs.generateCPTs()
    found = pgm.from_pyagrum(theirs)
    states = {v.name: v.states for v in found.variables}
    assert states == {
        "a b, c|{}": ("x y", "", "z;"),
        "range": ("3", "4", "5"),
        "integer": ("-2", "7"),
        "parts": ("[0;1.5[", "[1.5;3[", "[3;4.5[", "[4.5;6]"),
        "numbers": ("0.5", "2.25"),
    }
    cpd = found.cpd(next(v for v in found.variables if v.name == "integer"))
    assert [v.name for v in cpd.given] == ["range", "a b, c|{}", "parts"]
    for index in np.ndindex(*cpd.table.shape):
        scope = zip((*cpd.given, cpd.child), index, strict=True)
        due = theirs.cpt("integer")[{v.name: k for v, k in scope}]
        assert cpd.table[index] == due


def test_a_noisy_or(peer):
    """The CPT is kept as a function, whose array is not that of its values in all versions."""
    theirs = peer.BayesNet()
    for name in "AB":
        theirs.add(peer.LabelizedVariable(name, "", 2))
        theirs.cpt(name).fillWith([0.3, 0.7])
    theirs.addNoisyOR(peer.LabelizedVariable("N", "", 2), 0.1)
    theirs.addWeightedArc("A", "N", 0.4)
    theirs.addWeightedArc("B", "N", 0.6)
    table = pgm.from_pyagrum(theirs).cpds[-1].table
    off = 0.9 * np.array([[1.0, 0.4 / 0.9], [0.6 / 0.9, 0.4 * 0.6 / 0.9]])
    due = [theirs.cpt("N")[{"A": a, "B": b, "N": 0}] for a in (0, 1) for b in (0, 1)]
    np.testing.assert_allclose(table[..., 0].ravel(), due)
    np.testing.assert_allclose(table[0, 0, 0], off[0, 0])


def test_a_field_of_its_own_inference(peer):
    theirs = peer.MarkovRandomField()
    for name, size in (("A", 2), ("B", 3), ("C", 4), ("D", 2)):
        theirs.add(peer.LabelizedVariable(name, "", size))
    rng = np.random.default_rng(1)
    for scope in (["C", "A"], ["A", "B"], ["B", "D", "C"], ["D"]):
        factor = theirs.addFactor(scope)
        factor.fillWith(rng.gamma(1.0, size=factor.domainSize()).tolist())
    found = pgm.from_pyagrum(theirs)
    posterior = pgm.infer(pgm.compile(found), {})
    engine = peer.ShaferShenoyMRFInference(theirs)
    engine.makeInference()
    for variable in found.variables:
        due = engine.posterior(variable.name).tolist()
        np.testing.assert_allclose(posterior[variable].probabilities, due, atol=1e-12)


def test_other_models_of_its_own(peer):
    with pytest.raises(pgm.ModelError, match=r"influence diagram .* decisions and utilities"):
        pgm.from_pyagrum(peer.fastID("A->*D->$U"))
    base = peer.fastBN("A->B")
    with pytest.raises(pgm.ModelError, match="a BayesNet or a MarkovRandomField"):
        pgm.from_pyagrum(peer.CredalNet(base))
    theirs = peer.BayesNet()
    theirs.add(peer.LabelizedVariable("a", "", 2))
    with pytest.raises(pgm.ModelError, match="has not been filled"):
        pgm.from_pyagrum(theirs)
    with pytest.raises(pgm.ModelError, match="needs at least one CPD"):
        pgm.from_pyagrum(peer.BayesNet())


HUGIN = """net
{
  node_size = (80 40);
}
node Rain
{
  states = ("no" "yes");
}
node Wet
{
  states = ("dry" "damp" "soaked");
}
node Slip
{
  states = ("no" "yes");
}
potential (Rain)
{
  data = (0.75 0.25);
}
potential (Wet | Rain)
{
  data = ((0.5 0.25 0.25) (0.125 0.375 0.5));
}
potential (Slip | Wet Rain)
{
  data = (((1.0 0.0) (0.875 0.125)) ((0.75 0.25) (0.625 0.375)) ((0.5 0.5) (0.25 0.75)));
}
"""
GENIE = """net rain
{
  HEADER = { ID = rain; NAME = "rain"; };
  node Rain
  {
    TYPE = CPT;
    HEADER = { ID = Rain; NAME = "Rain"; };
    PARENTS = ();
    DEFINITION = { NAMESTATES = (no, yes); PROBABILITIES = (0.75, 0.25); };
  };
  node Wet
  {
    TYPE = CPT;
    HEADER = { ID = Wet; NAME = "Wet"; };
    PARENTS = (Rain);
    DEFINITION = {
      NAMESTATES = (dry, damp, soaked);
      PROBABILITIES = (0.5, 0.25, 0.25, 0.125, 0.375, 0.5);
    };
  };
  node Slip
  {
    TYPE = CPT;
    HEADER = { ID = Slip; NAME = "Slip"; };
    PARENTS = (Wet, Rain);
    DEFINITION = {
      NAMESTATES = (no, yes);
      PROBABILITIES = (1, 0, 0.875, 0.125, 0.75, 0.25, 0.625, 0.375, 0.5, 0.5, 0.25, 0.75);
    };
  };
};
"""


@pytest.mark.parametrize(("name", "text"), [("a.net", HUGIN), ("a.dsl", GENIE)])
def test_files_by_its_readers(peer, tmp_path, name, text):
    """In both formats the child's state moves fastest, then that of the last parent."""
    file = tmp_path / name
    file.write_text(text)
    with pytest.raises(pgm.FileError, match=r"pgm\.from_pyagrum\(pyagrum\.loadBN\("):
        pgm.read_bif(file)
    found = pgm.from_pyagrum(peer.loadBN(str(file)))
    rain = pgm.Discrete("Rain", ("no", "yes"))
    wet = pgm.Discrete("Wet", ("dry", "damp", "soaked"))
    slip = pgm.Discrete("Slip", ("no", "yes"))
    assert set(found.variables) == {rain, wet, slip}
    np.testing.assert_allclose(found.cpd(rain).table, [0.75, 0.25], atol=1e-7)
    assert found.cpd(wet).given == (rain,)
    np.testing.assert_allclose(found.cpd(wet).table, [[0.5, 0.25, 0.25], [0.125, 0.375, 0.5]])
    own = found.cpd(slip)
    table = np.moveaxis(own.table, [own.given.index(wet), own.given.index(rain)], [0, 1])
    due = [[0.0, 0.125], [0.25, 0.375], [0.5, 0.75]]
    np.testing.assert_allclose(table[..., 1], due, atol=1e-7)
