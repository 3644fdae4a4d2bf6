"""Normal equations of stacks of fronts, factorised by Cholesky.

A factor exp(−½ ‖A ξ − r‖²) has the information AᵀA and the vector Aᵀr. Those of a front's factors,
and what its children leave, are summed into its matrix; its pivots are eliminated, and what is left
goes to its parent:

    A_pp = L Lᵀ,   W = A_sp L⁻ᵀ;   A_ss − W Wᵀ   and   h_s − W L⁻¹ h_p.

By NumPy that takes a fifth of the time of rows (`tree.calibrate`). Squares have half of their
digits, and do not show what they lose: they are for solutions that only lead to the next
linearisation.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from pgm.beliefs.gaussian.downward import Regression
from pgm.beliefs.gaussian.front_stacks import FrontStacks
from pgm.beliefs.gaussian.potentials import Potentials
from pgm.beliefs.gaussian.rounds import Stack
from pgm.kernels.arrays import Array, Integers, transpose


class _Place(NamedTuple):
    """Where the matrices of a stack's B fronts stand, and where in their parents' they are left.

    `entries` and `rows` are slices of the matrices and the vectors; `to` (B, s, s) and `to_rows`
    (B, s) are indices. `eye` (B, p, p) are unit matrices. `padded` (B, p, p) is one on the
    diagonal where a pivot stands for no component.
    """

    entries: slice
    rows: slice
    eye: Array
    to: Integers
    to_rows: Integers
    padded: Array


@dataclass(frozen=True, eq=False)
class FrontSquares:
    """The information of a tree's fronts in one array, stack by stack, then a place for nothing."""

    stacks: FrontStacks

    @cached_property
    def _starts(self) -> tuple[Integers, Integers, int, int]:
        """Where each front's matrix and vector begin, (fronts,) each, and where all end."""
        fronts = len(self.stacks.fronts)
        entries, rows = np.zeros((2, fronts), dtype=np.intp)
        at, row = 0, 0
        for stack in (stack for level in self.stacks.levels for stack in level):
            count, width = stack.components.shape
            entries[stack.members] = at + np.arange(count) * width * width
            rows[stack.members] = row + np.arange(count) * width
            at, row = at + count * width * width, row + count * width
        return entries, rows, at, row

    def _indices(self, fronts: Integers, columns: Integers) -> tuple[Integers, Integers]:
        """Indices (B, n, n) and (B, n) of columns (B, n) of fronts (B,); −1 stands for nothing."""
        entries, rows, end, last = self._starts
        width = (self.stacks.pivots + self.stacks.separators)[fronts]
        there = columns >= 0
        both = there[:, :, None] & there[:, None, :]
        inside = columns[:, :, None] * width[:, None, None] + columns[:, None, :]
        return (
            np.where(both, entries[fronts][:, None, None] + inside, end),
            np.where(there, rows[fronts][:, None] + columns, last),
        )

    @cached_property
    def _factors(self) -> list[tuple[Integers, Integers]]:
        """For each group of factors the indices of their columns."""
        stacks, blocks = self.stacks, self.stacks.fronts.blocks
        found = []
        for factors in stacks.assembly.factors:
            front = stacks.of_cluster[factors.clusters]
            columns = stacks.padded(front, blocks.columns(front, factors.places))
            found.append(self._indices(front, columns))
        return found

    @cached_property
    def _places(self) -> list[list[_Place]]:
        return [[self._place(stack) for stack in level] for level in self.stacks.levels]

    def _place(self, stack: Stack) -> _Place:
        fronts, (entries, rows, *_) = self.stacks.fronts, self._starts
        (count, width), first = stack.components.shape, stack.members[0]
        begin, row = int(entries[first]), int(rows[first])
        above = self.stacks.above(stack)
        parents = np.maximum(fronts.parent[stack.members], 0)
        columns = np.where(above < 0, -1, self.stacks.padded(parents, np.maximum(above, 0)))
        to, to_rows = self._indices(parents, columns)
        own = fronts.pivots[stack.members][:, None]
        return _Place(
            slice(begin, begin + count * width * width),
            slice(row, row + count * width),
            np.broadcast_to(np.eye(stack.drop), (count, stack.drop, stack.drop)),
            to,
            to_rows,
            (np.arange(stack.drop) >= own)[..., None] * np.eye(stack.drop),
        )

    def eliminate(self, potentials: Potentials, share: float) -> list[list[Regression]] | None:
        """Eliminate the pivots of all stacks; None where a pivot is cancelled to this share."""
        information, vectors = self._summed(potentials)
        found: list[list[Regression]] = []
        for level, places in zip(self.stacks.levels, self._places, strict=True):
            found.append([])
            for stack, place in zip(level, places, strict=True):
                done = self._eliminated(stack, place, information, vectors, share)
                if done is None:
                    return None
                found[-1].append(done)
        return found

    def _summed(self, potentials: Potentials) -> tuple[Array, Array]:
        """The information (V, entries) and vectors (V, rows, N) of all factors."""
        assembly, (*_, end, last) = self.stacks.assembly, self._starts
        matrix, right = potentials.proper
        stacked, _, sides = right.shape
        vectors = np.zeros((stacked, last + 1, sides))
        squares, where = [np.zeros((stacked, 0))], [np.zeros(0, dtype=np.intp)]
        for k, (entries, rows) in enumerate(self._factors):
            own, side = assembly.matrices(k, matrix), assembly.sides(k, right)
            squares.append((transpose(own) @ own).reshape(stacked, -1))
            where.append(entries.ravel())
            for total, part in zip(vectors, transpose(own) @ side, strict=True):
                np.add.at(total, rows, part)
        index, every = np.concatenate(where), np.concatenate(squares, axis=1)
        summed = [np.asarray(np.bincount(index, each, end + 1), float) for each in every]
        information = summed[0][None] if stacked == 1 else np.stack(summed)
        return information, vectors

    def _eliminated(
        self, stack: Stack, place: _Place, information: Array, vectors: Array, share: float
    ) -> Regression | None:
        count, width, drop = *stack.components.shape, stack.drop
        stacked, _, sides = vectors.shape
        front = information[:, place.entries].reshape(stacked, count, width, width)
        vector = vectors[:, place.rows].reshape(stacked, count, width, sides)
        own = front[..., :drop, :drop] + place.padded
        try:
            lower = np.linalg.cholesky(own)
        except np.linalg.LinAlgError:
            return None
        left, before = (np.diagonal(part, axis1=-2, axis2=-1) for part in (lower, own))
        if not (left**2 > share * before).all():
            return None
        inverse = np.linalg.solve(lower, place.eye)
        turned = transpose(inverse)
        across, known = front[..., drop:, :drop] @ turned, inverse @ vector[..., :drop, :]
        if stack.kept:
            rest = front[..., drop:, drop:] - across @ transpose(across)
            side = vector[..., drop:, :] - across @ known
            for v in range(stacked):
                np.add.at(information[v], place.to, rest[v])
                np.add.at(vectors[v], place.to_rows, side[v])
            information[:, -1] = vectors[:, -1] = 0.0  # where what stands for nothing was added
        return Regression(-transpose(across @ inverse), turned @ known, turned @ inverse)
