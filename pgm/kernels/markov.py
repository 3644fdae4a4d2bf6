"""Sweeps of a hidden Markov chain over many steps, with messages that are scaled only now and then.

At step t the chain is in the state x_t, and z_t is measured. The messages of all steps are *rows*
of an array (steps, states, [runs]). A forward row is proportional to p(x_t | z up to t), a backward
row to p(z after t | x_t). The sum of a row over its states is its *mass*. The *weights* of a step
are p(z_t | x_t) up to a factor, (states, [runs]). [runs] is an axis that a single run lacks.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np

from pgm.kernels.arrays import Array

# apply(vector, out) puts the product of a transition, or its transpose, with a vector (states,
# [runs]) into `out`.
Apply = Callable[[Array, Array], object]
# The masses of rows, and of the belief that each row was made from, (steps, [runs]) both: their
# ratio is p(z_t | z before t), but for the factor of the weights.
Masses = tuple[Array, Array]
# counted(items, what, total) gives the items of a loop, and may tell of their progress.
Counted = Callable[[Iterable[Any], str, int], Iterable[Any]]
# The number of steps from one scaling of a belief to the next.
EVERY = 8


def masses(rows: Array) -> Array:
    """The masses of rows, sums over their states: (steps, [runs])."""
    # Of short rows a product takes a tenth of the time of a sum.
    found: Array = rows.dot(np.ones(rows.shape[1])) if rows.ndim == 2 else rows.sum(axis=1)
    return found


def forward(
    applies: Iterable[Apply], weights: Array, belief: Array, rows: Array, every: int = EVERY
) -> Masses:
    """Fill rows with forward messages; returns two arrays of masses, (steps, [runs]).

    Row t is weights[t] times the transition applied to the belief before step t. This belief is row
    t − 1; after every `every` steps it is a copy of row t − 1, scaled to mass one. The first array
    returned has the masses of the rows, the second those of the beliefs before the steps.

    `applies` has a function for each step, called with a belief and an array: it applies the
    transition into the step to the belief, and puts the result into the array. `weights` and `rows`
    are (steps, states, [runs]); `belief` (states, [runs]), of mass one, is the belief before the
    first step.
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
    """Fill rows (steps, states, [runs]) with backward messages, from the last row, which is given.

    Row t − 1 is the transposed transition into step t, applied to row t times the weights of step
    t; after every `every` steps a row is scaled to mass one. `applies` has, in reverse order, a
    function for each step but the first, called with a message and an array: it applies the
    transposed transition into the step to the message, and puts the result into the array.
    `weights` (steps − 1, states, [runs]) are of all steps but the first, in forward order.
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


def _uncounted(items: Iterable[Any], what: str, total: int) -> Iterable[Any]:
    """The items themselves, of which nothing is told."""
    return items


class Blocks:
    """The forward and backward sweeps of one run of T steps and few states, in blocks of √T steps.

    All blocks are swept at once. The transfer matrix of a block is the matrix product of
    p(x_t | x_{t−1}) p(z_t | x_t) over its steps: its entry (i, j) leads from state i before the
    block to state j at its end. Each row of a transfer matrix is scaled to sum one by a scale of
    its own, whose logarithm is stored. A scale common to all rows could let a row that matters
    underflow: that of a state which is likely before the block, but from which the block's
    measurements are far less likely than from another one. `matrix` (states, states) is the
    transition, the same in all steps, parents first; `weights` is (steps, states). `counted` is
    told of each loop over the steps of a block, if it is given.
    """

    def __init__(self, matrix: Array, weights: Array, counted: Counted = _uncounted) -> None:
        self.matrix, self.steps, self.counted = matrix, len(weights), counted
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
        """Set `transfer` (blocks, states, states), rows of sum one, and `scale` (blocks, states).

        `scale` are the natural logarithms of the rows' scales; −∞ for a row that is impossible.
        """
        count, size = self.count, self.size
        held = np.repeat(np.eye(size)[:, None], count, axis=1)
        spare = np.empty(held.shape)
        self.scale = np.zeros((size, count))
        for k, weight in enumerate(self.counted(self.weights, "blocks", self.length)):
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
        """Fill rows (steps, states) with forward messages; returns two arrays of masses, (steps,).

        The first has the masses of the rows; the second those of the beliefs that the rows were
        made from, each the row before it or a belief scaled to mass one. `belief` (states,), of
        mass one, is the belief before the first step.
        """
        held = self._starts(belief)
        found = np.empty(self.weights.shape)
        before = np.ones((self.length, self.count))
        weights = self.counted(self.weights, "forward", self.length)
        for k, (weight, row) in enumerate(zip(weights, found, strict=True)):
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
        """Fill rows (steps + 1, states) with backward messages; row 0 is before the first step.

        The last row is constant, 1 / states, as nothing is measured after it.
        """
        turned = np.ascontiguousarray(self.matrix.T)
        ends = self._ends()
        found = np.empty(self.weights.shape)
        held, product = ends, np.empty(ends.shape)
        for k in self.counted(range(self.length - 1, -1, -1), "back", self.length):
            np.multiply(held, self.weights[k], product)
            row = found[k]
            np.dot(product, turned, out=row)
            if k % EVERY == 0:
                row /= np.add.reduce(row, 1, keepdims=True)
            if k >= self.last:  # padding, which moves nothing
                row[-1] = ends[-1]
            held = row
        rows[:-1] = self._in_order(found)
        rows[-1] = 1.0 / self.size

    def _in_order(self, found: Array) -> Array:
        """Values (steps of a block, blocks, ...) as (steps, ...) in the order of all steps."""
        return found.swapaxes(0, 1).reshape(-1, *found.shape[2:])[: self.steps]

    def _starts(self, belief: Array) -> Array:
        """The belief before each block, (blocks, states), of sum one, by the transfer matrices.

        `belief` (states,) is the belief before the first block. Scales are applied in logarithms,
        since two rows' scales may be further apart than float64 holds. If a block's evidence is
        impossible, all later blocks get the belief before that block, whose own sweep will find a
        mass of zero.
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
        """The backward message to the last step of each block, (blocks, states), of sum one.

        If a block's evidence is impossible, all earlier blocks get the message to that block's last
        step.
        """
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
