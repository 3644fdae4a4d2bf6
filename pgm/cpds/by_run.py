"""Affine Gaussian CPDs whose numbers differ from run to run."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np

from pgm.cpds.gaussian import AffineCPD
from pgm.factors.arrays import Shape
from pgm.factors.scope import Scope
from pgm.kernels.arrays import Array, apply
from pgm.variables import Variable


class ByRunCPD(AffineCPD):
    """An affine CPD y = Σ F_p p + b + n, n ~ N(0, Q), with an F, b and Q for each run.

    It stands for a CPD that discrete variables choose, where each run has states of these.

    Attributes
    ----------
    matrices : mapping of Variable to ndarray
        By parent F_p, (runs, d, n).
    offset : ndarray
        b, (runs, d).
    cov : ndarray
        Q, (runs, d, d).
    """

    def __init__(
        self,
        child: Variable,
        given: Scope,
        matrices: dict[Variable, Array],
        offset: Array,
        cov: Array,
    ) -> None:
        self._set_scope(child, given)
        self._set(matrices=MappingProxyType(matrices), offset=offset, cov=cov)

    def _lead(self) -> Shape:
        return self.offset.shape[:-1]

    def _affine(self, hidden: Scope, inputs: Mapping[Variable, Array]) -> tuple[Array, Array]:
        """F (1, runs, d, n) over the stacked hidden parents, and b (rows, runs, d)."""
        none = np.zeros((*self.offset.shape, 0))
        matrix = np.concatenate([none, *(self.matrices[p] for p in hidden)], axis=-1)
        offset = self.offset[None]
        for parent in self.given:
            if parent not in hidden:
                offset = offset + apply(self.matrices[parent], inputs[parent])
        return matrix[None], offset
