"""The pose graph: how well poses fit its edges, and the poses that fit them best."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import sparse
from scipy.sparse import linalg

from experiments.killian.log import Log
from models import motion
from pgm.recordings import Edges

Array = npt.NDArray[np.float64]

ITERATIONS = 20
SMALL = 1e-9  # m, rad


@dataclass(frozen=True, eq=False)
class Fit:
    r"""Poses of a recording, and those of least squares from there.

    The error is :math:`\sum_e r_e^T Ω_e r_e`, r what the second pose, seen from the first, has more
    than the edge says, and Ω the edge's information.

    Attributes
    ----------
    poses : ndarray
        (N, 3): the optimum, the first pose being held.
    before, after : float
        The error of the recording's poses, and of the optimum.
    moved : ndarray
        (3,): how far the optimum is from the recording's poses at the most [m, m, rad].
    """

    poses: Array
    before: float
    after: float
    moved: Array


def fitted(log: Log) -> Fit:
    """Least squares by Gauss–Newton from the recording's poses.

    Parameters
    ----------
    log : Log

    References
    ----------
    G. Grisetti, R. Kümmerle, C. Stachniss, W. Burgard: A tutorial on graph-based SLAM, 2010.
    """
    edges, poses = log.edges, log.poses.copy()
    lower = np.asarray(np.linalg.cholesky(edges.information), dtype=np.float64)
    factors = lower.swapaxes(-1, -2)
    for _ in range(ITERATIONS):
        weighted = np.einsum("eij,ej->ei", factors, residuals(poses, edges))
        slopes = _slopes(poses, edges, factors)
        step = linalg.spsolve((slopes.T @ slopes).tocsc(), -(slopes.T @ weighted.ravel()))
        poses[1:] += step.reshape(-1, 3)
        if np.abs(step).max() < SMALL:
            break
    moved = np.abs(differing(poses, log.poses)).max(axis=0)
    return Fit(poses, error(log.poses, edges), error(poses, edges), moved)


def error(poses: Array, edges: Edges) -> float:
    """The weighted square sum of all residuals."""
    away = residuals(poses, edges)
    return float(np.einsum("ei,eij,ej->", away, edges.information, away, optimize=True))


def residuals(poses: Array, edges: Edges) -> Array:
    """Each edge's motion between the poses less the one it tells, (E, 3) [m, m, rad]."""
    between = motion.relative(poses[edges.first], poses[edges.second])
    return differing(between, edges.motions)


def differing(poses: Array, others: Array) -> Array:
    """Poses less others, (..., 3), headings within half a turn."""
    away = poses - others
    away[..., 2] = (away[..., 2] + np.pi) % (2.0 * np.pi) - np.pi
    return away


def reckoned(start: Array, motions: Array) -> Array:
    """The path (T+1, 3) that motions (T, 3) make from a pose."""
    poses = np.empty((len(motions) + 1, 3))
    poses[0] = start
    for t, each in enumerate(motions):
        poses[t + 1] = motion.increment(poses[t], each)
    return poses


def _slopes(poses: Array, edges: Edges, factors: Array) -> sparse.csc_array:
    """The weighted residuals' derivatives by all poses but the first, (3E, 3(N − 1))."""
    one, other = poses[edges.first], poses[edges.second]
    ahead, left, _ = motion.relative(one, other).T
    by_other = np.zeros((len(one), 3, 3))
    by_other[:, 0, 0] = by_other[:, 1, 1] = np.cos(one[:, 2])
    by_other[:, 0, 1] = np.sin(one[:, 2])
    by_other[:, 1, 0] = -by_other[:, 0, 1]
    by_other[:, 2, 2] = 1.0
    by_one = -by_other
    by_one[:, 0, 2], by_one[:, 1, 2] = left, -ahead
    values = np.concatenate([factors @ by_one, factors @ by_other])
    row = 3 * np.arange(len(one))[:, None, None] + np.arange(3)[:, None]
    rows = np.broadcast_to(np.concatenate([row, row]), values.shape)
    column = 3 * np.concatenate([edges.first, edges.second])[:, None, None] + np.arange(3)
    columns = np.broadcast_to(column, values.shape)
    shape = (3 * len(one), 3 * len(poses))
    found = sparse.coo_array((values.ravel(), (rows.ravel(), columns.ravel())), shape=shape)
    return found.tocsc()[:, 3:]
