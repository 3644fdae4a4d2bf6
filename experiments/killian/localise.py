"""Poses found in the map: from a known one, from anywhere, and on a grid."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

import pgm
from experiments.killian.drive import Drive
from experiments.killian.graph import differing
from models.networks import pose

Array = npt.NDArray[np.float64]
Found = TypeVar("Found")

# Cells of a first scan's likelihood, over the whole map: half a metre, and headings a turn.
SPACING, HEADINGS, TEMPER = 0.5, 72, 0.5
# Particles after the first scan: bins of the place and the heading, and how many at the least and
# at the most, as a part of those at the start.
WIDTHS = {"east": 0.25, "north": 0.25, "heading": 0.05}
LEAST, MOST = 0.02, 0.5
# Steps after a start from anywhere, and of a grid; from which distance on a pose is lost [m].
LASTING, LOST = 40, 1.0
SHOWN = (0, 1, 2, 5)
# Headings of the grid a turn, how far beyond the poses its part of the map reaches, and the grid
# beyond that [m].
TURNS, AROUND, BEYOND = 90, 4.0, 1.5


@dataclass(frozen=True, eq=False)
class Followed:
    """A belief by steps, against the recording's poses.

    Attributes
    ----------
    error : ndarray
        (T+1, 3): mean less pose [m, m, rad].
    belief : Gaussian
        Of the same mean and covariance.
    log_evidence : float
    seconds : float
    """

    error: Array
    belief: pgm.Gaussian
    log_evidence: float
    seconds: float

    @property
    def distance(self) -> Array:
        """How far means are from poses, (T+1,) [m]."""
        found: Array = np.linalg.norm(self.error[:, :2], axis=-1)
        return found

    @property
    def numbers(self) -> dict[str, float]:
        """For a summary."""
        return {
            **errors(self.error),
            "own": float(np.sqrt((self.belief.std[:, :2] ** 2).sum(axis=-1).mean())),
            "nees": float(pgm.consistency.nees(self.belief, self.belief.mean - self.error).mean()),
            "seconds": self.seconds,
        }


def errors(error: Array) -> dict[str, float]:
    """RMS, median and largest distance [m], and RMS of the heading [rad]."""
    distance = np.linalg.norm(error[:, :2], axis=-1)
    return {
        "rmse": float(np.sqrt((distance**2).mean())),
        "median": float(np.median(distance)),
        "largest": float(distance.max()),
        "heading": float(np.sqrt((error[:, 2] ** 2).mean())),
    }


@dataclass(frozen=True, eq=False)
class Tracked:
    """All of the drive, from a known pose.

    Attributes
    ----------
    followed : Followed
    effective : float
        How many particles the weights were worth at the least.
    """

    followed: Followed
    effective: float


def tracked(drive: Drive, count: int, seed: int) -> Tracked:
    """Particles from a known start to the end."""
    posterior, seconds = _timed(
        lambda: pgm.filter(
            drive.network(), drive.evidence(), belief=pgm.Particles(count, seed=seed)
        )
    )
    found = _followed(drive, posterior, 0, seconds)
    return Tracked(found, float(posterior.status.effective.min()))


@dataclass(frozen=True, eq=False)
class Stray:
    """A start from anywhere in the map.

    Attributes
    ----------
    first : int
        The step of the drive that is its step 0.
    followed : Followed
    clouds : dict of int to ParticleBelief
        By step.
    """

    first: int
    followed: Followed
    clouds: dict[int, pgm.results.ParticleBelief]

    @property
    def found_at(self) -> int | None:
        """The step from which on the pose is not lost; None where there is none."""
        lost = np.flatnonzero(self.followed.distance > LOST)
        after = int(lost[-1]) + 1 if lost.size else 0
        return after if after < len(self.followed.distance) else None


def strays(drive: Drive, starts: int, count: int, seed: int) -> list[Stray]:
    """Particles that are told nothing but the map, at steps that are evenly apart."""
    cells = drive.map.poses(SPACING, HEADINGS, drive.within)
    widths = (SPACING, SPACING, 2.0 * np.pi / HEADINGS)
    start = pgm.CellProposal(pose, cells, widths, temper=TEMPER)
    number = pgm.KLDSampling(WIDTHS, least=int(LEAST * count), most=int(MOST * count))
    network = drive.network(drive.map.uniform(pose, drive.within))
    steps = len(drive.motions)
    lasting = min(LASTING, steps)
    found = []
    for k, first in enumerate(np.linspace(0, steps - lasting, starts).astype(int).tolist()):
        particles = pgm.Particles(count, seed=seed + k, start=start, number=number)
        evidence = drive.evidence(first, first + lasting)
        posterior, seconds = _timed(_filtering(network, evidence, particles))
        clouds = {step: posterior[pose.at(step)] for step in SHOWN}
        found.append(Stray(first, _followed(drive, posterior, first, seconds), clouds))
    return found


@dataclass(frozen=True, eq=False)
class Gridded:
    """A part of the drive, from anywhere in a part of the map, on a grid and with particles.

    Attributes
    ----------
    first : int
        The step of the drive that is its step 0.
    grid : Posterior
    followed : dict of str to Followed
        Of grid and particles.
    """

    first: int
    grid: pgm.results.Posterior
    followed: dict[str, Followed]

    @property
    def cells(self) -> int:
        """The number of the grid's cells."""
        return int(np.prod([each.size for each in self.grid[pose.at(0)].centres]))

    @property
    def added(self) -> float:
        """The deviation that the lattice has added to a place over all steps [m]."""
        status = self.grid.status.added
        return float(np.sqrt(max(float(status[name].max()) for name in ("east", "north"))))


