"""Refusals of objects that cannot be pickled, by name."""

from __future__ import annotations

import pickle
from collections.abc import Sequence
from typing import Any

from pgm.errors import ModelError
from pgm.immutable import Immutable


def refuse(named: Sequence[Any], error: Exception) -> ModelError:
    """The error that says which of some objects cannot be pickled, and which part of it."""
    for each in named:
        fault = _fault(each)
        if fault is None:
            continue
        parts = each.__getstate__() if isinstance(each, Immutable) else {}
        parts = {name: value for name, value in parts.items() if _fault(value) is not None}
        part = next((f"the {name} of " for name in parts), "")
        child = getattr(each, "child", None)
        return ModelError(
            f"{part}{each!r} cannot be handed to another process: {fault}; let it be a function or "
            "a class that stands in a module by name, no lambda and none within a function, or "
            "give a ThreadPoolExecutor",
            variable=child,
            cpd=each if child is not None else None,
        )
    return ModelError(f"what the workers would be handed cannot be pickled: {error}")


def _fault(value: Any) -> str | None:
    """Why a value cannot be pickled; None if it can."""
    try:
        pickle.dumps(value)
    except Exception as error:
        return f"{type(error).__name__}: {error}"
    return None
