"""Well-known discrete networks, from the files that the package pgmpy brings along."""

from __future__ import annotations

from collections.abc import Iterable
from importlib.util import find_spec
from pathlib import Path

import pgm

_ENDING = ".bif.gz"
# Those of the Bayesian network repository whose junction trees take less than a second.
NAMES = (
    *("asia", "cancer", "earthquake", "survey", "sachs", "child", "alarm", "insurance"),
    *("hailfinder", "win95pts", "hepar2", "andes", "pigs", "water"),
)


def stored(name: str) -> pgm.BayesianNetwork | None:
    """A network by name; None where pgmpy, or this one of its files, is not installed."""
    file = None if (folder := _folder()) is None else folder / f"{name}{_ENDING}"
    return pgm.read_bif(file, normalise=True) if file is not None and file.is_file() else None


def require_stored(names: Iterable[str]) -> None:
    """Refuse names of networks that pgmpy does not have; without pgmpy all are left out.

    Raises
    ------
    FileError
    """
    folder = _folder()
    if folder is None:
        return
    known = sorted(path.name.removesuffix(_ENDING) for path in folder.glob(f"*{_ENDING}"))
    for name in names:
        if name not in known:
            raise pgm.FileError(
                f"--known {name}: pgmpy has no such network; it has {', '.join(known)}"
            )


def _folder() -> Path | None:
    found = find_spec("pgmpy")
    if found is None or found.origin is None:
        return None
    return Path(found.origin).parent / "utils" / "example_models"
