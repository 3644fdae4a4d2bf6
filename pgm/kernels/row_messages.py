"""Messages between clusters as rows: products, damping, and how much they change.

All are stacks (V, B, s, s) with right sides (V, B, s, N): of V runs with a matrix each and N = 1,
or of N runs that share one, V = 1.
"""

from __future__ import annotations

import numpy as np

from pgm.kernels.arrays import LAST_PLACES, Array, Mask, transpose
from pgm.kernels.rows import Rows, eliminate, triangular

# Exact relations that differ by less, in units of the frame, differ by rounding.
STEADY = 1e-12


def product(a: Rows, b: Rows) -> Rows:
    """The product of two stacks of factors: the rows of both together."""
    parts = zip(a, b, strict=True)
    return Rows._make(None if p is None or q is None else _together(p, q) for p, q in parts)


def first(stack: Rows) -> Rows:
    """The only factor of a stack, (V, s, s)."""
    return Rows._make(None if part is None else part[:, 0] for part in stack)


def damped(old: Rows, new: Rows, damping: float) -> Rows:
    """The geometric mean: information adds up with the shares of both."""
    kept, taken = np.sqrt(damping), np.sqrt(1.0 - damping)
    size = new.matrix.shape[-1]
    both = triangular(
        _together(taken * new.matrix, kept * old.matrix),
        _together(taken * new.right, kept * old.right),
    )
    return new._replace(matrix=both[..., :size, :size], right=both[..., :size, size:])


def change(old: Rows, new: Rows, against: Rows) -> Array:
    """The relative move of the sepsets' beliefs, (B, runs): of means and variances.

    With a message's information K and h, and the belief N(m, D²) that the new one makes with the
    message against it: the largest of D |ΔK| D and (D |Δh − ΔK m| − 32 ε D⁻¹ |m|)₊, a move less the
    rounding of the mean, as `moments.moved`; infinite where it is undefined.
    """
    belief = eliminate(product(new, against), new.matrix.shape[-1])
    std = np.sqrt(np.maximum(np.diagonal(belief.noise, axis1=-2, axis2=-1), 0.0))[..., None]
    information = transpose(new.matrix) @ new.matrix - transpose(old.matrix) @ old.matrix
    vector = transpose(new.matrix) @ new.right - transpose(old.matrix) @ old.right
    spread = np.abs(std * information * transpose(std)).max(axis=(-2, -1), initial=0.0)
    rounding = LAST_PLACES * np.abs(belief.offset) / np.where(std > 0.0, std, np.inf)
    shift = np.abs(std * (vector - information @ belief.offset)) - rounding
    shift = np.maximum(shift, 0.0).max(axis=-2, initial=0.0)  # NaN stays
    largest = np.maximum(spread[..., None], shift)
    relations = _relations(old, new)
    if relations is not None:
        largest = np.maximum(largest, _moved(*relations))
    largest = np.where(np.isnan(largest), np.inf, largest)
    return largest[0] if largest.shape[0] == 1 else largest[..., 0].swapaxes(0, 1)


def steady(old: Rows, new: Rows) -> Rows:
    """New rows, but exact relations as they were where they differ by rounding.

    Loops feed certainties back to themselves, and can amplify their rounding without end.
    """
    found = _relations(old, new)
    if found is None:
        return new
    exact, sides, new_exact, new_sides = found
    same = np.all(_moved(*found) < STEADY, axis=-1)[..., None, None]
    return new._replace(
        exact=np.where(same, exact, new_exact), exact_right=np.where(same, sides, new_sides)
    )


def choose(active: Mask, new: Rows, old: Rows) -> Rows:
    """New rows for the active runs; where runs share matrices, only right-hand sides differ."""
    shared = new.matrix.shape[0] == 1
    each = active[:, None, None, None]

    def matrix(a: Array, b: Array) -> Array:
        return a if shared else np.where(each, a, b)

    def right(a: Array, b: Array) -> Array:
        return np.where(active if shared else each, a, b)

    chosen = Rows(matrix(new.matrix, old.matrix), right(new.right, old.right))
    found = _relations(old, new)
    if found is None:
        return chosen
    exact, sides, new_exact, new_sides = found
    return chosen._replace(exact=matrix(new_exact, exact), exact_right=right(new_sides, sides))


def _relations(old: Rows, new: Rows) -> tuple[Array, Array, Array, Array] | None:
    """Exact relations of old and new rows, the old ones cut to as many; None if there are none."""
    exact, sides, new_exact, new_sides = *old[2:], *new[2:]
    if exact is None or sides is None or new_exact is None or new_sides is None:
        return None
    count = new_exact.shape[-2]
    return exact[..., :count, :], sides[..., :count, :], new_exact, new_sides


def _moved(exact: Array, sides: Array, new_exact: Array, new_sides: Array) -> Array:
    """The difference of exact relations, (V, B, N), whatever rows they are written as."""
    relations = transpose(new_exact) @ new_exact - transpose(exact) @ exact
    targets = transpose(new_exact) @ new_sides - transpose(exact) @ sides
    far = np.abs(relations).max(axis=(-2, -1), initial=0.0)[..., None]
    moved: Array = np.maximum(far, np.abs(targets).max(axis=-2, initial=0.0))
    return moved


def _together(a: Array, b: Array) -> Array:
    """The rows of two matrices below one another."""
    return np.concatenate([a, b], axis=-2)
