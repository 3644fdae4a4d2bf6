import html
import re
import shutil
import subprocess

import numpy as np
import pytest

import pgm
import pgm.plot
from tests.plot.diagrams.zoo import random_parents, random_tree, static, tracker

_TOKEN = re.compile(r'"(?:[^"\\]|\\.)*"|->|--|[{}\[\];,=]|[\w.]+|\s+|.', re.DOTALL)


def parsed(text):
    """Kind, nodes with attributes, edges and ranks of a text in DOT, by its grammar."""
    tokens = [t for t in _TOKEN.findall(text) if not t.isspace()]
    kind, brace, *tokens = tokens
    assert (brace, tokens.pop()) == ("{", "}")
    nodes, edges, ranks = {}, [], []
    while tokens:
        if tokens[0] == "{":
            end = tokens.index("}")
            inside = [t for t in tokens[1:end] if t != ";"]
            assert inside[:3] == ["rank", "=", "same"]
            ranks.append(inside[3:])
            tokens = tokens[end + 1 :]
            continue
        end = tokens.index(";")
        statement, tokens = tokens[:end], tokens[end + 1 :]
        attributes = {}
        if "[" in statement:
            at = statement.index("[")
            assert statement[-1] == "]"
            pairs, statement = statement[at + 1 : -1], statement[:at]
            for k in range(0, len(pairs), 4):
                name, equals, value, *comma = pairs[k : k + 4]
                assert (equals, comma) in (("=", [","]), ("=", []))
                attributes[name] = unquoted(value)
        if len(statement) == 1 and statement[0] not in ("node", "edge"):
            nodes[statement[0]] = attributes
        elif len(statement) > 1 and statement[1] in ("->", "--"):
            assert statement[1] == ("->" if kind == "digraph" else "--")
            edges += zip(statement[:-2:2], statement[2::2], strict=True)
    return kind, nodes, edges, ranks


def unquoted(value):
    """A value as Graphviz shows it in a label."""
    if not value.startswith('"'):
        assert re.fullmatch(r"\w+", value)
        return value
    shown = re.sub(r"\\(.)", lambda m: "\n" if m[1] == "n" else m[1], value[1:-1])
    return html.unescape(shown)


def labelled(text):
    kind, nodes, edges, ranks = parsed(text)
    label = {name: attributes["label"] for name, attributes in nodes.items()}
    shown = {label[name]: attributes for name, attributes in nodes.items()}
    return (
        kind,
        shown,
        {(label[a], label[b]) for a, b in edges},
        [[label[n] for n in r] for r in ranks],
    )


def sprinkler():
    cloudy, rain, wet = (pgm.Discrete(name, 2) for name in ("cloudy", "rain", "wet grass"))
    half = np.full((2, 2), 0.5)
    net = pgm.BayesianNetwork(
        [
            pgm.TableCPD(cloudy, table=half[0]),
            pgm.TableCPD(rain, given=cloudy, table=half),
            pgm.TableCPD(wet, given=rain, table=half),
        ]
    )
    return net, (cloudy, rain, wet)


def test_a_network_is_a_digraph_with_its_evidence_shaded():
    net, (_, _, wet) = sprinkler()
    kind, nodes, edges, ranks = labelled(pgm.plot.dot(net, evidence={wet: "1"}))
    assert kind == "digraph"
    assert edges == {("cloudy", "rain"), ("rain", "wet grass")}
    assert {name for name, a in nodes.items() if "fillcolor" in a} == {"wet grass"}
    assert len(nodes) == 3
    assert not ranks


def test_slices_are_ranks(robot):
    text = pgm.plot.dot(robot, steps=2)
    assert "rankdir=LR;" in text
    _, nodes, edges, ranks = labelled(text)
    graph = robot.to_networkx(2)
    assert set(nodes) == {repr(v) for v in graph}
    assert edges == {(repr(a), repr(b)) for a, b in graph.edges}
    assert [set(rank) for rank in ranks] == [
        {repr(v) for v in graph if v.step == t} for t in range(3)
    ]
    assert {n for n, a in nodes.items() if "fillcolor" in a} == {n for n in nodes if n[0] in "zmu"}


def test_a_cluster_graph_has_boxes_between_ellipses(any_graph):
    a, b, c = pgm.variables("a b c")
    graph = any_graph([(a, b), (b, c), (c, a)], [(0, 1), (1, 2)])
    kind, nodes, edges, _ = parsed(pgm.plot.dot(graph))
    assert kind == "graph"
    boxes = {name: n["label"] for name, n in nodes.items() if n["shape"] == "box"}
    assert sorted(boxes.values()) == ["b", "c"]
    assert {n["label"] for n in nodes.values() if n["shape"] == "ellipse"} == {
        "a, b",
        "b, c",
        "c, a",
    }
    joined = {boxes[box]: set() for box in boxes}
    for edge in edges:
        (box,) = set(edge) & set(boxes)
        (other,) = set(edge) - set(boxes)
        joined[boxes[box]].add(nodes[other]["label"])
    assert joined == {"b": {"a, b", "b, c"}, "c": {"b, c", "c, a"}}


