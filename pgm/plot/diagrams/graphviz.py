"""Networks and cluster graphs in DOT, the language of Graphviz, as text."""

from collections import defaultdict
from collections.abc import Iterable
from typing import cast

import networkx as nx

from pgm.arguments import public
from pgm.clustergraph import ClusterGraph
from pgm.errors import ModelError
from pgm.evidence import Evidence
from pgm.plot.diagrams.arrangement import is_chain, key, outward
from pgm.plot.diagrams.contents import contents, links, shown
from pgm.plot.diagrams.contents import joined as sepsets_of
from pgm.plot.diagrams.networks import Directed, Network, directed, in_slices, joined
from pgm.plot.drawing.colours import CLUSTER, INK, MUTED, OBSERVED, SEPSET
from pgm.variables import Variable

# A level of more nodes than this, for each level that there is, makes a ribbon.
_WIDE = 3


@public
def dot(
    drawn: Network | ClusterGraph,
    *,
    steps: int | None = None,
    evidence: Iterable[Variable] | None = None,
) -> str:
    """Write a network or a cluster graph in DOT, the language of Graphviz.

    A network is a ``digraph`` with its observed variables shaded, its slices as ranks from left
    to right where it has time; a `MarkovNetwork` is a ``graph``, and a cluster graph one of
    ellipses and boxes. Nothing of Graphviz is needed to write it.

    Parameters
    ----------
    drawn : BayesianNetwork, DynamicBayesianNetwork, MarkovNetwork or ClusterGraph
    steps : int, optional
        The last slice of a dynamic network, 1 without; the last cluster of a cluster graph.
    evidence : iterable or mapping of Variable, optional
        As for `network` and `cluster_graph`.

    Raises
    ------
    ModelError, GraphError, EvidenceError
        As by `network` and `cluster_graph`; ModelError if it is neither.

    Examples
    --------
    >>> from pgm.examples import b, pair
    >>> print(dot(pair, evidence=[b]))
    digraph {
      node [shape=ellipse, style=filled, fillcolor="white", color="#222222"];
      v0 [label="a"];
      v1 [label="b", fillcolor="#D0D0D0"];
      v0 -> v1;
    }
    """
    if isinstance(drawn, Network):
        return _network(drawn, steps, evidence)
    if isinstance(drawn, ClusterGraph):
        return _cluster_graph(drawn, steps, evidence)
    raise ModelError(f"dot writes a network or a cluster graph, not {type(drawn).__name__}")


def _network(model: Network, steps: int | None, evidence: Iterable[Variable] | None) -> str:
    arrows = isinstance(model, Directed)
    graph = (
        directed(model, steps, evidence)
        if isinstance(model, Directed)
        else joined(model.factors, steps, evidence)
    )
    names = {node: f"v{k}" for k, node in enumerate(graph)}
    lines = [f'node [shape=ellipse, style=filled, fillcolor="white", color="{INK}"];']
    for node, name in names.items():
        shade = f', fillcolor="{OBSERVED}"' if graph.nodes[node]["observed"] else ""
        lines.append(f"{name} [label={_quoted(repr(node))}{shade}];")
    if arrows and in_slices(graph):
        lines.insert(0, "rankdir=LR;")
        slices = defaultdict(list)
        for node, name in names.items():
            slices[node.step].append(name)
        for step in sorted(slices):
            lines.append(f"{{ rank=same; {'; '.join(slices[step])}; }}")
    elif _wide(graph):
        lines.insert(0, "rankdir=LR;")
    join = "->" if arrows else "--"
    lines += [f"{names[parent]} {join} {names[child]};" for parent, child in graph.edges]
    return _block("digraph" if arrows else "graph", lines)


def _cluster_graph(
    graph: ClusterGraph, steps: int | None, evidence: Iterable[Variable] | None
) -> str:
    clusters = shown(graph, steps)
    sepsets, cut = sepsets_of(graph, clusters)
    texts = contents(graph, clusters, sepsets, cast(Evidence | None, evidence), sizes=False)
    # Graphviz puts the first end of an edge above the other, so edges point away from a centre.
    joins = links(graph, clusters, sepsets)
    arrows = outward(joins)
    lines = ["rankdir=LR;"] if is_chain(joins) or _wide(nx.DiGraph(arrows)) else []
    # What neato, fdp and sfdp need; dot passes it over.
    lines += ["overlap=false;", "splines=true;"]
    lines += [f'node [style=filled, color="{INK}"];', f'edge [color="{MUTED}"];']
    for cluster in clusters:
        text = _quoted(texts[cluster.index])
        lines.append(f'c{cluster.index} [shape=ellipse, fillcolor="{CLUSTER}", label={text}];')
    for i, j in sepsets:
        text = _quoted(texts[i, j])
        lines.append(f's{i}_{j} [shape=box, fillcolor="{SEPSET}", label={text}];')
    for i, j in arrows:
        one, other = key(i, j)
        lines.append(f"c{i} -- s{one}_{other} -- c{j};")
    for k in dict.fromkeys(cut):
        lines.append(f'rest{k} [shape=plaintext, style="", label="…"];')
        lines.append(f"c{k} -- rest{k} [style=dashed];")
    return _block("graph", lines)


def _wide(graph: nx.DiGraph) -> bool:
    """Whether levels are so wide that the diagram is better turned on its side."""
    levels = [len(level) for level in nx.topological_generations(graph)]
    return max(levels, default=0) > _WIDE * len(levels)


def _block(kind: str, lines: Iterable[str]) -> str:
    return "\n".join([f"{kind} {{", *(f"  {line}" for line in lines), "}"])


def _quoted(text: str) -> str:
    """A text as a label shows it: escapes and entities that Graphviz would replace are escaped."""
    for plain, escaped in (("\\", "\\\\"), ('"', '\\"'), ("\n", "\\n"), ("&", "&amp;")):
        text = text.replace(plain, escaped)
    return f'"{text}"'
