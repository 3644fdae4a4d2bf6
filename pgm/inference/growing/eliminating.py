"""The elimination of fronts by Householder's reflections, in machine code or by NumPy."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from pgm.kernels.arrays import Array, Integers, frozen
from pgm.kernels.machine.fronts.plan import KeepingPlan
from pgm.kernels.rows import NEGLIGIBLE


class Posed(NamedTuple):
    """A front that is to be eliminated.

    Attributes
    ----------
    own, size : int
        How many components are pivots, and how many there are.
    blocks : list of pairs
        The columns of rows, and the rows [A b].
    parent : int
        The number of the front above, −1 of a root.
    above : list of int
        The columns of its separators in that front, ascending.
    """

    own: int
    size: int
    blocks: list[tuple[list[int], Array]]
    parent: int
    above: list[int]


class Found(NamedTuple):
    """The triangle [R₁₁ R₁₂ c] of a front that was eliminated, and the rows [A b] it leaves."""

    triangle: Array
    left: Array


def eliminated(fronts: Sequence[Posed], *, machine: bool) -> list[Found] | int:
    """The fronts, children before parents, or the number of the first that is not determined."""
    return _by_machine(fronts) if machine else _by_numpy(fronts)


def _by_numpy(fronts: Sequence[Posed]) -> list[Found] | int:
    from scipy.linalg.lapack import dgeqrf  # here, since it is slow to import

    found: list[Found] = []
    waiting: list[list[tuple[list[int], Array]]] = [[*front.blocks] for front in fronts]
    for k, (own, size, _, parent, above) in enumerate(fronts):
        blocks = waiting[k]
        count = sum(len(rows) for _, rows in blocks)
        if count < own:
            return k
        matrix, row = np.zeros((max(count, size), size + 1)), 0
        for where, rows in blocks:
            matrix[row : row + len(rows), [*where, size]] = rows
            row += len(rows)
        # The largest rows first, which keeps digits.
        order = np.argsort(-np.abs(matrix[:, :size]).max(axis=1), kind="stable")
        factor = dgeqrf(matrix[order])[0]
        factor = factor[:size] * _upper(size)
        inside = factor[:own, :own]
        pivots = inside.diagonal()
        proper = np.abs(pivots) > NEGLIGIBLE * np.sqrt((inside * inside).sum(axis=0))
        if not proper.all():
            return k
        sign = np.where(pivots < 0.0, -1.0, 1.0)[:, None]
        rest = factor[own:size]
        # A front has no more to leave than it has had rows beyond its pivots.
        rest = rest[: max(min(count - own, size - own), 0)]
        left = rest[:, own:].copy()
        found.append(Found(sign * factor[:own], left))
        if parent >= 0 and left.size:
            waiting[parent].append((above, left))
        waiting[k] = []
    return found


@lru_cache(maxsize=64)
def _upper(size: int) -> Array:
    """Ones on and above a diagonal, and that of the right side beyond, (size, size + 1)."""
    return frozen(np.triu(np.ones((size, size + 1))))


def _by_machine(fronts: Sequence[Posed]) -> list[Found] | int:
    from pgm.kernels.machine.fronts.solving import Solver  # which takes llvmlite

    blocks = [block for front in fronts for block in front.blocks]
    wide = np.array([len(where) for where, _ in blocks], dtype=np.intp)
    heights = np.array([len(rows) for _, rows in blocks], dtype=np.intp)
    whole = np.concatenate([np.zeros(0), *(rows.ravel() for _, rows in blocks)])
    right = _ends(np.repeat(wide + 1, heights))[1:] - 1
    begins = [_ends(part)[:-1] for part in (heights * wide, heights, wide)]
    per_front = [len(front.blocks) for front in fronts]
    parents = np.array([front.parent for front in fronts])
    hanging = np.flatnonzero(parents >= 0)
    hanging = hanging[np.argsort(parents[hanging], kind="stable")]
    pivots = np.array([front.own for front in fronts])
    shared = np.array([front.size for front in fronts]) - pivots
    plan = KeepingPlan(
        pivots=pivots,
        separators=shared,
        first_child=_ends(np.bincount(parents[hanging], minlength=len(fronts))),
        children=hanging,
        first_column=_ends(shared),
        above=np.array([c for front in fronts for c in front.above], dtype=np.intp),
        first_factor=_ends(np.array(per_front)),
        factors=np.stack([heights, wide, *begins], axis=1),
        columns=np.array([c for where, _ in blocks for c in where], dtype=np.intp),
    )
    solver = Solver(plan, 1)
    kept = solver.room()
    kept[:] = 0.0  # below the diagonals nothing is written
    solver.left[:] = 0.0
    entries, known = np.delete(whole, right), whole[right, None]
    _, fault = solver.rows(entries, known, kept, NEGLIGIBLE)
    if fault >= 0:
        return fault
    found = []
    places = zip(
        fronts,
        plan.keeps(1)[:-1].tolist(),
        plan.waiting(1)[0].tolist(),
        plan.sent.tolist(),
        strict=True,
    )
    for front, place, wait, sent in places:
        size, width = front.size, front.size - front.own + 1
        end = place + front.own * (size + 1)
        triangle = kept[place:end].reshape(front.own, size + 1).copy()
        left = solver.left[wait : wait + sent * width].reshape(sent, width).copy()
        found.append(Found(triangle, left))
    return found


def _ends(sizes: Integers) -> Integers:
    return np.concatenate([[0], np.cumsum(sizes)]).astype(np.intp)
