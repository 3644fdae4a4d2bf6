"""Checks that questions about networks of tables have in common."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pgm.errors import EvidenceError


def require_mapping(evidence: Any, what: str = "evidence") -> None:
    """Raise an EvidenceError unless evidence, which the error calls `what`, is a mapping."""
    if not isinstance(evidence, Mapping):
        records = "; of a table of records pgm.records(table, network) makes it"
        raise EvidenceError(
            f"{what} maps variables to states; found {type(evidence).__name__}"
            f"{records if what == 'evidence' else ''}"
        )
