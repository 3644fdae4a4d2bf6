"""Beliefs of a user's own family that nobody changes: arrays are read-only, the rest is copied.

The beliefs of all steps are kept, and one that a later step changed in place would show as what it
became.
"""

from __future__ import annotations

from collections.abc import Mapping
from copy import copy
from types import ModuleType
from typing import Any

import numpy as np

# A belief is looked through so deep: tuples, lists, mappings, and attributes of objects.
_DEPTH = 4


def sealed(belief: Any, depth: int = _DEPTH) -> Any:
    """The same belief, whose arrays are read-only from now on."""
    if isinstance(belief, np.ndarray):
        belief.flags.writeable = False
    elif depth and isinstance(belief, Mapping):
        for each in belief.values():
            sealed(each, depth - 1)
    elif depth and isinstance(belief, tuple | list):
        for each in belief:
            sealed(each, depth - 1)
    elif depth and hasattr(belief, "__dict__"):
        for each in vars(belief).values():
            sealed(each, depth - 1)
    return belief


def handed_out(belief: Any, depth: int = _DEPTH) -> Any:
    """A belief for a method that may change it: lists, mappings and objects in it are copies."""
    if not depth or isinstance(belief, np.ndarray | type | ModuleType):
        return belief
    if isinstance(belief, tuple):
        parts = [handed_out(each, depth - 1) for each in belief]
        if all(new is old for new, old in zip(parts, belief, strict=True)):
            return belief
        return type(belief)(*parts) if hasattr(belief, "_fields") else type(belief)(parts)
    if isinstance(belief, list):
        return type(belief)(handed_out(each, depth - 1) for each in belief)
    if isinstance(belief, dict):
        found = copy(belief)
        found.update({key: handed_out(each, depth - 1) for key, each in belief.items()})
        return found
    if not hasattr(belief, "__dict__"):
        return belief
    found = copy(belief)
    if found is not belief:
        vars(found).update({k: handed_out(v, depth - 1) for k, v in vars(belief).items()})
    return found
