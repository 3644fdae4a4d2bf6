"""Packages that may be missing, asked for when they are first needed."""

from __future__ import annotations

from importlib import import_module
from typing import Any

FRAMES = "sepset[frames]"


def optional(module: str, what: str, requirement: str) -> Any:
    """A module that may not be installed: `what` needs it, pip installs it by `requirement`."""
    try:
        return import_module(module)
    except ImportError as error:
        raise ImportError(
            f"{what} needs {module.partition('.')[0]}: pip install '{requirement}'", name=module
        ) from error
