"""The prior on a lattice: point masses with its mean and covariance, or its density at centres."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np

from pgm.cpds import GaussianCPD
from pgm.inference.grid.groups import Group
from pgm.inference.grid.lattice import Lattice
from pgm.inference.grid.motion import Motion
from pgm.inference.grid.values import covariance_of, mean_at
from pgm.kernels.angles import TURN
from pgm.kernels.arrays import LOG_2PI, Array
from pgm.kernels.lattice import Span

# From this many cells on, of the deviation of each component given the others, the density at
# centres is a normal on the lattice: its sum and moments are right to e^(−2π²s²).
_WIDE = 1.3


def start(lattice: Lattice, groups: Sequence[Group], run: int) -> tuple[Array, Array]:
    """The probabilities at step 0; what the bounds leave out is missing from their sum.

    With them the variance that the lattice has added along each axis, in cells.
    """
    dense = [group for group in groups if _density(lattice, group, run) is not None]
    window = [Span(0, 1)] * len(lattice.axes)
    found = np.ones((1,) * len(lattice.axes))
    for group in dense:
        part = _density(lattice, group, run)
        assert part is not None
        found = found * part
        for k in group.axes:
            window[k] = Span(0, lattice.axes[k].cells)
    rest = [group for group in groups if group not in dense]
    made = Motion(lattice, rest).at(0, run, tuple(window)) if rest else None
    if made is None:
        whole = lattice.put(np.broadcast_to(found, lattice.shape), lattice.whole)
        return whole, np.zeros(len(lattice.axes))
    part, added = made.forward(found)
    return lattice.put(part, made.target), added


def _density(lattice: Lattice, group: Group, run: int) -> Array | None:
    """The correlated density of a state without parents, where it is wide; None of others."""
    cpd = group.states[0]
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
    turns = []
    for k, axis in enumerate(group.axes):
        far = int(np.ceil(9.0 * np.sqrt(cov[k, k]) / TURN)) if lattice.axes[axis].angle else 0
        turns.append(range(-far, far + 1))
    centre = list(mean)
    for k, axis in enumerate(group.axes):
        if lattice.axes[axis].angle:
            centre[k] = mean[k] - TURN * np.rint(mean[k] / TURN)
    for shift in itertools.product(*turns):
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
    scaled_total: Array = total * np.exp(log_scale)
    return scaled_total
