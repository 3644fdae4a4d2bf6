"""Affine CPDs at all rows of a family, y = F x + b + noise: copies of one, or those of a plate.

x stacks the hidden parents; b has the terms of the observed ones. The rows of a plate
(`pgm.cpds.plates`) have numbers of their own, which are stacked, thousands in one call.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from pgm.cpds import AffineCPD, ConditionalGaussian
from pgm.factors.scope import Scope
from pgm.kernels.arrays import Array, Integers, apply
from pgm.linearisation.rows import own_noise
from pgm.linearisers.numbering import COUNTED
from pgm.variables import Variable


def affine_rows(
    cpd: AffineCPD,
    plate: Sequence[ConditionalGaussian],
    hidden: Scope,
    inputs: Mapping[Variable, Array],
    lead: tuple[int, ...],
    step: Integers,
) -> tuple[Array, Array]:
    """F (d, n), or (rows, d, n) of a plate, and b (rows or 1, runs or 1, d).

    F of numbers that change from step to step is (rows, 1, d, n).

    `cpd` is the CPD of all rows, or the first of the `plate`; `hidden` are those of its parents
    without evidence, and `inputs` the others' values (rows, runs or 1, d). `lead` are the axes of
    runs, and `step` (rows,) the steps.
    """
    if not plate:
        constant, shift = cpd._affine(hidden, inputs, step[:, None])
        if not cpd.given and shift.ndim > 1 and cpd.steps is None:
            shift = np.broadcast_to(shift, (*lead, shift.shape[-1])).reshape(1, -1, shift.shape[-1])
        return constant, shift if shift.ndim == 3 else shift[None, None]
    cpds = [each for each in plate if isinstance(each, AffineCPD)]
    offset = np.array([each.offset for each in cpds])
    if offset.ndim > 2:  # of priors with axes of runs, which all of a plate have alike
        offset = np.stack([np.broadcast_to(own, (*lead, own.shape[-1])) for own in offset])
    offset = offset.reshape(len(cpds), -1, offset.shape[-1])
    slopes = [np.zeros((len(cpds), offset.shape[-1], 0))]
    for k, parent in enumerate(cpd.given):
        slope = np.array([each.matrices[each.given[k]] for each in cpds])
        if parent in hidden:
            slopes.append(slope)
        else:
            offset = offset + apply(slope[:, None], inputs[parent])
    return np.concatenate(slopes, axis=2), offset


def plate_noise(plate: Sequence[ConditionalGaussian], lead: tuple[int, ...]) -> Array:
    """The noise covariances of the CPDs of a plate, (rows, runs or 1, d, d)."""
    covs = [cpd.cov for cpd in plate]
    if all(isinstance(cov, np.ndarray) and cov.ndim == 2 for cov in covs):
        return np.array(covs)[:, None]
    return np.concatenate([own_noise(each, None, 1, {}, lead, COUNTED) for each in plate])
