"""A correlated normal prior on a lattice, by its density at the centres, where it is wide.

A kernel along each axis by itself would have no correlations. The values at the centres of a normal
density that is wide for the cells have its correlations, and its sum and moments up to rounding.
"""

import itertools

import numpy as np

from pgm.beliefs.grid.densities import EVEN, Dense
from pgm.beliefs.grid.groups import Group
from pgm.beliefs.grid.lattice import Window
from pgm.beliefs.grid.values import (
    covariance_of,
    mean_at,
)
from pgm.cpds import GaussianCPD
from pgm.kernels.angles import TURN
from pgm.kernels.arrays import LOG_2PI
from pgm.kernels.lattice import Span
from pgm.kernels.step import turns

# From this standard deviation s on, in cells, of each component given the others, the density at
# centres is a normal on the lattice: its sum and moments are right to e^(−2π²s²).
_WIDE = 1.3


def wide(group: Group, run: int, window: Window) -> Dense | None:
    """The operator that puts a prior on the lattice by its normal density; None if it is not wide.

    `group` has the states of the prior. The operator's weights are the probabilities (1, 1, cells
    of the group's axes); `window`, from which it leads, has one cell along these axes. A prior is
    wide if it is a single `GaussianCPD` of a finite, regular and correlated covariance, each of
    whose components has a standard deviation, given the other components, of 1.3 cells or more.
    """
    cpd, lattice = group.states[0], group.lattice
    if len(group.states) > 1 or not isinstance(cpd, GaussianCPD):
        return None
    cov = covariance_of(cpd, {}, 0, run)
    if not np.isfinite(cov).all() or np.array_equal(cov, np.diag(np.diagonal(cov))):
        return None
    widths = group.widths
    scaled = cov / np.multiply.outer(widths, widths)
    values = np.linalg.eigvalsh(scaled)
    if not values[0] > 1e-12 * values[-1]:
        return None
    precision = np.linalg.inv(scaled)
    if not (np.diagonal(precision) <= _WIDE**-2).all():
        return None
    mean = mean_at(cpd, {}, {}, 0, run)[0]
    total = np.zeros((1,) * len(lattice.axes))
    # A wide angle goes round the circle.
    shifts = []
    for k, axis in enumerate(group.axes):
        far = int(np.ceil(9.0 * np.sqrt(cov[k, k]) / TURN)) if lattice.axes[axis].angle else 0
        shifts.append(range(-far, far + 1))
    centre = list(mean)
    for k, axis in enumerate(group.axes):
        if lattice.axes[axis].angle:
            centre[k] = mean[k] - turns(mean[k])
    for shift in itertools.product(*shifts):
        exponent = np.zeros((1,) * len(lattice.axes))
        offsets = []
        for k, axis in enumerate(group.axes):
            own = lattice.axes[axis]
            offset = own.offsets + (own.reference - centre[k]) + TURN * shift[k]
            shape = [1] * len(lattice.axes)
            shape[axis] = own.cells
            offsets.append((offset / own.width).reshape(shape))
        for i, j in itertools.product(range(len(offsets)), repeat=2):
            exponent = exponent - 0.5 * precision[i, j] * offsets[i] * offsets[j]
        total = total + np.exp(exponent)
    log_scale = -0.5 * (np.linalg.slogdet(scaled)[1] + len(mean) * LOG_2PI)
    target, order = list(window), [k for k in range(len(window)) if k not in group.axes]
    for axis in group.axes:
        target[axis] = Span(0, lattice.axes[axis].cells)
    weights = (total * np.exp(log_scale)).transpose(*group.axes, *order).reshape(1, 1, -1)
    return Dense(group.axes, (), weights, window, tuple(target), EVEN)
