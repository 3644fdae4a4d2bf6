"""The fronts of a tree as machine code is told of them."""

from __future__ import annotations

import numpy as np

from pgm.beliefs.gaussian.assembly import Assembly
from pgm.beliefs.gaussian.fronts import Fronts
from pgm.kernels.arrays import Integers
from pgm.kernels.machine.fronts.plan import Plan


def told(assembly: Assembly, fronts: Fronts) -> Plan:
    """The plan of fronts, with the rows of all factors as `Potentials` has them."""
    count, blocks = len(fronts), fronts.blocks
    hanging = np.flatnonzero(fronts.parent >= 0)
    hanging = hanging[np.argsort(fronts.parent[hanging], kind="stable")]
    owners, factors, columns = [], [], []
    begin = 0
    for k, group in enumerate(assembly.factors):
        front = fronts.of_cluster[group.clusters]
        found = blocks.columns(front, group.places)
        height, width, row = group.height, group.places.shape[1], np.arange(front.size)
        parts = np.broadcast_arrays(
            height,
            width,
            assembly.entry_starts[k] + row * (height * width),
            assembly.row_starts[k] + row * height,
            begin + row * width,
        )
        owners.append(front)
        factors.append(np.stack(parts, axis=1))
        columns.append(found.ravel())
        begin += found.size
    none = np.zeros(0, dtype=np.intp)
    owner = np.concatenate([none, *owners])
    order = np.argsort(owner, kind="stable")
    return Plan(
        pivots=fronts.pivots,
        separators=fronts.separators,
        first_child=_ends(np.bincount(fronts.parent[hanging], minlength=count)),
        children=hanging,
        first_column=_ends(fronts.separators),
        above=fronts.above,
        first_factor=_ends(np.bincount(owner, minlength=count)),
        factors=np.concatenate([np.zeros((0, 5), dtype=np.intp), *factors])[order],
        columns=np.concatenate([none, *columns]),
    )


def _ends(sizes: Integers) -> Integers:
    return np.concatenate([[0], np.cumsum(sizes)]).astype(np.intp)
