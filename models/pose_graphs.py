"""Pose graphs as Markov networks of residual factors alone, one an edge.

An edge is a measurement z of one pose, or landmark, seen from another: the factor
N(relative(x, y) − z; 0, C). Edges leave open where on the plane all of it lies, and how it is
turned: the network has no density until a pose is held. Poses that are held are known, as evidence.
Twice the negative logarithm of the product is, but for a constant, the error

    χ² = Σ rᵀ Ω r,    r = −z ⊕ relative(x, y),

of g2o, whose r is seen from the measured pose: C turns the inverse of the file's Ω by z's turn.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import networkx as nx
import numpy as np
import numpy.typing as npt
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

import pgm
from models import motion
from pgm.recordings import Edges, PoseGraph

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.intp]
Mask = npt.NDArray[np.bool_]
_POSE = {"components": ("east", "north", "heading"), "angles": ("heading",)}
_PLACE = {"components": ("east", "north")}


@dataclass(frozen=True, eq=False)
class PoseGraphNetwork:
    """A pose graph's network, its factors by row, what is given and where to begin.

    Attributes
    ----------
    graph : PoseGraph
    network : MarkovNetwork
    evidence : mapping of Variable to ndarray
        The poses that are held.
    poses, landmarks : tuple of Variable
        As in the graph.
    edges, sightings : tuple of NonlinearGaussianFactor
        As in the graph; a posterior has the weight of each, ``posterior.weights[edge]``.
    held : tuple of int
        Rows of the poses that are known exactly: those that the file fixes, else the first.
    """

    graph: PoseGraph
    network: pgm.MarkovNetwork
    evidence: Mapping[pgm.Variable, Array]
    poses: tuple[pgm.Variable, ...]
    landmarks: tuple[pgm.Variable, ...]
    edges: tuple[pgm.NonlinearGaussianFactor, ...]
    sightings: tuple[pgm.NonlinearGaussianFactor, ...]
    held: tuple[int, ...]

    @cached_property
    def branches(self) -> tuple[Branch, ...]:
        """A tree of edges that leads from the poses that are held to all others, parents first."""
        return _branches(self.graph, self.held)

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

    def start(
        self, poses: Array | None = None, landmarks: Array | None = None
    ) -> dict[pgm.Variable, Array]:
        """Means for ``start=``, at poses (N, 3) and landmarks (L, 2); the graph's own without."""
        at = self.graph.poses if poses is None else poses
        marks = self.graph.landmarks if landmarks is None else landmarks
        means = {self.poses[row]: at[row] for row in self.free}
        return means | dict(zip(self.landmarks, marks, strict=True))

    @property
    def free(self) -> list[int]:
        """Rows of the poses that are not held."""
        return sorted(set(range(len(self.poses))) - set(self.held))

    def means(self, posterior: pgm.results.Posterior) -> tuple[Array, Array]:
        """Poses (N, 3) and landmarks (L, 2) of a posterior."""
        poses, free = self.graph.poses.copy(), self.free
        poses[free] = posterior.means([self.poses[row] for row in free])
        landmarks = posterior.means(self.landmarks) if self.landmarks else np.zeros((0, 2))
        return poses, landmarks

    def covs(self, posterior: pgm.results.Posterior) -> tuple[Array, Array]:
        """Covariances of poses (N, 3, 3), zero of those held, and of landmarks (L, 2, 2)."""
        covs, free = np.zeros((len(self.poses), 3, 3)), self.free
        covs[free] = posterior.covs([self.poses[row] for row in free])
        landmarks = posterior.covs(self.landmarks) if self.landmarks else np.zeros((0, 2, 2))
        return covs, landmarks

    def weights(self, posterior: pgm.results.Posterior) -> Array:
        """The weight of each edge, then of each sighting, (E + S,); 1 for Gaussian noise."""
        found = posterior.weights
        return np.array([found[factor] for factor in (*self.edges, *self.sightings)])


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
    sees : bool
        Whether it is a sighting of a landmark.
    onward : bool
        Whether it leads to its second end.
    """

    parent: int
    child: int
    edges: Edges
    edge: int
    sees: bool
    onward: bool


def pose_graph_network(
    graph: PoseGraph,
    noise: pgm.RobustNoise | None = None,
    doubted: npt.ArrayLike | None = None,
) -> PoseGraphNetwork:
    r"""The Markov network of a pose graph.

    Parameters
    ----------
    graph : PoseGraph
    noise : RobustNoise, optional
        The noise of edges and sightings that may be wrong; Gaussian, if not given.
    doubted : array_like of int, optional
        Which may be wrong: rows of the edges, and of the sightings behind them, (0 to E + S − 1);
        if not given, all but the first edge between each pose and the next. All may be.

    Raises
    ------
    EvidenceError
        If the information of an edge has no covariance, a vertex hangs on nothing, or `doubted` are
        no rows.

    Examples
    --------
    >>> from io import StringIO
    >>> edge = "EDGE_SE2 0 1 1 0 0 9 0 0 9 0 9\n"
    >>> file = StringIO("VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 2 0 0\n" + 2 * edge)
    >>> made = pose_graph_network(pgm.recordings.read_pose_graph(file))
    >>> made.network
    MarkovNetwork(φ(x0, x1)  φ(x0, x1))
    """
    poses = pgm.variables((f"x{name}" for name in graph.names.tolist()), **_POSE)
    landmarks = pgm.variables((f"m{name}" for name in graph.landmark_names.tolist()), **_PLACE)
    held = tuple(dict.fromkeys(graph.fixed.tolist())) or (0,)
    _require_hanging(graph, held)
    robust = _robust(graph, noise, doubted)
    evidence = {poses[row]: graph.poses[row] for row in held}
    count = len(graph.edges)
    edges = _factors(graph, graph.edges, (poses, poses), noise, robust[:count])
    sightings = _factors(graph, graph.sightings, (poses, landmarks), noise, robust[count:])
    network = pgm.MarkovNetwork([*edges, *sightings])
    return PoseGraphNetwork(graph, network, evidence, poses, landmarks, edges, sightings, held)


def _robust(graph: PoseGraph, noise: pgm.RobustNoise | None, doubted: Any) -> Mask:
    """Which edges, and then sightings, have robust noise, (E + S,)."""
    count = len(graph.edges) + len(graph.sightings)
    found = np.zeros(count, dtype=bool)
    if noise is None:
        if doubted is not None:
            raise pgm.EvidenceError(
                "doubted are rows of edges that have the robust noise=, and none is given; give "
                "one, such as pgm.Cauchy(1.0)"
            )
        return found
    if doubted is None:
        found[:] = True
        found[_onward(graph)] = False
        return found
    rows = np.asarray(doubted)
    if (
        rows.ndim != 1
        or (rows.size and rows.dtype.kind != "i")
        or ((rows < 0) | (rows >= count)).any()
    ):
        raise pgm.EvidenceError(
            f"doubted are rows of the edges, and of the sightings behind them, from 0 to "
            f"{count - 1}; found {doubted!r}"
        )
    found[rows.astype(int)] = True
    return found


def _onward(graph: PoseGraph) -> Integers:
    """The first edge between each pose and the next, where there is one."""
    edges = graph.edges
    chain = np.setdiff1d(np.arange(len(edges)), graph.loops)
    _, rows = np.unique(np.minimum(edges.first, edges.second)[chain], return_index=True)
    return chain[rows]


def _factors(
    graph: PoseGraph,
    edges: Edges,
    ends: tuple[Sequence[pgm.Variable], Sequence[pgm.Variable]],
    noise: pgm.RobustNoise | None,
    robust: Mask,
) -> tuple[pgm.NonlinearGaussianFactor, ...]:
    """The factors of edges, or sightings: a plate of Gaussian noise, and one of robust."""
    covs = _covariances(graph, edges)
    found: dict[int, pgm.NonlinearGaussianFactor] = {}
    for rows, own in ((np.flatnonzero(~robust), None), (np.flatnonzero(robust), noise)):
        if not rows.size:
            continue
        seen = (
            [ends[0][row] for row in edges.first[rows]],
            [ends[1][row] for row in edges.second[rows]],
        )
        one, other = (
            of[0]._with(name=name) for of, name in zip(seen, ("one", "other"), strict=True)
        )
        size = edges.motions.shape[1]
        any_edge = pgm.NonlinearGaussianFactor(
            (one, other),
            motion.relative,
            cov=np.eye(size),
            angles=(False, False, True)[:size],
            jacobian={one: motion.relative_by_state, other: motion.relative_by_other},
            noise=own,
        )
        over = dict(zip((one, other), seen, strict=True))
        made = pgm.plate(any_edge, over, value=edges.motions[rows], cov=covs[rows])
        found.update(zip(rows.tolist(), made, strict=True))
    return tuple(found[row] for row in range(len(edges)))


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


def _require_hanging(graph: PoseGraph, held: tuple[int, ...]) -> None:
    """Refuse poses that no edges lead to from one that is held, and landmarks that none sees."""
    edges, count = graph.edges, len(graph.poses)
    first = np.concatenate([edges.first, np.full(len(held), count)])
    second = np.concatenate([edges.second, held])
    joined = coo_array((np.ones(len(first)), (first, second)), (count + 1, count + 1))
    _, part = connected_components(joined, directed=False)
    if (lost := np.flatnonzero(part[:-1] != part[-1])).size:
        raise pgm.EvidenceError(
            f"{lost.size} poses, the first of them {graph.names[lost[0]]}, hang on no edge that "
            "leads to a pose that is held; FIX one of them, or leave them out"
        )
    if (lost := np.setdiff1d(np.arange(len(graph.landmarks)), graph.sightings.second)).size:
        raise pgm.EvidenceError(
            f"the landmark {graph.landmark_names[lost[0]]} is seen from no pose; leave it out"
        )


def _branches(graph: PoseGraph, held: tuple[int, ...]) -> tuple[Branch, ...]:
    return *_tree(graph, held), *_placed(graph)


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
    tree = nx.minimum_spanning_tree(joined)
    found = []
    for parent, child in nx.bfs_edges(tree, root):
        if parent != root:
            row = tree.edges[parent, child]["edge"]
            onward = ends[row] == (parent, child)
            found.append(Branch(parent, child, edges, row, False, onward))
    return found


def _placed(graph: PoseGraph) -> list[Branch]:
    """The first sighting of each landmark."""
    seen, rows = np.unique(graph.sightings.second, return_index=True)
    return [
        Branch(
            int(graph.sightings.first[row]),
            int(landmark),
            graph.sightings,
            int(row),
            True,
            True,
        )
        for landmark, row in zip(seen.tolist(), rows.tolist(), strict=True)
    ]


def _wrapped(angle: npt.ArrayLike) -> Array:
    return np.asarray(np.remainder(np.asarray(angle) + np.pi, 2.0 * np.pi) - np.pi)
