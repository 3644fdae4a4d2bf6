"""Networks and cluster graphs are pictures in a notebook."""

import re
from xml.etree import ElementTree

import matplotlib as mpl
import matplotlib.pyplot as plt
import pytest

import pgm
from pgm.display import notebook as showing
from pgm.plot.diagrams import notebook

NAMESPACE = "{http://www.w3.org/2000/svg}"


def element(value):
    """The picture within the HTML of a value."""
    found = re.search(r"<svg.*</svg>", value._repr_html_(), re.DOTALL)
    return ElementTree.fromstring(found[0])


def static(count=3):
    many = pgm.variables([f"v{k}" for k in range(count)])
    return pgm.BayesianNetwork([pgm.GaussianCPD(v, 0.0, 1.0) for v in many])


def test_networks_and_graphs_are_drawn(robot):
    values = [robot, pgm.compile(robot, 2), pgm.compile(robot, 9, method=pgm.Balanced())]
    values += [static(), pgm.compile(static())]
    for value in values:
        found = element(value)
        assert found.tag == f"{NAMESPACE}svg"
        assert found.attrib["role"] == "img"
        assert found.attrib["aria-label"] == type(value).__name__
        assert "background: white" in found.attrib["style"]
        assert float(found.attrib["width"].removesuffix("pt")) <= notebook.WIDE
        assert float(found.attrib["height"].removesuffix("pt")) <= notebook.HIGH
        assert not found.findall(f".//{NAMESPACE}style")  # it would hold for the whole page
        assert repr(value).splitlines()[0] in value._repr_html_().replace("&#x27;", "'")


def test_a_long_chain_is_cut(robot):
    short, long = (pgm.compile(robot, steps)._repr_html_() for steps in (notebook.STEPS, 10_000))
    assert len(long) < 1.5 * len(short)


def test_a_large_graph_is_told_of():
    net = static(150)
    for value, call in ((net, "network(model"), (pgm.compile(net), "cluster_graph(graph")):
        html = value._repr_html_()
        assert "<svg" not in html
        assert f"150 are too many to draw here; <code>pgm.plot.{call}, ax=ax)</code>" in html


def test_names_are_letters_and_no_markup():
    bad = pgm.Variable('<script>alert(1)</script> -- ]]> $x_{ & "', ("<i>",))
    net = pgm.BayesianNetwork([pgm.GaussianCPD(bad, 0.0, 1.0)])
    for value in (net, pgm.compile(net)):
        found = element(value)
        tags = {node.tag.removeprefix(NAMESPACE) for node in found.iter()}
        assert tags <= {"svg", "g", "path", "defs", "clipPath", "rect", "use"}
        assert "<script" not in value._repr_html_()


def test_nothing_is_left_behind():
    before, figures = dict(mpl.rcParams), plt.get_fignums()
    interactive = plt.isinteractive()
    first, second = static()._repr_html_(), static()._repr_html_()
    assert first == second  # so that notebooks differ where their content does
    assert plt.get_fignums() == figures
    assert dict(mpl.rcParams) == before
    assert plt.isinteractive() == interactive


def test_without_matplotlib_there_is_text(monkeypatch):
    def missing():
        raise ImportError("No module named 'matplotlib'", name="matplotlib.pyplot")

    monkeypatch.setitem(showing._loaders, showing.Drawn, missing)
    html = static()._repr_html_()
    assert "<svg" not in html
    assert "BayesianNetwork(p(v0)" in html


def test_other_faults_of_drawing_are_not_hidden(monkeypatch):
    def broken():
        raise ImportError("No module named 'pgm.plott'", name="pgm.plott")

    monkeypatch.setitem(showing._loaders, showing.Drawn, broken)
    with pytest.raises(ImportError, match="plott"):
        static()._repr_html_()


@pytest.mark.parametrize("style", [{"text.usetex": True}, {"svg.fonttype": "none"}])
def test_the_users_style_does_not_break_the_picture(style):
    with mpl.rc_context(style):
        assert element(static()).findall(f".//{NAMESPACE}path")


def test_names_of_ten_thousand_letters_are_cut():
    name = "x" * 10_000
    a = pgm.Discrete(name, states=("no", "yes"))
    network = pgm.BayesianNetwork([pgm.TableCPD(a, table=[0.5, 0.5])])
    for shown in (network, pgm.compile(network)):
        assert len(shown._repr_html_()) < 100_000


def test_half_a_letter_is_a_question_mark():
    a = pgm.Discrete("\ud800", states=("no", "yes"))
    network = pgm.BayesianNetwork([pgm.TableCPD(a, table=[0.5, 0.5])])
    for shown in (network, pgm.compile(network)):
        assert "<svg" in shown._repr_html_()
