r"""The normal equations of a chain, eliminated slice by slice, over matrices of any numbers.

The equations of a slice x and the one after it, y, are A x + B y = r and Bᵀ x + C y = s, where A, B
and r know all slices before. `eliminate` says what x is, given y, and what it leaves to y's own
equations; `substitute` finds x and its block of the inverse of all equations from those of y. Both
are the block factors L D Lᵀ of a tridiagonal matrix, and its inverse's recurrence (Takahashi,
Fagan and Chen, 1973).

See `numbers` for what a matrix is here.
"""

from __future__ import annotations

from typing import NamedTuple

from pgm.kernels.numbers import Number
from pgm.kernels.step import AnyMatrix, predict


class Eliminated(NamedTuple):
    """A slice x = offset − G y + e, e ~ N(0, A⁻¹), and what it takes from y's own equations.

    `gain` is G = A⁻¹ B, `offset` A⁻¹ r and `cov` A⁻¹; `own` is Bᵀ A⁻¹ B and `right` Bᵀ A⁻¹ r;
    `share` is that of the root of A.
    """

    gain: AnyMatrix
    offset: AnyMatrix
    cov: AnyMatrix
    own: AnyMatrix
    right: AnyMatrix
    share: Number


def eliminate(own: AnyMatrix, across: AnyMatrix, right: AnyMatrix) -> Eliminated:
    """Eliminate a slice of the equations A x + B y = r."""
    root = own.root()
    across, right = root.solve(across), root.solve(right)
    gain, offset = root.solve_transposed(across), root.solve_transposed(right)
    taken = across.T.times(across.T), across.T @ right
    return Eliminated(gain, offset, root.inverse, *taken, root.share)


def substitute(
    gain: AnyMatrix, offset: AnyMatrix, cov: AnyMatrix, later: AnyMatrix, later_cov: AnyMatrix
) -> tuple[AnyMatrix, AnyMatrix]:
    """The solution for x, and its block of the inverse, from those of y."""
    return offset - gain @ later, predict(later_cov, gain, cov)
