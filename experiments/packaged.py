"""Files that an installed package carries, found without importing it."""

from __future__ import annotations

import importlib.util
from pathlib import Path

# Of P. Corke's Robotics Toolbox for Python: robot models, and the few recordings read here.
RTB = "rtbdata"
RTB_MISSING = (
    "the package rtb-data, which carries {0}, is not installed; `pip install 'rtb-data>=2.0'`, or "
    "give the file's path"
)


def find(package: str, file: str) -> Path | None:
    """A file of a package; None where the package, or the file in it, is not there."""
    spec = importlib.util.find_spec(package)
    folders = spec.submodule_search_locations if spec else None
    paths = [Path(folder) / file for folder in folders or ()]
    return next((path for path in paths if path.is_file()), None)
