"""The elimination of fronts by Householder's reflections, in machine code or by NumPy."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from pgm.inference.growing.factors import Rows
from pgm.kernels.arrays import Array
from pgm.kernels.machine.fronts.plan import KeepingPlan
from pgm.kernels.rows import NEGLIGIBLE, triangular


class Posed(NamedTuple):
    """A front that is to be eliminated.

    Attributes
    ----------
    own, size : int
        How many components are pivots, and how many there are.
    blocks : list of pairs
        The columns of rows, and the rows.
    parent : int
        The number of the front above, −1 of a root.
    above : list of int
        The columns of its separators in that front, ascending.
    """

    own: int
    size: int
    blocks: list[tuple[list[int], Rows]]
    parent: int
    above: list[int]


class Found(NamedTuple):
    """The triangle [R₁₁ R₁₂ c] of a front that was eliminated, and the rows it leaves."""

    triangle: Array
    left: Rows


def eliminated(fronts: Sequence[Posed], *, machine: bool) -> list[Found] | int:
    """The fronts, children before parents, or the number of the first that is not determined."""
    return _by_machine(fronts) if machine else _by_numpy(fronts)


def _by_numpy(fronts: Sequence[Posed]) -> list[Found] | int:
    found: list[Found] = []
    waiting: list[list[tuple[list[int], Rows]]] = [[*front.blocks] for front in fronts]
    for k, (own, size, _, parent, above) in enumerate(fronts):
        blocks = waiting[k]
        count = sum(len(rows.right) for _, rows in blocks)
        matrix, right = np.zeros((count, size)), np.zeros((count, 1))
        row = 0
        for columns, rows in blocks:
            height = len(rows.right)
            matrix[row : row + height, columns] = rows.entries.reshape(height, -1)
            right[row : row + height, 0] = rows.right
            row += height
        factor = triangular(matrix, right)
        inside = factor[:own, :own]
        pivots = np.diagonal(inside)
        proper = np.abs(pivots) > NEGLIGIBLE * np.sqrt(np.einsum("ij,ij->j", inside, inside))
        if count < own or not proper.all():
            return k
        sign = np.where(pivots < 0.0, -1.0, 1.0)[:, None]
        rest = factor[own:size]
        # A front has no more to leave than it has had rows beyond its pivots.
        rest = rest[: max(min(count - own, size - own), 0)]
        left = Rows(rest[:, own:size].ravel(), rest[:, size].copy())
        found.append(Found(sign * factor[:own], left))
        if parent >= 0 and left.right.size:
            waiting[parent].append((above, left))
        waiting[k] = []
    return found


def _by_machine(fronts: Sequence[Posed]) -> list[Found] | int:
    from pgm.kernels.machine.fronts.solving import Solver  # which takes llvmlite

    factors, columns, entries, right = [], [], [], []
    begin, row, per_front = 0, 0, []
    for front in fronts:
        for where, rows in front.blocks:
            height = len(rows.right)
            factors += (height, len(where), begin, row, len(columns))
            columns += where
            entries.append(rows.entries)
            right.append(rows.right)
            begin, row = begin + len(rows.entries), row + height
        per_front.append(len(front.blocks))
    parents = np.array([front.parent for front in fronts])
    hanging = np.flatnonzero(parents >= 0)
    hanging = hanging[np.argsort(parents[hanging], kind="stable")]
    own = np.array([front.own for front in fronts])
    shared = np.array([front.size for front in fronts]) - own
    plan = KeepingPlan(
        pivots=own,
        separators=shared,
        first_child=_ends(np.bincount(parents[hanging], minlength=len(fronts))),
        children=hanging,
        first_column=_ends(shared),
        above=np.array([c for front in fronts for c in front.above], dtype=np.intp),
        first_factor=_ends(np.array(per_front)),
        factors=np.array(factors, dtype=np.intp).reshape(-1, 5),
        columns=np.array(columns, dtype=np.intp),
    )
    solver = Solver(plan, 1)
    kept = solver.room()
    kept[:] = 0.0  # below the diagonals nothing is written
    solver.left[:] = 0.0
    none = np.zeros(0)
    known = np.concatenate([none, *right])[:, None]
    _, fault = solver.rows(np.concatenate([none, *entries]), known, kept, NEGLIGIBLE)
    if fault >= 0:
        return fault
    found = []
    places = zip(plan.keeps(1).tolist(), plan.waiting(1)[0].tolist(), plan.sent.tolist())
    for front, (place, wait, sent) in zip(fronts, places, strict=False):
        own, size = front.own, front.size
        triangle = kept[place : place + own * (size + 1)].reshape(own, size + 1).copy()
        wide = size - own + 1
        rest = solver.left[wait : wait + sent * wide].reshape(sent, wide)
        found.append(Found(triangle, Rows(rest[:, :-1].ravel(), rest[:, -1].copy())))
    return found


def _ends(sizes: Array) -> Array:
    return np.concatenate([[0], np.cumsum(sizes)]).astype(np.intp)