def gridded(drive: Drive, first: int, cell: float, count: int, seed: int) -> Gridded:
    """A grid over the part of the map around some steps; scans and prior are the strays'."""
    last = min(first + LASTING, len(drive.motions))
    if last - first < 1:
        raise pgm.EvidenceError(
            f"the part of the drive begins at step {first}, and the drive has {last} steps"
        )
    places = drive.poses[first : last + 1, :2]
    low = np.floor(places.min(axis=0) - AROUND)
    high = np.ceil(places.max(axis=0) + AROUND)
    rows, columns = np.indices(drive.map.shape)
    centres = drive.map.centres(rows, columns)
    part = drive.within & ((centres > low) & (centres < high)).all(axis=-1)
    network = drive.network(drive.map.uniform(pose, part))
    low, high = low - BEYOND, high + BEYOND
    across, up = np.ceil((high - low) / cell).astype(int).tolist()
    grid = pgm.Grid(
        {
            "east": (low[0], low[0] + cell * across, across),
            "north": (low[1], low[1] + cell * up, up),
            "heading": TURNS,
        },
        dtype=np.float32,
    )
    evidence = drive.evidence(first, last)
    cells = drive.map.poses(SPACING, HEADINGS, part)
    start = pgm.CellProposal(pose, cells, (SPACING, SPACING, 2.0 * np.pi / HEADINGS), temper=TEMPER)
    particles = pgm.Particles(count, seed=seed, start=start)
    posterior, seconds = _timed(_filtering(network, evidence, grid))
    cloud, spent = _timed(_filtering(network, evidence, particles))
    return Gridded(
        first,
        posterior,
        {
            "grid": _followed(drive, posterior, first, seconds),
            "particles": _followed(drive, cloud, first, spent),
        },
    )


def _filtering(
    network: pgm.DynamicBayesianNetwork, evidence: Any, belief: Any
) -> Callable[[], Any]:
    return lambda: pgm.filter(network, evidence, belief=belief)


def _timed(call: Callable[[], Found]) -> tuple[Found, float]:
    """An answer and its seconds; the page tells what the warnings do."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", pgm.ParticleWarning)
        warnings.simplefilter("ignore", pgm.GridWarning)
        began = time.perf_counter()
        found = call()
        return found, time.perf_counter() - began


def _followed(drive: Drive, posterior: Any, first: int, seconds: float) -> Followed:
    belief = posterior[pose].gaussian()
    poses = drive.poses[first : first + len(belief.mean)]
    error = differing(belief.mean, poses)
    return Followed(error, belief, float(posterior.log_evidence), seconds)
