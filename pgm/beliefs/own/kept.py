"""Beliefs of a user's own family that nobody changes: those that are kept are copies.

The beliefs of all steps are kept, and one that a later step changed in place would show as what it
became.
"""

from __future__ import annotations

from copy import deepcopy
from typing import TYPE_CHECKING, Any

import numpy as np

from pgm.errors import ModelError

if TYPE_CHECKING:
    from pgm.beliefs.own.family import BeliefFamily


def kept(family: BeliefFamily[Any], method: str, belief: Any) -> Any:
    """A copy of what a family's method has returned, whose arrays are read-only.

    A belief that is None, as of a method that returns nothing, or that cannot be copied is refused
    by a ModelError.
    """
    if belief is None:
        raise ModelError(f"{family!r}: {method} returned None; a belief was due")
    try:
        copy = deepcopy(belief)
    except Exception as error:  # of any kind, by what the belief refers to
        raise ModelError(
            f"{family!r}: the belief that {method} returned cannot be copied, as those of all "
            f"steps are: {type(error).__name__}: {error}; make it of arrays and numbers"
        ) from error
    return _closed(copy)


def _closed(belief: Any) -> Any:
    """The same belief; its arrays, where they stand in tuples alone, are read-only from now on."""
    if isinstance(belief, np.ndarray):
        belief.flags.writeable = False
    elif isinstance(belief, tuple):
        for each in belief:
            _closed(each)
    return belief


def handed_out(belief: Any) -> Any:
    """A belief for a method that may change it: a copy, but of arrays, which are read-only."""
    return belief if _is_closed(belief) else deepcopy(belief)


def _is_closed(belief: Any) -> bool:
    """Whether a belief cannot be changed: numbers, read-only arrays, and tuples of these."""
    if isinstance(belief, tuple):
        return all(map(_is_closed, belief))
    return isinstance(belief, np.ndarray | np.generic | float | int | str | None)
