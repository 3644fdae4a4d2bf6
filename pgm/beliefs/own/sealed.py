"""Beliefs of a user's own family that nobody changes: their arrays are made read-only."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

# A belief is looked through so deep: tuples, lists, mappings, and attributes of objects.
_DEPTH = 4


def sealed(belief: Any, depth: int = _DEPTH) -> Any:
    """The same belief, whose arrays are read-only from now on.

    The beliefs of all steps are kept, and one that a later step changed in place would show as what
    it became.
    """
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
