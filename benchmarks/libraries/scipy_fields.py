"""SciPy on a linear Gaussian network: a sparse factor of its precision, which gives means alone.

SuperLU is told that the matrix is symmetric and needs no pivots, and by which order to eliminate:
on grids that takes half to two thirds of what its defaults take.
"""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from benchmarks.timing import Contender
from benchmarks.work.asked import Array, Beliefs
from benchmarks.work.fields import NOISE, READ, READ_NOISE, Field

SYMMETRIC = {"SymmetricMode": True}


def means(work: Field) -> Contender:
    """Factor and solve, the matrix made beforehand."""
    precision, potential = _information(work)

    def call() -> list[Beliefs]:
        factor = splu(
            precision, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=SYMMETRIC
        )
        return [(factor.solve(potential)[:, None], None)]

    return Contender(call, work.units)


def _information(work: Field) -> tuple[sparse.csc_array, Array]:
    """The precision of all variables, and what readings add to it times the mean."""
    links = [(k, j) for k in range(work.units) for j in work.before(k)]
    child, parent = np.array(links, dtype=int).reshape(-1, 2).T
    size = work.units, work.units
    weights = np.full(len(links), work.weight)
    new = sparse.eye_array(work.units) - sparse.csr_array((weights, (child, parent)), size)
    read = np.zeros(work.units)
    read[::READ] = 1.0 / READ_NOISE
    potential = np.zeros(work.units)
    potential[::READ] = work.readings / READ_NOISE
    return sparse.csc_array(new.T @ new / NOISE + sparse.diags_array(read)), potential
