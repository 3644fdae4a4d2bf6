"""Well-known discrete networks, from the files that the package pgmpy brings along."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

import pgm

# Those of the Bayesian network repository whose junction trees take less than a second.
NAMES = (
    *("asia", "cancer", "earthquake", "survey", "sachs", "child", "alarm", "insurance"),
    *("hailfinder", "win95pts", "hepar2", "andes", "pigs", "water"),
)


def stored(name: str) -> pgm.BayesianNetwork | None:
    """A network by name; None where pgmpy, or this one of its files, is not installed."""
    found = find_spec("pgmpy")
    if found is None or found.origin is None:
        return None
    file = Path(found.origin).parent / "utils" / "example_models" / f"{name}.bif.gz"
    return pgm.read_bif(file, normalise=True) if file.is_file() else None
