"""Pose graphs: poses, landmarks, and the motions that were measured between them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from pgm.display import NoArray, Shown, Summary, count
from pgm.errors import EvidenceError
from pgm.io.dropped import Dropped
from pgm.kernels import twists
from pgm.kernels.arrays import Array, Integers, frozen, transpose
from pgm.recordings.drives.motion import PLANAR
from pgm.recordings.drives.recording import Recording
from pgm.recordings.drives.scans import Scans
from pgm.recordings.drives.stream import Stream


@dataclass(frozen=True, eq=False, repr=False)
class Edges(Shown):
    """Relative poses measured between pairs of vertices.

    Attributes
    ----------
    first, second : ndarray of int
        (E,): rows of the vertices.
    motions : ndarray
        (E, 3), the second seen from the first: forward [m], left [m], turn [rad]; (E, 2) of
        landmarks.
    information : ndarray
        (E, 3, 3) or (E, 2, 2): inverse covariances.

    Examples
    --------
    >>> from pgm.recordings import Edges
    >>> Edges(np.array([0]), np.array([1]), np.zeros((1, 3)), np.eye(3)[None]).covariances.shape
    (1, 3, 3)
    """

    first: Integers
    second: Integers
    motions: Array
    information: Array

    def __len__(self) -> int:
        return self.first.size

    @property
    def _title(self) -> str:
        return f"Edges({count(len(self), 'edge')} of {self.motions.shape[1]} numbers each)"

    @property
    def covariances(self) -> Array:
        """Inverses of the information, (E, d, d)."""
        try:
            found = np.asarray(np.linalg.inv(self.information), dtype=np.float64)
        except np.linalg.LinAlgError:
            edge = int(np.linalg.matrix_rank(self.information).argmin())
            raise EvidenceError(
                f"the information of edge {edge} is singular, so that it has no covariance: "
                f"{self.information[edge].tolist()}"
            ) from None
        return 0.5 * (found + transpose(found))


@dataclass(frozen=True, eq=False, repr=False)
class PoseGraph(Shown, NoArray):
    r"""A pose graph as a file tells it; it has no stamps.

    Attributes
    ----------
    names, landmark_names : ndarray of int
        (N,), (L,): their numbers in the file, increasing.
    poses, landmarks : ndarray
        First guesses: (N, 3), east [m], north [m], heading [rad]; (L, 2).
    edges, sightings : Edges
        Between poses; from poses to landmarks.
    fixed : ndarray of int
        Rows of the poses that are held.
    scans : Scans or None
        The scan of each pose, numbered as stamps.
    dropped : tuple of Dropped

    Examples
    --------
    >>> import io
    >>> text = "VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1 0 0\nEDGE_SE2 0 1 1 0 0 9 0 0 9 0 9\n"
    >>> graph = pgm.recordings.read_pose_graph(io.StringIO(text))
    >>> graph
    PoseGraph(2 poses, 1 edge, 0 loop closures)
    >>> graph.recording().odometry
    Stream(1 row of forward, left, turn, 1 s to 1 s)
      stamp  forward, left, turn
          1                    1  0  0
    """

    names: Integers
    poses: Array
    edges: Edges
    landmark_names: Integers
    landmarks: Array
    sightings: Edges
    fixed: Integers
    scans: Scans | None = None
    dropped: tuple[Dropped, ...] = ()

    _arrays: ClassVar[str] = ".poses and .edges"

    def __post_init__(self) -> None:
        for name in ("poses", "landmarks"):
            object.__setattr__(self, name, frozen(getattr(self, name)))

    @property
    def loops(self) -> Integers:
        """The edges between no neighbours: loop closures."""
        return np.flatnonzero(np.abs(self.edges.second - self.edges.first) != 1)

    def recording(self) -> Recording:
        """The chain of edges from each pose to the next, as a drive of a step a second.

        An edge that is told from the later pose is turned round. Loop closures stay here, `loops`.
        The first of several edges between two poses counts.
        Sightings of landmarks are the sensor ``landmark``, (forward, left), at the steps.
        """
        edges, steps = self.edges, len(self.poses) - 1
        chain = np.setdiff1d(np.arange(len(edges)), self.loops)
        ends = edges.first[chain], edges.second[chain]
        begun, row = np.unique(np.minimum(*ends), return_index=True)
        if begun.tolist() != list(range(steps)):
            lost = np.setdiff1d(np.arange(steps), begun)
            raise EvidenceError(
                f"{self._title}: {lost.size} poses have no edge to the next, the first of them "
                f"{self.names[lost[0]]}; it is no one drive"
            )
        chosen, told = chain[row], list(self.dropped)
        if again := len(chain) - len(chosen):
            rest = np.setdiff1d(chain, chosen)
            told.append(Dropped("odometry", "a second edge to the next pose", rest))
            assert rest.size == again
        motions, cov = edges.motions[chosen], edges.covariances[chosen]
        back = edges.second[chosen] < edges.first[chosen]
        motions[back], slope = twists.inverse(motions[back])
        cov[back] = slope @ cov[back] @ slope.swapaxes(1, 2)
        seen = self.sightings
        stamps = np.arange(1.0, steps + 1)
        sensor = Stream(
            seen.first.astype(float),
            seen.motions,
            ("forward", "left"),
            subject=self.landmark_names[seen.second].tolist(),
            cov=seen.covariances if len(seen) else None,
        )
        return Recording(
            odometry=Stream(stamps, motions, PLANAR, cov=cov if steps else None, begin=0.0),
            sightings={"landmark": sensor} if len(seen) else None,
            scans=None if self.scans is None else {"laser": self.scans},
            dropped=told,
        )

    @property
    def _title(self) -> str:
        what = [count(len(self.poses), "pose"), count(len(self.edges), "edge")]
        what.append(count(self.loops.size, "loop closure"))
        if len(self.landmarks):
            what.append(count(len(self.landmarks), "landmark"))
            what.append(count(len(self.sightings), "sighting"))
        if self.scans is not None:
            what.append(count(len(self.scans), "scan"))
        return f"PoseGraph({', '.join(what)})"

    def _summary(self) -> Summary:
        return Summary(self._title, [each._title for each in self.dropped])
