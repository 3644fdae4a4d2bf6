"""Affine Gaussian CPDs whose numbers differ from run to run."""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from types import MappingProxyType

import numpy as np

from pgm.cpds.base import CPD
from pgm.cpds.conditional import ConditionalGaussian, Noise
from pgm.cpds.gaussian import AffineCPD, GaussianCPD, NonlinearGaussianCPD
from pgm.cpds.mixture import by_run
from pgm.factors.arrays import Shape
from pgm.factors.scope import Scope
from pgm.kernels.arrays import Array, Integers, apply
from pgm.variables import Variable


class ByRunCPD(AffineCPD):
    """An affine CPD y = Σ F_p p + b + n, n ~ N(0, Q), with an F, b and Q for each run.

    It stands for a CPD that discrete variables choose, where each run has states of these.

    Attributes
    ----------
    matrices : mapping of Variable to ndarray
        By parent F_p, (runs, d, n); or (d, n), all of them, where runs have F in common.
    offset : ndarray
        b, (runs, d).
    cov : ndarray
        Q, (runs, d, d); or (d, d) where runs have it, and all F, in common.
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

    def _affine(
        self,
        hidden: Scope,
        inputs: Mapping[Variable, Array],
        step: int | Integers | None = None,
    ) -> tuple[Array, Array]:
        """F over the stacked hidden parents, (d, n) or (1, runs, d, n), and b (rows, runs, d)."""
        shape = next(iter(self.matrices.values())).shape
        none = np.zeros((*shape[:-1], 0))
        matrix = np.concatenate([none, *(self.matrices[p] for p in hidden)], axis=-1)
        offset = self.offset[None]
        for parent in self.given:
            if parent not in hidden:
                offset = offset + apply(self.matrices[parent], inputs[parent])
        return matrix if matrix.ndim == 2 else matrix[None], offset


def kind_of(case: CPD) -> Hashable:
    """A key that cases have in common which differ in numbers alone; of one function, in noise."""
    if not isinstance(case, ConditionalGaussian) or isinstance(case.cov, Noise) or case.noise:
        return id(case)
    if case.steps is not None:  # numbers by step, beside which there are none by run
        return id(case)
    if isinstance(case, AffineCPD):
        return AffineCPD
    if not isinstance(case, NonlinearGaussianCPD):
        return id(case)
    derivatives = tuple((parent, id(function)) for parent, function in case.jacobian.items())
    return id(case.function), case.given, derivatives, id(case.lineariser), case.grouped


def stacked(cases: Sequence[CPD], number: Integers) -> CPD:
    """The CPD of a child that is one of some cases of one kind, by number, in each run."""
    affine = [case for case in cases if isinstance(case, AffineCPD)]
    if affine:
        return _affine(affine, number)
    first = cases[0]
    assert isinstance(first, NonlinearGaussianCPD)
    covs = [case.cov for case in cases if isinstance(case, NonlinearGaussianCPD)]
    return first._with_covs(_by_run([np.asarray(cov) for cov in covs], number))


def _affine(cases: Sequence[AffineCPD], number: Integers) -> AffineCPD:
    """The affine CPD of a child that is one of some cases, by number, in each run."""
    child = cases[0].child
    given = tuple(dict.fromkeys(v for case in cases for v in case.given))
    offset = np.array([case.offset for case in cases])[number]
    cov = _by_run([np.asarray(case.cov) for case in cases], number)
    if not given:
        return GaussianCPD(child, offset, cov)
    matrices: dict[Variable, Array] = {}
    for parent in given:
        none = np.zeros((child.dimension, parent.dimension))
        matrices[parent] = _by_run([case.matrices.get(parent, none) for case in cases], number)
    if any(matrix.ndim == 3 for matrix in matrices.values()):
        for parent, matrix in matrices.items():
            matrices[parent] = np.broadcast_to(matrix, (len(offset), *matrix.shape[-2:]))
        # By the noise it is told whether runs share their matrices.
        cov = np.broadcast_to(cov, (len(offset), *cov.shape[-2:]))
    return ByRunCPD(child, given, matrices, offset, cov)


def _by_run(arrays: Sequence[Array], number: Integers) -> Array:
    """The array that each run has by number; one for all, where none differs."""
    every = np.array(arrays)
    first: Array = every[0]
    return first if (every == first).all() else every[number]


def repeated(cpd: CPD, count: int, lead: tuple[int, ...], runs: Integers) -> CPD:
    """A prior with axes of runs, repeated for each of some configurations."""
    own = by_run(cpd, lead)
    assert isinstance(own, GaussianCPD)
    assert isinstance(own.cov, np.ndarray)
    size = own.child.dimension
    mean = np.tile(own.mean.reshape(-1, size)[runs], (count, 1))
    cov = np.tile(own.cov.reshape(-1, size, size)[runs], (count, 1, 1))
    return GaussianCPD(own.child, mean, cov)
