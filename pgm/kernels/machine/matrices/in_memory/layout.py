"""How matrices lie in memory: row by row, in packs."""

from __future__ import annotations

from typing import NamedTuple


class Layout(NamedTuple):
    """Rows of packs, each of some columns of a single run, or of one column of several runs.

    Cells beyond the last column of a row are zeros.

    Attributes
    ----------
    lanes : int
        The floats of a pack.
    across : int
        The columns of a pack: as many as lanes, or one.
    held : int
        The packs that sums may keep in registers at once.
    """

    lanes: int
    across: int
    held: int

    @classmethod
    def of(cls, runs: int, registers: tuple[int, int]) -> Layout:
        """The layout for so many runs at once, by the registers of the machine that it is for."""
        width, count = registers
        lanes = runs if runs > 1 else max(width, 4)
        # A quarter of the registers is for what is multiplied.
        held = max(3 * count // 4 * width // lanes, 2)
        return cls(lanes, 1 if runs > 1 else lanes, held)

    @property
    def entry(self) -> int:
        """The floats of an entry."""
        return self.lanes // self.across

    def packs(self, width: int) -> int:
        """The packs of a row of so many columns."""
        return -(-width // self.across)

    def floats(self, height: int, width: int) -> int:
        """The room of a matrix, and of a pack more, since packs may be read from any column on."""
        return (height * self.packs(width) + 1) * self.lanes

    def tile(self, height: int, packs: int) -> tuple[int, int]:
        """The rows and packs of a product that are summed at once."""
        wide = max(min(packs, 3 if self.held >= 12 else 2), 1)
        return max(min(height, self.held // wide), 1), wide
