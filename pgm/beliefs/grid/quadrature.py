"""The nodes of a quadrature over the white noise that several displacements share.

A displacement is how far a state moves, in cells along each axis. White noise is independent
standard normal numbers, through which hidden controls, and the correlated noise of states, add to
the displacements of a group of states.
"""

import math

import numpy as np

from pgm.beliefs.grid.dependence import places
from pgm.beliefs.grid.groups import Group, Spread
from pgm.errors import ModelError
from pgm.kernels.arrays import Array
from pgm.kernels.lattice import kernels

# Nodes at the most.
_NODES = 4096
# Noise that spreads over no more than this many cells takes the nodes of Gauss and Hermite.
_NARROW = 1.0
_HERMITE = 5
# Weights of nodes below this are left out.
_SLIGHT = 1e-14
# Shares of a standard deviation at which displacements are looked at: those of a whole one may go
# round a circle, and seem to be none.
_SHARES = (1.0, 0.1, 1e-2, 1e-3)


def quadrature(group: Group, spread: Spread, step: int, run: int) -> tuple[Array, Array]:
    """The nodes of the white noise of a group, (nodes, spread.size), and their weights, (nodes,).

    `spread` is the noise of the group's displacements at the step; `spread.size` counts the numbers
    of the white noise. Each number has nodes of its own, the more of them the further it moves
    displacements; the nodes of the noise are all combinations of these. Weights sum to one; more
    than 4096 combinations are refused by a ModelError. Without shared noise there is one node, of
    no numbers.
    """
    size = spread.size
    if not size:
        return np.zeros((1, 0)), np.ones(1)
    here = places(group.lattice, 64, step)
    points = group.lattice.points(list(here.T))
    each = []
    for k in range(size):
        unit = np.eye(size)[[k] * len(points)]
        extent = 0.0
        for share in _SHARES:
            ends = [
                group.displacement(points, points, sign * share * unit, spread, step, run)
                for sign in (1.0, -1.0)
            ]
            apart = float(np.abs(group.wrapped(ends[0] - ends[1])).max())
            extent = max(extent, 0.5 * apart / share)
        each.append(_nodes(min(extent, _NODES)))
    count = math.prod(len(nodes) for nodes, _ in each)
    if count > _NODES:
        cpds = [*group.controls, *group.states]
        raise ModelError(
            f"the noise of {cpds} at step {step}, of controls or correlated, spreads over so many "
            f"cells that {count} or more displacements of the grid would be summed; make its "
            "cells wider, or the noise a covariance that is diagonal",
            cpd=cpds[0],
            step=step,
        )
    mesh = np.meshgrid(*(nodes for nodes, _ in each), indexing="ij")
    weights = np.ones(())
    for _, own in each:
        weights = np.multiply.outer(weights, own)
    return np.stack([m.reshape(-1) for m in mesh], axis=-1), weights.reshape(-1)


def _nodes(extent: float) -> tuple[Array, Array]:
    """Nodes (n,) and weights (n,) for a standard normal number that moves states.

    A change of the number by one moves a displacement by `extent` cells. Up to one cell there are
    five Gauss–Hermite nodes. Above, the nodes are one cell of displacement apart, so that no cell
    is left out; they have the weights of a distribution over whole cells with the variance
    `extent`². A number that moves nothing has one node, 0.
    """
    if extent < 1e-9:
        return np.zeros(1), np.ones(1)
    if extent <= _NARROW:
        nodes, weights = np.polynomial.hermite_e.hermegauss(_HERMITE)
        return nodes, weights / weights.sum()
    # Nodes a cell apart, whose variance is one.
    made = kernels(np.zeros(1), extent**2)
    kept = made.weights[0] > _SLIGHT
    nodes = (int(made.first[0]) + np.arange(made.weights.shape[1])) / extent
    return nodes[kept], made.weights[0][kept] / made.weights[0][kept].sum()
