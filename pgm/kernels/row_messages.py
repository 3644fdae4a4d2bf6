"""Messages between clusters as `rows.Rows`: products, damping, and how much they change.

A message over s variables x is exp(−½ ‖A x − r‖²), times a delta function for each of its *exact
relations*, the equations C x = c without noise, if there are any. A stack of B messages has rows
A (V, B, s, s) and right sides r (V, B, s, N), C (V, B, m, s) and c (V, B, m, N): V runs have a
matrix each and N = 1, or N runs share one and V = 1. Variables are in the units of the model's
frame, (x − prior mean) / prior standard deviation, so that differences compare.
"""

from __future__ import annotations

import numpy as np

from pgm.kernels.arrays import LAST_PLACES, Array, Mask, transpose
from pgm.kernels.rows import Rows, eliminate, triangular

# Exact relations that differ by less, in units of the frame, differ by rounding alone.
STEADY = 1e-12


def product(a: Rows, b: Rows) -> Rows:
    """The product of each factor of the stack `a` and the corresponding factor of the stack `b`.

    A product has the rows of both factors, those of `a` first. It has no exact relations if those
    of `a` or `b` are None.
    """
    parts = zip(a, b, strict=True)
    return Rows._make(None if p is None or q is None else _together(p, q) for p, q in parts)


def first(stack: Rows) -> Rows:
    """The only factor (V, s, s) of a stack (V, 1, s, s), with its right sides (V, s, N)."""
    return Rows._make(None if part is None else part[:, 0] for part in stack)


def damped(old: Rows, new: Rows, damping: float) -> Rows:
    """The weighted geometric mean old^damping · new^(1 − damping) of messages, with s rows each.

    Information matrices and vectors are added with the shares `damping` and 1 − `damping`; the
    exact relations are those of `new`.
    """
    kept, taken = np.sqrt(damping), np.sqrt(1.0 - damping)
    size = new.matrix.shape[-1]
    both = triangular(
        _together(taken * new.matrix, kept * old.matrix),
        _together(taken * new.right, kept * old.right),
    )
    return new._replace(matrix=both[..., :size, :size], right=both[..., :size, size:])


def change(old: Rows, new: Rows, against: Rows) -> Array:
    """The relative change of sepsets' beliefs by new messages in place of the old ones, (B, runs).

    `against` has, for each message, that in the opposite direction. The belief of a sepset is its
    new message times this one; it has means m, and D is the diagonal matrix of its standard
    deviations. ΔK and Δh are the changes of a message's information matrix K = AᵀA and vector
    h = Aᵀr, new less old. ε is the rounding unit of float64. The change of a sepset's belief is the
    largest of all entries of

    - D |ΔK| D,
    - (D |Δh − ΔK m| − 32 ε D⁻¹ |m|)₊, the move of the mean in standard deviations less rounding,
    - the difference of the old and new exact relations, in units of the frame.

    It is infinite where the belief does not exist.
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
    """The new messages, with the old exact relations where the new ones differ by rounding alone.

    A message keeps the old relations if they differ from the new ones by less than 10⁻¹² in units
    of the frame, for all the right sides that share a matrix. Loops feed certainties back to
    themselves, and can amplify their rounding without end.
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
    """The new messages in the runs that `active` (runs,) marks, the old messages in all other runs.

    Where runs share a matrix, V = 1, the new matrix is taken for all runs, and only right sides are
    chosen. There are no exact relations in the result unless both `new` and `old` have some.
    """
    shared = new.matrix.shape[0] == 1
    each = active[:, None, None, None]

    def matrix(a: Array, b: Array) -> Array:
        """The new matrices `a` in the runs to be changed, the old ones `b` in all other runs.

        They are A or C, (V, B, rows, s). If all runs share a matrix, V = 1, the result is `a`.
        """
        return a if shared else np.where(each, a, b)

    def right(a: Array, b: Array) -> Array:
        """The new right sides `a` in the runs to be changed, the old ones `b` in all other runs.

        They are r or c, (V, B, rows, N).
        """
        return np.where(active if shared else each, a, b)

    chosen = Rows(matrix(new.matrix, old.matrix), right(new.right, old.right))
    found = _relations(old, new)
    if found is None:
        return chosen
    exact, sides, new_exact, new_sides = found
    return chosen._replace(exact=matrix(new_exact, exact), exact_right=right(new_sides, sides))


def _relations(old: Rows, new: Rows) -> tuple[Array, Array, Array, Array] | None:
    """The exact relations C x = c of old and new messages: C and c of the old, C and c of the new.

    The old relations are cut to as many rows as the new ones have. None if the old or the new
    messages have no exact relations.
    """
    exact, sides, new_exact, new_sides = *old[2:], *new[2:]
    if exact is None or sides is None or new_exact is None or new_sides is None:
        return None
    count = new_exact.shape[-2]
    return exact[..., :count, :], sides[..., :count, :], new_exact, new_sides


def _moved(exact: Array, sides: Array, new_exact: Array, new_sides: Array) -> Array:
    """The largest difference of old and new exact relations C x = c, (V, B, N).

    The difference is taken of the entries of CᵀC and Cᵀc, in units of the frame: they are the same
    for any orthonormal rows C of the same relations. The arguments are C and c of the old
    relations, then of the new ones.
    """
    relations = transpose(new_exact) @ new_exact - transpose(exact) @ exact
    targets = transpose(new_exact) @ new_sides - transpose(exact) @ sides
    far = np.abs(relations).max(axis=(-2, -1), initial=0.0)[..., None]
    moved: Array = np.maximum(far, np.abs(targets).max(axis=-2, initial=0.0))
    return moved


def _together(a: Array, b: Array) -> Array:
    """The rows of matrices a (..., k, n) above those of b (..., l, n), as (..., k + l, n)."""
    return np.concatenate([a, b], axis=-2)