def test_steps_cut_a_chain_of_any_length(robot):
    graph = pgm.compile(robot, 300)
    _, nodes, _, _ = parsed(pgm.plot.dot(graph, steps=2))
    shapes = [n["shape"] for n in nodes.values()]
    assert [shapes.count(kind) for kind in ("ellipse", "box", "plaintext")] == [3, 2, 1]
    _, nodes, _, _ = parsed(pgm.plot.dot(graph))
    assert len(nodes) == 601


ODD = [
    'say "yes"',
    "back\\slash",
    "ends\\",
    "two\nlines",
    "a<b>",
    "R&amp;D",
    "{x|y}",
    "é;[=]->",
    "\\n",
]


@pytest.mark.parametrize("name", ODD)
def test_names_are_quoted(name):
    x = pgm.Discrete(name, 2)
    net = pgm.BayesianNetwork([pgm.TableCPD(x, table=[0.5, 0.5])])
    for drawn in (net, pgm.ClusterGraph(net, [{x}])):
        _, nodes, _, _ = parsed(pgm.plot.dot(drawn))
        assert [attributes["label"] for attributes in nodes.values()] == [name]


def test_variables_that_are_written_alike_are_kept_apart():
    x = pgm.Variable("x")
    net = pgm.BayesianNetwork(
        [
            pgm.GaussianCPD(x.at(3), 0.0, 1.0),
            pgm.LinearGaussianCPD(pgm.Variable("x[3]"), given={x.at(3): 1.0}, cov=1.0),
        ]
    )
    _, nodes, edges, _ = parsed(pgm.plot.dot(net))
    assert len(nodes) == 2
    assert len(edges) == 1
    assert edges[0][0] != edges[0][1]


def test_another_parser_agrees(robot):
    pydot = pytest.importorskip("pydot")
    net, (_, _, wet) = sprinkler()
    texts = [pgm.plot.dot(net, evidence=[wet]), pgm.plot.dot(robot, steps=2)]
    texts += [pgm.plot.dot(pgm.compile(robot, 5), steps=3)]
    for text in texts:
        _, nodes, edges, _ = parsed(text)
        (graph,) = pydot.graph_from_dot_data(text)
        names = {node.get_name() for node in graph.get_nodes()} - {"node", "edge"}
        assert names == set(nodes)
        pairs = {(e.get_source(), e.get_destination()) for e in graph.get_edges()}
        assert pairs == set(edges)


def test_what_cannot_be_written_is_refused(robot):
    with pytest.raises(pgm.ModelError, match="writes a network or a cluster graph, not int"):
        pgm.plot.dot(3)
    with pytest.raises(pgm.ModelError, match="steps cut a DynamicBayesianNetwork"):
        pgm.plot.dot(sprinkler()[0], steps=1)
    with pytest.raises(pgm.GraphError, match="last cluster to draw"):
        pgm.plot.dot(pgm.compile(robot, 3), steps=-1)
    with pytest.raises(pgm.EvidenceError, match="names w, which the network does not have"):
        pgm.plot.dot(robot, evidence=[pgm.Variable("w")])


@pytest.mark.skipif(shutil.which("dot") is None, reason="the program dot is not here")
@pytest.mark.parametrize("name", ["bethe", "tree", "star", "balanced", "children"])
def test_graphviz_makes_no_ribbon_of_it(name):
    if name == "children":
        drawn = static([[], *([0] for _ in range(20))])
    elif name == "balanced":
        drawn = pgm.compile(tracker(), 12, method=pgm.Balanced())
    else:
        parents = {"bethe": random_parents(40), "tree": random_tree(60)}.get(
            name, [[]] + [[0]] * 30
        )
        method = pgm.JunctionTree() if name == "tree" else pgm.Bethe()
        drawn = pgm.compile(static(parents), method=method)
    text = pgm.plot.dot(drawn)
    plain = subprocess.run(
        ["dot", "-Tplain"], input=text, capture_output=True, text=True, check=True
    ).stdout
    _, _, width, height = plain.splitlines()[0].split()
    assert 1 / 12 < float(width) / float(height) < 6


def test_edges_lead_away_from_a_centre():
    text = pgm.plot.dot(pgm.compile(static([[]] + [[0]] * 30), method=pgm.Bethe()))
    (centre,) = re.findall(r'(c\d+) \[shape=ellipse, .*label="v0"\]', text)
    first = re.findall(r"^ +(c\d+) -- s\w+ -- c\d+;", text, flags=re.MULTILINE)
    assert first.count(centre) == 30
    assert text.startswith("graph {\n  rankdir=LR;")
