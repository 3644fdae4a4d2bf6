"""Packages that may be missing, asked for when they are first needed."""

from __future__ import annotations

from importlib import import_module
from typing import Any

FRAMES = "sepset[frames]"


def optional(module: str, what: str, requirement: str) -> Any:
    """A module of a package that may not be installed.

    Parameters
    ----------
    module : str
    what : str
        The call that needs it, for the message.
    requirement : str
        What pip installs: an extra of this distribution, or the package.

    Raises
    ------
    ImportError
        If it is not installed, saying how to.
    """
    try:
        return import_module(module)
    except ImportError as error:
        raise ImportError(
            f"{what} needs {module.partition('.')[0]}: pip install '{requirement}'", name=module
        ) from error
