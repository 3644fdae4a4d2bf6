"""Versions, and the code that works figures out: they depend on these beside a study."""

from __future__ import annotations

import hashlib
import inspect
import marshal
import sys
from collections.abc import Callable
from functools import cache
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path
from typing import Any

# Experiments use each other, and these.
_BESIDE = {"experiments": ("models",)}
# The machinery of studies has no part in their figures.
_APART = "experiments.studies"


@cache
def versions(module: str) -> dict[str, str]:
    """Versions of packages, and a digest of the sources, of `pgm` and of a function's package.

    The script that was started has no name by which workers could find it, and is left out.
    """
    package = module.partition(".")[0]
    if package != "__main__":
        spec = find_spec(package)
        if spec is None or spec.origin is None:  # a mere folder of modules
            package = module
    names = {"pgm", package, *_BESIDE.get(package, ())} - {"__main__"}
    code = hashlib.sha256()
    for name in sorted(names):
        for path in _sources(name):
            code.update(path.name.encode())
            code.update(path.read_bytes())
    return {
        "python": f"{sys.version_info.major}.{sys.version_info.minor}",
        **{each: metadata.version(each) for each in ("sepset", "numpy", "scipy")},
        f"code of {' and '.join(sorted(names))}": code.hexdigest()[:16],
    }


def own_source(function: Callable[..., Any]) -> dict[str, str]:
    """A digest of the function's source, where it stands in the script that was started."""
    if function.__module__ != "__main__":
        return {}
    try:
        source = inspect.getsource(function).encode()
    except (OSError, TypeError):  # typed in
        source = marshal.dumps(function.__code__)
    return {f"source of {function.__qualname__}": hashlib.sha256(source).hexdigest()[:16]}


def _sources(package: str) -> list[Path]:
    """The sources of a package, or the file of a module."""
    spec = find_spec(package)
    if spec is None:
        return []
    apart = find_spec(_APART)
    left_out = set(apart.submodule_search_locations or ()) if apart else set()
    found = [Path(spec.origin)] if spec.origin and spec.origin.endswith(".py") else []
    for folder in spec.submodule_search_locations or ():
        found = sorted(Path(folder).rglob("*.py"))
    return [path for path in found if not left_out & {str(each) for each in path.parents}]


def differences(here: dict[str, str], there: dict[str, str]) -> str:
    """In which versions two differ, in words; empty where in none."""
    names = [*there, *(name for name in here if name not in there)]
    return "; ".join(
        f"{name} {there.get(name, 'none')}, here {here.get(name, 'none')}"
        for name in names
        if here.get(name) != there.get(name)
    )
