"""How a schedule went."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np

from pgm.immutable import Immutable
from pgm.kernels.arrays import Array, Mask


class Status(Immutable):
    """How a schedule went.

    Attributes
    ----------
    iterations : int
        Linearisations made of a tree. After a schedule for any graph, its iterations: fewer than
        the maximum also where messages diverged, which `converged` tells (False).
    residuals : ndarray
        The convergence record. Of a tree, (iterations − 1, *runs): the largest move of a mean at
        each relinearisation, in standard deviations (on a balanced tree, with `Taylor`, given
        Jacobians and regular noise, those of a component given all others). Of other graphs,
        (iterations, *runs): the largest change of a message in each iteration, or the largest move
        of a mean, if larger, where CPDs were linearised anew.
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

    @classmethod
    def of(cls, residuals: list[Array], converged: Mask, lead: tuple[int, ...]) -> Status:
        """Of relinearisations, from (runs,) each, with the runs as the user's axes."""
        count = len(residuals)
        record = np.array(residuals, dtype=np.float64).reshape(count, *lead)
        return cls(count + 1, record, converged.reshape(lead))

    def __repr__(self) -> str:
        last = f", last residual {self.residuals[-1].max():.3g}" if len(self.residuals) else ""
        share = f"{int(self.converged.sum())} of {self.converged.size} runs converged"
        return f"Status({self.iterations} iterations, {share}{last})"
