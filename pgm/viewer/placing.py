"""The places of clusters on a page: trees from their centre on, other graphs by distances."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components, shortest_path

from pgm.clustergraph import ClusterGraph
from pgm.compile import BalancedGraph
from pgm.inference import CliqueTree
from pgm.kernels.arrays import Array

# In pixels, at the size at which labels are read: what a letter, a cluster, a sepset take.
_LETTER, _LEAST, _PADDING = 6.6, 44.0, 22.0
HEIGHT, _PLATE, _ACROSS, _DOWN = 40.0, 20.0, 44.0, 22.0
# The width of a screen to its height; rows stand up to so much further apart to fill it.
_SHAPE, _STRETCH = 1.4, 2.6
_ROUNDS = 80
Edge = tuple[int, int]


def place(
    clusters: Sequence[int],
    edges: Sequence[Edge],
    letters: Mapping[Any, int],
    graph: ClusterGraph | CliqueTree,
) -> dict[str, list[Any]]:
    """Place clusters so that none lies on another, in about the shape of a screen.

    letters: The length of the label of each cluster, by index, and of each sepset, by edge.

    Returns: x, y and width of each cluster, in pixels; of trees the cluster towards the root.
    """
    width = {k: max(_LEAST, _PADDING + _LETTER * n) for k, n in letters.items()}
    neighbours: dict[int, list[int]] = {k: [] for k in clusters}
    for i, j in edges:
        neighbours[i].append(j)
        neighbours[j].append(i)
    order = {k: at for at, k in enumerate(clusters)}
    ends = np.array([(order[i], order[j]) for i, j in edges], dtype=np.intp).reshape(-1, 2)
    links = csr_array(
        (np.ones(len(ends)), (ends[:, 0], ends[:, 1])), shape=(len(clusters), len(clusters))
    )
    count, part = connected_components(links, directed=False)
    members = [np.flatnonzero(part == k) for k in range(count)]
    boxes = []
    towards: dict[int, int] = {}
    for rows in members:
        nodes = [clusters[row] for row in rows.tolist()]
        joined = sum(len(neighbours[k]) for k in nodes) // 2
        if joined < len(nodes):
            boxes.append(_tree(nodes, neighbours, width, graph, towards))
        else:
            boxes.append(_by_distance(nodes, links[rows][:, rows], edges, width))
    at = np.zeros((len(clusters), 2))
    for rows, corner, box in zip(members, _packed(boxes), boxes, strict=True):
        at[rows] = box + corner
    wide = [width[k] for k in clusters]
    return {
        "x": at[:, 0].round(1).tolist(),
        "y": at[:, 1].round(1).tolist(),
        "width": wide,
        "towards": [towards.get(k) for k in clusters],
    }


def _tree(
    nodes: Sequence[int],
    neighbours: Mapping[int, Sequence[int]],
    width: Mapping[Any, float],
    graph: ClusterGraph | CliqueTree,
    towards: dict[int, int],
) -> Array:
    """A tree from its root to the right, or from its centre to both sides, in columns."""
    rooted = _roots(graph).intersection(nodes)
    root = min(rooted) if rooted else _centre(nodes, neighbours)
    parent, sequence = {root: root}, [root]
    for k in sequence:
        below = [j for j in neighbours[k] if j not in parent]
        parent |= dict.fromkeys(below, k)
        sequence += below
    children: dict[int, list[int]] = {k: [] for k in sequence}
    for k in sequence[1:]:
        children[parent[k]].append(k)
    if isinstance(graph, BalancedGraph):
        children = {k: sorted(found, key=graph.segment) for k, found in children.items()}
    size = dict.fromkeys(sequence, 1)
    for k in reversed(sequence[1:]):
        size[parent[k]] += size[k]
    # About half of the tree stands on either side of its centre.
    left: list[int] = []
    if not rooted:
        for k in sorted(children[root], key=lambda k: (-size[k], k)):
            if sum(size[j] for j in left) + size[k] <= len(nodes) // 2:
                left.append(k)
    at: dict[int, tuple[float, float]] = {root: (0.0, 0.0)}
    for side, first in ((1.0, [k for k in children[root] if k not in left]), (-1.0, left)):
        rows, depth = _rows({**children, root: first}, root)
        column = _columns(depth, parent, width)
        at |= {k: (side * column[depth[k]], row) for k, row in rows.items() if k != root}
    towards.update({k: parent[k] for k in sequence[1:]})
    found = np.array([at[k] for k in nodes])
    span = np.ptp(found, axis=0)
    if span[1] > 0.0:  # wide trees have room between their rows
        found[:, 1] *= np.clip(span[0] / _SHAPE / span[1], 1.0, _STRETCH)
    return found


def _roots(graph: ClusterGraph | CliqueTree) -> frozenset[int]:
    """The roots of a graph that has some."""
    if isinstance(graph, CliqueTree):
        return graph.roots
    return frozenset([graph.root]) if isinstance(graph, BalancedGraph) else frozenset()


def _centre(nodes: Sequence[int], neighbours: Mapping[int, Sequence[int]]) -> int:
    def farthest(start: int) -> tuple[int, dict[int, int]]:
        before, sequence = {start: start}, [start]
        for k in sequence:
            for j in neighbours[k]:
                if j not in before:
                    before[j] = k
                    sequence.append(j)
        return sequence[-1], before

    end, _ = farthest(min(nodes))
    other, before = farthest(end)
    path = [other]
    while path[-1] != end:
        path.append(before[path[-1]])
    return path[len(path) // 2]


def _rows(
    children: Mapping[int, Sequence[int]], root: int
) -> tuple[dict[int, float], dict[int, int]]:
    """The height of each node, subtrees as near to one another as their outlines let them."""
    depth, sequence = {root: 0}, [root]
    for k in sequence:
        for j in children[k]:
            depth[j] = depth[k] + 1
            sequence.append(j)
    apart = HEIGHT + _DOWN
    shift: dict[int, float] = {}
    # Of each subtree the highest and lowest place at each depth, about its own root.
    outline: dict[int, list[tuple[float, float]]] = {}
    for k in reversed(sequence):
        below = children[k]
        if not below:
            outline[k] = [(0.0, 0.0)]
            continue
        taken: list[tuple[float, float]] = []
        places = []
        for j in below:
            own = outline.pop(j)
            pairs = zip(taken, own, strict=False)
            at = max([low + apart - high for (_, low), (high, _) in pairs], default=0.0)
            places.append(at)
            for level, (high, low) in enumerate(own):
                if level < len(taken):
                    taken[level] = taken[level][0], at + low
                else:
                    taken.append((at + high, at + low))
        middle = 0.5 * (places[0] + places[-1])
        shift |= {j: at - middle for j, at in zip(below, places, strict=True)}
        outline[k] = [(0.0, 0.0), *((high - middle, low - middle) for high, low in taken)]
    rows = {root: 0.0}
    for k in sequence:
        for j in children[k]:
            rows[j] = rows[k] + shift[j]
    return rows, depth


def _columns(
    depth: Mapping[int, int], parent: Mapping[int, int], width: Mapping[Any, float]
) -> list[float]:
    """The middle of each column: wide enough for its clusters, and for the sepsets before it."""
    deepest = max(depth.values())
    widest, plate = [0.0] * (deepest + 1), [0.0] * (deepest + 1)
    for k, d in depth.items():
        widest[d] = max(widest[d], width[k])
        if d:
            edge = min(k, parent[k]), max(k, parent[k])
            plate[d] = max(plate[d], width[edge])
    found = [0.0]
    for d in range(1, deepest + 1):
        found.append(found[-1] + 0.5 * (widest[d - 1] + widest[d]) + plate[d] + _ACROSS)
    return found


def _by_distance(
    nodes: Sequence[int], links: csr_array, edges: Sequence[Edge], width: Mapping[Any, float]
) -> Array:
    """A graph with loops: distances on the page are to be those along its edges.

    Source: Gansner, Koren & North, Graph drawing by stress majorization, 2004.
    """
    wanted: Array = shortest_path(links, directed=False, unweighted=True)
    at = _turned(_stressed(wanted), links)
    own = set(nodes)
    plates = [width[edge] for edge in edges if edge[0] in own]
    across = float(np.mean([width[k] for k in nodes]) + np.mean(plates)) + _ACROSS
    down = HEIGHT + _PLATE + 2.0 * _DOWN
    return _apart(at * (across, max(down, 0.5 * across)), np.array([width[k] for k in nodes]))


def _stressed(wanted: Array) -> Array:
    """Places whose distances are near those wanted, weighted by their inverse squares."""
    count = len(wanted)
    centred = np.eye(count) - 1.0 / count
    values, vectors = np.linalg.eigh(-0.5 * centred @ wanted**2 @ centred)
    at: Array = vectors[:, -2:] * np.sqrt(np.maximum(values[-2:], 1e-9))
    at = at + 1e-3 * np.random.default_rng(0).standard_normal(at.shape)
    off = ~np.eye(count, dtype=bool)
    weight = np.where(off, 1.0 / np.where(off, wanted, 1.0) ** 2, 0.0)
    laplacian = np.diag(weight.sum(axis=1)) - weight
    inverse = np.linalg.inv(laplacian + 1.0 / count)
    for _ in range(_ROUNDS):
        apart = np.sqrt(np.maximum(((at[:, None] - at[None]) ** 2).sum(axis=-1), 1e-12))
        pull = np.where(off, weight * wanted / apart, 0.0)
        at = inverse @ ((np.diag(pull.sum(axis=1)) - pull) @ at)
    return at


def _turned(at: Array, links: csr_array) -> Array:
    """Places (nodes, 2), rotated so that links lie along the axes, and the longer side across.

    `links` is the adjacency matrix. Of 90 angles a within a quarter turn the one is taken that
    minimises Σ sin²(2 (φ − a)) over the links' directions φ, which is zero for links that are all
    level or upright. If the picture is then higher than wide, its axes are exchanged.
    """
    i, j = links.nonzero()
    steps = at[j] - at[i]
    angle = np.arctan2(steps[:, 1], steps[:, 0])
    turns = np.linspace(0.0, 0.5 * np.pi, 90, endpoint=False)
    slant = (np.sin(2.0 * (angle[:, None] - turns)) ** 2).sum(axis=0)
    best = turns[int(slant.argmin())]
    c, s = np.cos(best), np.sin(best)
    found: Array = at @ np.array([[c, -s], [s, c]])
    span = np.ptp(found, axis=0)
    return found if span[0] >= span[1] else found[:, ::-1]


def _apart(at: Array, width: Array) -> Array:
    """Places (nodes, 2) at which boxes of these widths (nodes,) no longer overlap; changes `at`.

    Each of two boxes that overlap is moved by 0.3 of the overlap, along the axis on which it is
    smaller, again and again; more than 600 boxes stay where they are.
    """
    wide = 0.5 * (width[:, None] + width[None]) + 0.5 * _ACROSS
    for _ in range(_ROUNDS if len(at) <= 600 else 0):
        across, down = (at[:, None, k] - at[None, :, k] for k in (0, 1))
        over_x, over_y = wide - np.abs(across), HEIGHT + _DOWN - np.abs(down)
        on = (over_x > 0.0) & (over_y > 0.0) & ~np.eye(len(at), dtype=bool)
        if not on.any():
            break
        sideways = on & (over_x < over_y)
        sign = np.triu(np.ones_like(across), 1) - np.tril(np.ones_like(across), -1)
        for k, push, where in ((0, over_x, sideways), (1, over_y, on & ~sideways)):
            way = np.where((across, down)[k] == 0.0, sign, np.sign((across, down)[k]))
            at[:, k] += 0.3 * np.where(where, push * way, 0.0).sum(axis=1)
    return at


def _packed(boxes: Sequence[Array]) -> list[Array]:
    """Offsets that place the parts in rows, the largest first."""
    sizes = [np.ptp(box, axis=0) + np.array([260.0, 110.0]) for box in boxes]
    widest = max(max(size[0] for size in sizes), 1.5 * np.sqrt(sum(s[0] * s[1] for s in sizes)))
    corners = [np.zeros(2)] * len(boxes)
    x = y = row = 0.0
    for k in sorted(range(len(boxes)), key=lambda k: -sizes[k][1]):
        if x and x + sizes[k][0] > widest:
            x, y, row = 0.0, y + row, 0.0
        corners[k] = np.array([x, y]) - boxes[k].min(axis=0)
        x, row = x + sizes[k][0], max(row, float(sizes[k][1]))
    return corners
