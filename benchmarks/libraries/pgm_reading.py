"""pgm on files of networks."""

from __future__ import annotations

from pathlib import Path

import pgm
from benchmarks.timing import Contender


def reading(path: Path) -> Contender:
    """From a gzipped BIF file to a checked network."""
    return Contender(lambda: pgm.read_bif(path), 1)
