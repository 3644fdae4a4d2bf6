"""Amounts of memory, told and refused before any is taken."""

from __future__ import annotations

from typing import Any

from pgm.errors import ModelError, PgmError
from pgm.kernels import memory

# Bytes of a number in double precision.
NUMBER = 8
# More than this no float holds.
_COUNTLESS = 10**300


def gibibytes(entries: float) -> str:
    """The memory of numbers in double precision, for messages."""
    return f"{min(entries, _COUNTLESS) * NUMBER / 2**30:.3g} GiB"


def require_memory(
    entries: int, what: str, advice: str, *, error: type[PgmError] = ModelError, **where: Any
) -> None:
    """Refuse arrays of at least so many doubles, which this machine cannot hold.

    `what` names the arrays in the message, `advice` the way out; `where` are the objects concerned.
    """
    limit = memory.most()
    if entries * NUMBER > limit:
        raise error(
            f"{what} would take {gibibytes(entries)} or more, where this machine has "
            f"{gibibytes(limit / NUMBER)}; {advice}",
            **where,
        )
