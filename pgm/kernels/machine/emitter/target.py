"""Machines that code is printed for, so far as code depends on which of them it is for."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from pgm.kernels.machine.emitter.wholes import Address


class Target(Protocol):
    """A machine that code is printed for: a processor, or a card."""

    @property
    def exported(self) -> str:
        """The heading of functions that are called from outside their module."""
        ...

    @property
    def registers(self) -> tuple[int, int]:
        """The floats of a register for vectors, and how many of them there are."""
        ...

    def scalar_function(self, name: str) -> str:
        """The symbol of the elementary function of this name in C."""
        ...

    def vector_function(self, name: str, arguments: int, lanes: int) -> tuple[str, int] | None:
        """The symbol of one for packs, and of how many lanes; None where there is none."""
        ...

    def pointed(self, address: Address) -> Address:
        """An address that has been read from memory."""
        ...
