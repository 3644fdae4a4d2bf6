"""Pose graphs as Bayesian networks: poses held, motions that lead on, and measurements that close.

Edges of a spanning tree are motions u with a prior, N(z, C): the pose at their other end is exactly
x ⊕ u, or x ⊕ (−u) where an edge leads the other way. All other edges are measurements of one pose
seen from another, z = relative(x, y) + e. Landmarks are placed by their first sighting, likewise.
Twice the negative log-density of the network is then, but for a constant, the error

    χ² = Σ rᵀ Ω r,    r = −z ⊕ relative(x, y),

of g2o, whose r is seen from the measured pose: C turns the inverse of the file's Ω by z's turn.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import networkx as nx
import numpy as np
import numpy.typing as npt

import pgm
from models import motion
from pgm.cpds import CPD
from pgm.recordings import Edges, PoseGraph

Array = npt.NDArray[np.float64]
_POSE = {"components": ("east", "north", "heading"), "angles": ("heading",)}
_MOTION = {"components": ("forward", "left", "turn"), "angles": ("turn",)}


@dataclass(frozen=True, eq=False)
class PoseGraphNetwork:
    """A pose graph's network, with what is given and where to begin.

    Attributes
    ----------
    graph : PoseGraph
    network : BayesianNetwork
    evidence : mapping of Variable to ndarray
        The measurements that are not of the tree.
    poses, landmarks : tuple of Variable
        As in the graph.
    held : tuple of int
        Rows of the poses that are known exactly: those that the file fixes, else the first.
    branches : tuple of (int, Edges, int, bool)
        The tree: the row of the parent pose, the kind of edge, its row, and whether it leads on
        to its second end.
    """

    graph: PoseGraph
    network: pgm.BayesianNetwork
    evidence: Mapping[pgm.Variable, Array]
    poses: tuple[pgm.Variable, ...]
    landmarks: tuple[pgm.Variable, ...]
    held: tuple[int, ...]
    branches: tuple[Branch, ...]

    def reckoned(self) -> tuple[Array, Array]:
        """Poses (N, 3) and landmarks (L, 2) by the motions of the tree alone."""
        poses, landmarks = self.graph.poses.copy(), self.graph.landmarks.copy()
        for branch in self.branches:
            told = branch.edges.motions[branch.edge]
            if branch.sees:
                landmarks[branch.child] = motion.place(poses[branch.parent], told)
            else:
                leads = motion.increment if branch.onward else motion.retreat
                poses[branch.child] = leads(poses[branch.parent], told)
        return poses, landmarks

    def start(self, poses: Array, landmarks: Array) -> dict[pgm.Variable, Array]:
        """Means for ``start=``, at poses (N, 3) and landmarks (L, 2); headings follow the tree."""
        poses = poses.copy()
        means: dict[pgm.Variable, Array] = {}
        for branch in self.branches:
            here = poses[branch.parent]
            if branch.sees:
                means[branch.variable] = motion.relative(here, landmarks[branch.child])
                continue
            there, told = poses[branch.child], branch.edges.motions[branch.edge, 2]
            turn = told if branch.onward else -told
            there[2] = here[2] + turn + _wrapped(there[2] - here[2] - turn)
            ends = (here, there) if branch.onward else (there, here)
            means[branch.variable] = motion.relative(*ends)
        means |= dict(zip(self.poses, poses, strict=True))
        return means | dict(zip(self.landmarks, landmarks, strict=True))

    def means(self, posterior: pgm.results.Posterior) -> tuple[Array, Array]:
        """Poses (N, 3) and landmarks (L, 2) of a posterior."""
        landmarks = posterior.means(self.landmarks) if self.landmarks else np.zeros((0, 2))
        return posterior.means(self.poses), landmarks


@dataclass(frozen=True, eq=False)
class Branch:
    """An edge of the tree.

    Attributes
    ----------
    parent, child : int
        Rows of the pose it leads from, and of the pose or landmark it leads to.
    edges : Edges
    edge : int
        Its row in these.
    variable : Variable
        The motion.
    sees : bool
        Whether it is a sighting of a landmark.
    onward : bool
        Whether it leads to its second end.
    """

    parent: int
    child: int
    edges: Edges
    edge: int
    variable: pgm.Variable
    sees: bool
    onward: bool


def pose_graph_network(graph: PoseGraph, noise: pgm.RobustNoise | None = None) -> PoseGraphNetwork:
    r"""The Bayesian network of a pose graph.

    Parameters
    ----------
    graph : PoseGraph
        The tree prefers edges to the next pose, then the file's order.
    noise : RobustNoise, optional
        The noise of all edges and sightings that are not of the tree, some of which may be wrong;
        Gaussian, if not given.

    Raises
    ------
    EvidenceError
        If the information of an edge has no covariance, or a vertex hangs on nothing.

    Examples
    --------
    >>> from io import StringIO
    >>> edge = "EDGE_SE2 0 1 1 0 0 9 0 0 9 0 9\n"
    >>> file = StringIO("VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 2 0 0\n" + 2 * edge)
    >>> made = pose_graph_network(pgm.recordings.read_pose_graph(file))
    >>> made.network.cpds[2:]
    (NonlinearGaussianCPD(x1 | x0, u0), NonlinearGaussianCPD(z1 | x0, x1))
    """
    poses = tuple(pgm.Variable(f"x{name}", **_POSE) for name in graph.names.tolist())
    landmarks = tuple(
        pgm.Variable(f"m{name}", components=("east", "north"))
        for name in graph.landmark_names.tolist()
    )
    held = tuple(dict.fromkeys(graph.fixed.tolist())) or (0,)
    moves, sights = _covariances(graph, graph.edges), _covariances(graph, graph.sightings)
    cpds: list[CPD] = [pgm.GaussianCPD(poses[row], graph.poses[row], 0.0) for row in held]
    evidence: dict[pgm.Variable, Array] = {}
    branches = (*_tree(graph, held), *_placed(graph))
    for branch in branches:
        cov = (sights if branch.sees else moves)[branch.edge]
        told = branch.edges.motions[branch.edge]
        parent, u = poses[branch.parent], branch.variable
        child = (landmarks if branch.sees else poses)[branch.child]
        leads = (
            (motion.place, motion.place_by_state, motion.place_by_sight)
            if branch.sees
            else (motion.increment, motion.increment_by_state, motion.increment_by_control)
            if branch.onward
            else (motion.retreat, motion.retreat_by_state, motion.retreat_by_control)
        )
        cpds.append(pgm.GaussianCPD(u, told, cov))
        cpds.append(
            pgm.NonlinearGaussianCPD(
                child,
                given=(parent, u),
                function=leads[0],
                cov=0.0,
                jacobian={parent: leads[1], u: leads[2]},
            )
        )
    for sees, edges, ends, covs in (
        (False, graph.edges, poses, moves),
        (True, graph.sightings, landmarks, sights),
    ):
        used = {branch.edge for branch in branches if branch.sees == sees}
        for row in sorted(set(range(len(edges))) - used):
            one, other = poses[edges.first[row]], ends[edges.second[row]]
            z = _measured("s" if sees else "z", row, sees)
            cpds.append(
                pgm.NonlinearGaussianCPD(
                    z,
                    given=(one, other),
                    function=motion.relative,
                    cov=covs[row],
                    jacobian={one: motion.relative_by_state, other: motion.relative_by_other},
                    noise=noise,
                )
            )
            evidence[z] = edges.motions[row]
    return PoseGraphNetwork(
        graph, pgm.BayesianNetwork(cpds), evidence, poses, landmarks, held, branches
    )


def squared_errors(graph: PoseGraph, poses: Array, landmarks: Array) -> Array:
    """The error rᵀ Ω r of each edge, then of each sighting, (E + S,); χ² is their sum."""
    found = []
    for edges, ends in ((graph.edges, poses), (graph.sightings, landmarks)):
        if not len(edges):
            continue
        away = motion.relative(poses[edges.first], ends[edges.second]) - edges.motions
        if away.shape[1] == 3:
            away[:, 2] = _wrapped(away[:, 2])
            away = np.einsum("eij,ei->ej", _turns(edges), away)
        found.append(np.einsum("ei,eij,ej->e", away, edges.information, away))
    return np.concatenate([np.zeros(0), *found])


def _covariances(graph: PoseGraph, edges: Edges) -> Array:
    """Covariances of the motions as they are told, seen from the first pose."""
    if not len(edges):
        return np.zeros((0, 1, 1))
    lowest = np.linalg.eigvalsh(edges.information)[:, 0]
    if (bad := np.flatnonzero(~(lowest > 0.0))).size:
        row = int(bad[0])
        names = graph.names if edges is graph.edges else graph.landmark_names
        raise pgm.EvidenceError(
            f"the edge from {graph.names[edges.first[row]]} to {names[edges.second[row]]} has the "
            f"information {edges.information[row].tolist()}, which has no covariance"
            f"{f', as {bad.size - 1} others' if bad.size > 1 else ''}: it is not positive "
            "definite; give unknown components a small one, and see whether the file's order of "
            "numbers is that of g2o (EDGE_SE2) or of TORO (EDGE2)"
        )
    turns = _turns(edges) if edges.motions.shape[1] == 3 else np.eye(2)
    found: Array = turns @ edges.covariances @ turns.swapaxes(-1, -2)
    return found


def _turns(edges: Edges) -> Array:
    """Turns of the plane by what each edge turns, (E, 3, 3)."""
    cos, sin = np.cos(edges.motions[:, 2]), np.sin(edges.motions[:, 2])
    out = np.zeros((len(edges), 3, 3))
    out[:, 0, 0] = out[:, 1, 1] = cos
    out[:, 1, 0], out[:, 0, 1] = sin, -sin
    out[:, 2, 2] = 1.0
    return out


def _measured(letter: str, row: int, sees: bool) -> pgm.Variable:
    if sees:
        return pgm.Variable(f"{letter}{row}", components=("forward", "left"))
    return pgm.Variable(f"{letter}{row}", **_MOTION)


def _tree(graph: PoseGraph, held: tuple[int, ...]) -> list[Branch]:
    """The edges by which each pose that is not held comes about, parents first."""
    edges, root = graph.edges, -1
    ends = list(zip(edges.first.tolist(), edges.second.tolist(), strict=True))
    joined = nx.Graph()
    joined.add_node(root)
    joined.add_edges_from((root, row, {"weight": 0}) for row in held)
    for row, (one, other) in enumerate(ends):
        if one != other and not joined.has_edge(one, other):
            far = 2 if abs(one - other) != 1 else 1
            joined.add_edge(one, other, weight=far, edge=row)
    lost = set(range(len(graph.poses))) - set(nx.node_connected_component(joined, root))
    if lost:
        raise pgm.EvidenceError(
            f"{len(lost)} poses, the first of them {graph.names[min(lost)]}, hang on no edge that "
            "leads to a pose that is held; FIX one of them, or leave them out"
        )
    tree = nx.minimum_spanning_tree(joined)
    found = []
    for parent, child in nx.bfs_edges(tree, root):
        if parent != root:
            row = tree.edges[parent, child]["edge"]
            onward = ends[row] == (parent, child)
            u = _measured("u", row, False)
            found.append(Branch(parent, child, edges, row, u, False, onward))
    return found


def _placed(graph: PoseGraph) -> list[Branch]:
    """The first sighting of each landmark."""
    seen, rows = np.unique(graph.sightings.second, return_index=True)
    if lost := set(range(len(graph.landmarks))) - set(seen.tolist()):
        raise pgm.EvidenceError(
            f"the landmark {graph.landmark_names[min(lost)]} is seen from no pose; leave it out"
        )
    return [
        Branch(
            int(graph.sightings.first[row]),
            int(landmark),
            graph.sightings,
            int(row),
            _measured("p", int(row), True),
            True,
            True,
        )
        for landmark, row in zip(seen.tolist(), rows.tolist(), strict=True)
    ]


def _wrapped(angle: npt.ArrayLike) -> Array:
    return np.asarray(np.remainder(np.asarray(angle) + np.pi, 2.0 * np.pi) - np.pi)
