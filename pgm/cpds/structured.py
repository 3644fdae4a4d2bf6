"""Tables of transitions with a structure: sparse ones, shifts of cells, products of axes."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from pgm.arguments import public
from pgm.boundary import as_floats, as_tuple, is_number, is_whole
from pgm.display import InCode
from pgm.errors import ModelError
from pgm.immutable import Immutable
from pgm.kernels.stochastic import Dense, Product, Sparse, Transition
from pgm.resources import require_memory

if TYPE_CHECKING:
    from scipy import sparse

EDGES = ("slide", "stay", "wrap")
# A place moved farther may be no 64-bit number.
FARTHEST = 2**62


@public
class Kronecker(InCode, Immutable):
    r"""The table of a state whose index runs over several axes, each of which moves by itself.

    .. math:: p(x_1, \dots, x_n \mid y_1, \dots, y_n) = \prod_k A_k[y_k, x_k]

    States stand with the last axis fastest, as `numpy.ravel_multi_index` has them. Such a table is
    never formed: a belief is moved axis by axis.

    Parameters
    ----------
    factors : sequence of array_like, sparse matrix or Kronecker
        For each axis the square matrix (size before, size after), whose rows sum to one.

    Examples
    --------
    >>> east, north = np.eye(3), [[0.9, 0.1], [0.2, 0.8]]
    >>> Kronecker([east, north])
    Kronecker(3 x 2 states)
    """

    factors: tuple[Any, ...]
    transition: Product

    def __init__(self, factors: Sequence[Any]) -> None:
        found = as_tuple(factors)
        if not found:
            raise ModelError(
                f"Kronecker takes a sequence of matrices, one for each axis, not {factors!r}"
            )
        maps = [
            as_transition(factor, f"the factor of axis {k} of a Kronecker table")
            for k, factor in enumerate(found)
        ]
        self._set(factors=found, transition=Product(maps))

    @property
    def shape(self) -> tuple[int, int]:
        """Parents and children."""
        return self.transition.shape

    def __repr__(self) -> str:
        return f"Kronecker({' x '.join(map(str, self.transition.after))} states)"


@public
def shifts(
    shape: int | tuple[int, ...],
    moves: Mapping[Any, float],
    *,
    edge: str | Sequence[str] = "slide",
) -> sparse.csr_array:
    """The sparse table of a cell that moves by one of several shifts along axes.

    Cells stand with the last axis fastest, as `numpy.ravel_multi_index` has them.

    Parameters
    ----------
    shape : int or tuple of int
        Cells along each axis.
    moves : mapping of int or tuple of int to float
        The probability of each shift, in cells along each axis; they sum to one.
    edge : str or sequence of str
        What a cell at an edge does: ``"slide"`` keeps to the last cell along the axis, so that the
        rest of the shift is made; ``"wrap"`` goes on from the other end, as a heading does; both
        also axis by axis, in a sequence. ``"stay"`` leaves the whole shift out.

    Returns
    -------
    scipy.sparse.csr_array
        (cells, cells), rows before, columns after; for the ``table=`` of a `TableCPD`.

    Examples
    --------
    >>> shifts(3, {0: 0.25, 1: 0.75}).toarray()
    array([[0.25, 0.75, 0.  ],
           [0.  , 0.25, 0.75],
           [0.  , 0.  , 1.  ]])
    """
    from scipy import sparse

    sizes = _sizes(shape)
    edges = _edges(edge, len(sizes))
    steps = {_move(move, sizes): _probability(move, p) for move, p in _items(moves)}
    if len(steps) < len(moves):
        raise ModelError(f"moves has one shift twice, as a number and in a tuple: {moves!r}")
    total = math.fsum(steps.values())
    if abs(total - 1.0) > 1e-9:
        raise ModelError(f"the probabilities of the shifts sum to {total:.9g}; they must to one")
    cells = math.prod(sizes)
    require_memory(2 * cells * len(steps), f"{len(steps)} shifts of {cells} cells", "take fewer")
    places = np.indices(sizes).reshape(len(sizes), cells)
    rows, columns, values = [], [], []
    for move, probability in steps.items():
        moved = places + np.array(move)[:, None]
        for axis, (size, how) in enumerate(zip(sizes, edges, strict=True)):
            if how == "wrap":
                moved[axis] %= size
        outside = (moved < 0) | (moved >= np.array(sizes)[:, None])
        held = np.clip(moved, 0, np.array(sizes)[:, None] - 1)
        if "stay" in edges:
            held = np.where(outside.any(axis=0), places, held)
        rows.append(np.arange(cells))
        columns.append(np.ravel_multi_index(tuple(held), sizes))
        values.append(np.full(cells, probability))
    entries = np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))
    table = sparse.coo_array(entries, shape=(cells, cells)).tocsr()
    table.eliminate_zeros()
    return table


def _sizes(shape: Any) -> tuple[int, ...]:
    found = (shape,) if is_whole(shape) else as_tuple(shape)
    if not found or not all(is_whole(size) and size > 0 for size in found):
        raise ModelError(f"the shape is a number of cells along each axis, not {shape!r}")
    return tuple(map(int, found))


def _edges(edge: Any, axes: int) -> tuple[str, ...]:
    found = (edge,) * axes if isinstance(edge, str) else as_tuple(edge)
    allowed = EDGES if isinstance(edge, str) else ("slide", "wrap")
    if found is None or len(found) != axes or not all(each in allowed for each in found):
        raise ModelError(
            f"edge is one of {EDGES}, or 'slide' or 'wrap' for each of the {axes} axes, not "
            f"{edge!r}"
        )
    return tuple(found)


def _items(moves: Any) -> list[tuple[Any, Any]]:
    if not isinstance(moves, Mapping) or not moves:
        raise ModelError(f"moves maps shifts to probabilities, {{(0, 1): 0.9, ...}}, not {moves!r}")
    return list(moves.items())


def _move(move: Any, sizes: tuple[int, ...]) -> tuple[int, ...]:
    found = (move,) if is_whole(move) else as_tuple(move)
    if found is None or len(found) != len(sizes) or not all(map(is_whole, found)):
        raise ModelError(
            f"a shift is a whole number of cells along each of {len(sizes)} axes, not {move!r}"
        )
    for cells in found:
        if abs(int(cells)) > FARTHEST:
            raise ModelError(f"the shift {move!r} is of more than {FARTHEST} cells")
    return tuple(map(int, found))


def _probability(move: Any, value: Any) -> float:
    if not is_number(value) or not 0.0 <= value <= 1.0:
        raise ModelError(f"the probability of the shift {move!r} is {value!r}; 0 to 1 was due")
    return float(value)


def is_structured(table: Any) -> bool:
    """Whether a table is sparse, or a `Kronecker`."""
    return isinstance(table, Kronecker) or (hasattr(table, "tocsr") and hasattr(table, "nnz"))


def as_transition(table: Any, what: str, **about: Any) -> Transition:
    """A checked matrix of probabilities (parents, children) as a linear map."""
    if isinstance(table, Kronecker):
        return table.transition
    if is_structured(table):
        if len(table.shape) != 2 or np.dtype(table.dtype).kind not in "fiub":
            raise ModelError(f"{what} must be a matrix of numbers, not {table!r}", **about)
        sparse = Sparse(table.astype(np.float64))
        values, sums = sparse.matrix.data, np.asarray(sparse.matrix.sum(axis=1)).ravel()
        found: Transition = sparse
    else:
        array = as_floats(table, what, **about)
        if array.ndim != 2:
            raise ModelError(f"{what} must be a matrix, not of shape {array.shape}", **about)
        found = Dense(array.copy())
        values, sums = array, array.sum(axis=1)
    if not np.isfinite(values).all() or (values < 0.0).any():
        raise ModelError(f"{what} has entries that are negative, NaN or infinite", **about)
    error = np.abs(sums - 1.0)
    if (error > rounding(found.shape[1])).any():
        row = int(error.argmax())
        raise ModelError(
            f"{what}: row {row}, the probabilities given that state, sums to {sums[row]:.9g}; "
            "each row must sum to one",
            **about,
        )
    return found


# How far an entry of a table with six decimals may be from the number that was rounded.
ROUNDED = 5e-7


def rounding(size: int) -> float:
    """The rounding error that a sum of `count` probabilities may have."""
    return max(ROUNDED * size, 1e-6) + size * float(np.finfo(float).eps)
