"""Sweeps of a hidden Markov chain over many steps: beliefs that are scaled only now and then.

Rows are (steps, states, [runs]). A forward row is proportional to p(x_t | z up to t), a backward
one to p(z after t | x_t).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable

import numpy as np

from pgm.kernels.arrays import Array

# One product: (vector, out).
Apply = Callable[[Array, Array], object]
# Of rows, and of the belief that each was made from, (steps, [runs]).
Masses = tuple[Array, Array]
# So many steps are made before a belief is scaled.
EVERY = 8


def masses(rows: Array) -> Array:
    """The sums of rows over their states: (steps, [runs])."""
    # Of short rows a product takes a tenth of the time of a sum.
    found: Array = rows.dot(np.ones(rows.shape[1])) if rows.ndim == 2 else rows.sum(axis=1)
    return found


def forward(
    applies: Iterable[Apply], weights: Array, belief: Array, rows: Array, every: int = EVERY
) -> Masses:
    """Fill rows with forward messages; returns their masses, and the masses of the rows before.

    `weights` are p(z_t | x_t) up to a factor, like `rows` (steps, states, [runs]); `belief` is that
    at the step before, of sum one. Messages are scaled `every` so many steps.
    """
    before = np.ones((len(rows), *belief.shape[1:]))
    for k, (apply, weight, row) in enumerate(zip(applies, weights, rows, strict=False)):
        apply(belief, row)
        np.multiply(row, weight, row)
        belief = row
        if k % every == every - 1:
            belief = row / np.add.reduce(row, 0)
    totals = masses(rows)
    held = np.arange(len(rows)) % every != 0
    before[held] = totals[:-1][held[1:]]
    return totals, before


def backward(applies: Iterable[Apply], weights: Array, rows: Array, every: int = EVERY) -> None:
    """Fill rows, last to first, with the messages to each step; the last row is given.

    `applies` are the transposed transitions into each step but the first, last to first; `weights`
    (steps − 1, states, [runs]) of the same steps.
    """
    message = rows[-1]
    product = np.empty_like(message)
    for k, (apply, weight, row) in enumerate(
        zip(applies, weights[::-1], rows[-2::-1], strict=True)
    ):
        np.multiply(message, weight, product)
        apply(product, row)
        if k % every == every - 1:
            row /= np.add.reduce(row, 0)
        message = row


class Blocks:
    """The steps of one run of few states, in blocks of √T steps computed side by side.

    Each row of a block's transfer matrix, the product of p(x_t | x_{t−1}) p(z_t | x_t) over its
    steps, has a logarithm as its scale: else the row of a likely state would be lost beside that of
    an unlikely one whose measurements are likelier.
    """

    def __init__(self, matrix: Array, weights: Array) -> None:
        self.matrix, self.steps = matrix, len(weights)
        self.size = weights.shape[1]
        self.length = max(1, math.isqrt(self.steps))
        self.count = -(-self.steps // self.length)
        # Steps of the last block that are not padding, which moves nothing.
        self.last = self.steps - (self.count - 1) * self.length
        padded = np.ones((self.count * self.length, self.size))
        padded[: self.steps] = weights
        by_block = padded.reshape(self.count, self.length, self.size)
        self.weights = np.ascontiguousarray(by_block.swapaxes(0, 1))
        self._transfer()

    def _transfer(self) -> None:
        """Find each block's transfer matrix, rows of sum one, and the logarithms of scales."""
        count, size = self.count, self.size
        held = np.repeat(np.eye(size)[:, None], count, axis=1)
        spare = np.empty(held.shape)
        self.scale = np.zeros((size, count))
        for k, weight in enumerate(self.weights):
            np.dot(held.reshape(-1, size), self.matrix, out=spare.reshape(-1, size))
            np.multiply(spare, weight, spare)
            if k >= self.last:
                spare[:, -1] = held[:, -1]
            if k % EVERY == EVERY - 1 or k == self.length - 1:
                totals = masses(spare.reshape(-1, size)).reshape(size, count)
                with np.errstate(divide="ignore"):
                    self.scale += np.log(totals)
                spare /= np.where(totals > 0.0, totals, 1.0)[:, :, None]
            held, spare = spare, held
        self.transfer = np.ascontiguousarray(held.swapaxes(0, 1))
        self.scale = np.ascontiguousarray(self.scale.T)

    def forward(self, belief: Array, rows: Array) -> Masses:
        """Fill rows with the forward messages of all steps, block beside block; see `forward`."""
        held = self._starts(belief)
        found = np.empty(self.weights.shape)
        before = np.ones((self.length, self.count))
        for k, (weight, row) in enumerate(zip(self.weights, found, strict=True)):
            np.dot(held, self.matrix, out=row)
            np.multiply(row, weight, row)
            held = row
            if k % EVERY == EVERY - 1:
                held = row / np.add.reduce(row, 1, keepdims=True)
        totals = masses(found.reshape(-1, self.size)).reshape(before.shape)
        kept = np.arange(1, self.length) % EVERY != 0
        before[1:][kept] = totals[:-1][kept]
        rows[...] = self._in_order(found)
        return self._in_order(totals), self._in_order(before)

    def backward(self, rows: Array) -> None:
        """Fill rows (steps + 1, states) with the messages to all steps and to the one before."""
        turned = np.ascontiguousarray(self.matrix.T)
        ends = self._ends()
        found = np.empty(self.weights.shape)
        held, product = ends, np.empty(ends.shape)
        for k in range(self.length - 1, -1, -1):
            np.multiply(held, self.weights[k], product)
            row = found[k]
            np.dot(product, turned, out=row)
            if k >= self.last:
                row[-1] = ends[-1]
            elif k % EVERY == 0:
                row /= np.add.reduce(row, 1, keepdims=True)
            held = row
        rows[:-1] = self._in_order(found)
        rows[-1] = 1.0 / self.size

    def _in_order(self, found: Array) -> Array:
        """Values (length, blocks, ...), by step within each block, as (steps, ...)."""
        return found.swapaxes(0, 1).reshape(-1, *found.shape[2:])[: self.steps]

    def _starts(self, belief: Array) -> Array:
        """The belief before each block, (blocks, states), by the transfer matrices of the blocks.

        Scales are added in logarithms: one block's largest probability may be far below what
        another holds. From an impossible block on the belief stays, and the sweep within the block
        tells.
        """
        found = np.empty(self.scale.shape)
        for k, (own, logs) in enumerate(zip(self.transfer, self.scale, strict=True)):
            found[k] = belief
            with np.errstate(divide="ignore"):
                shares = np.log(belief) + logs
            top = shares.max()
            if top == -np.inf:  # impossible, as the sweep within the block will find
                found[k + 1 :] = belief
                break
            belief = np.exp(shares - top) @ own
            belief = belief / belief.sum()
        return found

    def _ends(self) -> Array:
        """The backward message to the last step of each block, (blocks, states); see `_starts`."""
        found = np.empty(self.scale.shape)
        message = np.full(self.size, 1.0 / self.size)
        for k in range(self.count - 1, -1, -1):
            found[k] = message
            with np.errstate(divide="ignore"):
                shares = np.log(self.transfer[k] @ message) + self.scale[k]
            top = shares.max()
            if top == -np.inf:
                found[:k] = message
                break
            message = np.exp(shares - top)
            message /= message.sum()
        return found
