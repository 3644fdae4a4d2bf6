"""The M step of a table: expected counts, normalised."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pgm.boundary import as_floats
from pgm.cpds import TableCPD
from pgm.errors import ModelError
from pgm.kernels.arrays import Array
from pgm.learning.declared import Table

_TINY = 1e-300


class TableStep:
    """The M step of one table, exact: Baum & Welch's, for any family of the slice.

    Zeros stay zeros. Rows of parents' states that never occur stay as they are.

    Parameters
    ----------
    cpd : TableCPD
        As it is at the start.
    parts : sequence of Table
    """

    def __init__(self, cpd: TableCPD, parts: Sequence[Table]) -> None:
        if cpd.function is not None or cpd._maps:
            raise ModelError(
                f"{cpd!r}: its table is structured, or a function of inputs; one that is an array "
                "can be learnt",
                cpd=cpd,
            )
        counts = as_floats(parts[0].prior_counts, f"{cpd!r}: prior_counts", cpd=cpd)
        if counts.shape not in ((), cpd.table.shape):
            raise ModelError(
                f"{cpd!r}: prior_counts has shape {counts.shape}; () or {cpd.table.shape} was due",
                cpd=cpd,
            )
        self.start, self.free = cpd, cpd.table > 0.0
        self.prior = np.where(self.free, counts, 0.0)

    def log_prior(self, cpd: TableCPD) -> float:
        """The logarithm of the Dirichlet prior, but for a constant."""
        logs = np.log(np.maximum(cpd.table, _TINY))
        return float(np.sum(self.prior * np.where(self.free, logs, 0.0)))

    def maximised(self, cpd: TableCPD, counts: Array) -> TableCPD:
        """The table of expected counts, (parents..., child)."""
        counts = np.where(self.free, counts + self.prior, 0.0)
        total = counts.sum(axis=-1, keepdims=True)
        table = np.where(total > 0.0, counts / np.where(total > 0.0, total, 1.0), cpd.table)
        return TableCPD(cpd.child, cpd.given, table=table)

    def vector(self, cpd: TableCPD) -> Array:
        """The coordinates of a table: roots of what is not zero at the start."""
        return np.sqrt(cpd.table)[self.free]

    def gradient(self, cpd: TableCPD, counts: Array) -> Array:
        """The derivatives of the expected log-density by the roots s, of p = s² / Σ s²."""
        counts = np.where(self.free, counts + self.prior, 0.0)
        roots = np.sqrt(cpd.table)
        told = counts / np.where(roots > 0.0, roots, 1.0)
        found: Array = 2.0 * (told - roots * counts.sum(axis=-1, keepdims=True))
        return found[self.free]

    def at(self, vector: Array) -> TableCPD:
        """The table of some coordinates."""
        weights = np.zeros(self.free.shape)
        weights[self.free] = vector**2
        total = weights.sum(axis=-1, keepdims=True)
        table = np.where(total > 0.0, weights / np.where(total > 0.0, total, 1.0), self.start.table)
        return TableCPD(self.start.child, self.start.given, table=table)
