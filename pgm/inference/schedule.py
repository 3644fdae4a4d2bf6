"""Schedules: which messages are sent in which order, and how often CPDs are linearised."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from numbers import Real
from types import MappingProxyType
from typing import TypeGuard

import numpy as np

from pgm.errors import ModelError
from pgm.immutable import Immutable
from pgm.kernels.arrays import Array, Mask


def _require_count(schedule: object, name: str, value: object) -> None:
    whole = isinstance(value, int | np.integer) and not isinstance(value, bool)
    if not whole or value < 1:  # type: ignore[operator]
        raise ModelError(f"{schedule!r}: {name} must be a whole number, 1 or more, not {value!r}")


def _require_tolerance(schedule: object, tolerance: object) -> None:
    if not _is_number(tolerance) or not tolerance >= 0.0:
        raise ModelError(f"{schedule!r}: a tolerance must be 0 or more, not {tolerance!r}")


def _is_number(value: object) -> TypeGuard[float]:
    return isinstance(value, Real) and not isinstance(value, bool)


@dataclass(frozen=True)
class Filtering:
    """Forward messages alone: each belief knows the readings up to its step.

    Each CPD is linearised once: a transition at the incoming message, a sensor at the predicted
    belief. With `Taylor` it is the extended Kalman filter, with `Unscented` the unscented one.
    """


@dataclass(frozen=True)
class Calibration:
    """Both passes over a tree: towards the root and back, so that each belief knows all evidence.

    Without nonlinear CPDs one iteration is exact. The first linearisation of nonlinear ones is at
    their parents' prior predictive moments, or at a given start; each further one is of every CPD
    at the belief of its cluster, after which all messages are sent again: no evidence is counted
    twice. With `Taylor` that is Gauss–Newton.

    Parameters
    ----------
    iterations : int
        Linearisations at the most.
    tolerance : float
        A run stops when no mean moves by more than this many standard deviations.
    """

    iterations: int = 1
    tolerance: float = 1e-9

    def __post_init__(self) -> None:
        _require_count(self, "iterations, which count linearisations,", self.iterations)
        _require_tolerance(self, self.tolerance)


@dataclass(frozen=True)
class Smoothing(Calibration):
    """Forward and backward messages: the calibration of a chain, whose beliefs know all readings.

    The first linearisation is that of the filter, so that one iteration is the (extended,
    unscented) RTS smoother; the later ones are of every CPD at the smoothed belief over its hidden
    parents, all steps in one call.

    Parameters
    ----------
    iterations : int
        Linearisations at the most.
    tolerance : float
        A run stops when no smoothed mean moves by more than this many standard deviations.
    """


@dataclass(frozen=True)
class Loopy:
    """What schedules for any graph, trees or not, have in common.

    Messages are sent until none changes: the beliefs of neighbours then agree. On a tree they are
    exact. On a graph with loops they need not converge; where they do, Gaussian means are exact,
    variances and log-evidence approximate, and so are all beliefs of discrete variables.

    Parameters
    ----------
    tolerance : float
        A run has converged when no message changes by more than this: in standard deviations of
        the belief it makes, or in probability.
    damping : float
        The share of the old message that is kept, in [0, 1): a new one is the geometric mean.
    max_iterations : int
        Iterations at the most; one sends as many messages as the graph has.
    """

    tolerance: float = 1e-10
    damping: float = 0.0
    max_iterations: int = 1000

    def __post_init__(self) -> None:
        _require_count(self, "max_iterations", self.max_iterations)
        _require_tolerance(self, self.tolerance)
        if not _is_number(self.damping) or not 0.0 <= self.damping < 1.0:
            raise ModelError(
                f"{self!r}: damping is the share of the old message, in [0, 1), not "
                f"{self.damping!r}"
            )


@dataclass(frozen=True)
class Flooding(Loopy):
    """All messages at once, each from the messages of the iteration before."""


@dataclass(frozen=True)
class Sequential(Loopy):
    """Cluster after cluster, forth and back, each message from the latest ones."""


@dataclass(frozen=True)
class Residual(Loopy):
    """Always the message that would change most.

    Each message sent makes all messages it has a part in be computed anew. So an iteration takes
    about n² of them around a hub of n neighbours, where `Flooding` and `Sequential` take n.

    References
    ----------
    Elidan, McGraw & Koller, Residual belief propagation, 2006.
    """


Schedule = Filtering | Calibration | Loopy


class Status(Immutable):
    """How a schedule went.

    Attributes
    ----------
    iterations : int
        Linearisations made of a tree. After a schedule for any graph, its iterations: fewer than
        the maximum also where messages diverged, which `converged` tells (False).
    residuals : ndarray
        The convergence record. Of a tree, (iterations − 1, *runs): the largest move of a mean at
        each relinearisation, in standard deviations. Of other graphs, (iterations, *runs): the
        largest change of a message in each iteration, or the largest move of a mean, if larger,
        where CPDs were linearised anew.
    converged : ndarray of bool
        (*runs): whether the last residual was within the tolerance, or nothing was to iterate.
    by_edge : mapping of (int, int) to ndarray
        After a schedule for any graph, (*runs): how much the messages between each two joined
        clusters would still change, for ``pgm.plot.cluster_graph(graph, residuals=...)``; empty
        after others.
    """

    iterations: int
    residuals: Array
    converged: Mask
    by_edge: Mapping[tuple[int, int], Array]

    def __init__(
        self,
        iterations: int,
        residuals: Array,
        converged: Mask,
        by_edge: Mapping[tuple[int, int], Array] = MappingProxyType({}),
    ) -> None:
        residuals.flags.writeable = False
        converged.flags.writeable = False
        self._set(
            iterations=iterations,
            residuals=residuals,
            converged=converged,
            by_edge=MappingProxyType(dict(by_edge)),
        )

    def __repr__(self) -> str:
        last = f", last residual {self.residuals[-1].max():.3g}" if len(self.residuals) else ""
        share = f"{int(self.converged.sum())} of {self.converged.size} runs converged"
        return f"Status({self.iterations} iterations, {share}{last})"
