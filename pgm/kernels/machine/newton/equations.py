"""Where the normal equations of a chain lie in memory, slice by slice."""

from __future__ import annotations

from dataclasses import dataclass

# Slices of up to so many components are eliminated in straight lines, larger ones by loops.
_MOST = 5
# The floats of a slice are filled up to whole packs of so many.
PACK = 8


@dataclass(frozen=True)
class Layout:
    """The equations of a slice, of so many components, in memory.

    They are its own matrix, that across to the next slice, and the right side. Once it is
    eliminated there are the covariance, the gain and the offset of the slice given the next. Of
    the matrix of its own straight lines need the lower half alone.
    """

    size: int

    @property
    def straight(self) -> bool:
        """Whether a slice is eliminated in straight lines."""
        return self.size <= _MOST

    @property
    def across(self) -> int:
        """Where the matrix across to the next slice begins."""
        return self.size * self.size

    @property
    def right(self) -> int:
        """Where the right side begins."""
        return 2 * self.size * self.size

    @property
    def length(self) -> int:
        """All floats of a slice."""
        return -(-(self.right + self.size) // PACK) * PACK

    def squares(self, i: int, j: int) -> set[int]:
        """Where the product of two components of a slice and the next is needed."""
        i, j = max(i, j), min(i, j)
        return {self.square(i, j)} if self.straight else {self.square(i, j), self.square(j, i)}

    def square(self, i: int, j: int) -> int:
        """Where the product of two components of a slice and the next, in this order, goes."""
        (a, i), (b, j) = divmod(i, self.size), divmod(j, self.size)
        if a != b:
            return self.across + (j * self.size + i if a else i * self.size + j)
        return a * self.length + i * self.size + j

    def side(self, i: int) -> int:
        """Where the right side of a component of a slice and the next is."""
        part, place = divmod(i, self.size)
        return part * self.length + self.right + place
