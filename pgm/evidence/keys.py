"""Evidence for what the network does not have."""

from __future__ import annotations

from collections.abc import Collection

from pgm.errors import EvidenceError
from pgm.factors.unknown_names import unknown_name
from pgm.variables import Variable


def unknown(key: object, known: Collection[Variable]) -> EvidenceError:
    """The error of evidence whose key is none of the known variables."""
    return EvidenceError(
        f"evidence for {key!r}, {unknown_name(key, known)}",
        variable=key if isinstance(key, Variable) else None,
    )
