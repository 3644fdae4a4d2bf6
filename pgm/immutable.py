"""Values that cannot be changed, but can be copied and pickled."""

from __future__ import annotations

from collections.abc import Callable
from types import MappingProxyType
from typing import Any

import numpy as np

# As `array.setflags(write=...)`, of whose time the name of the argument takes two thirds.
set_writeable: Callable[[Any, bool], None] = np.ndarray.setflags  # type: ignore[assignment]


class Immutable:
    """Base of values whose attributes are set once, by `_set`, while they are made."""

    __slots__ = ()

    def _set(self, **values: Any) -> None:
        for name, value in values.items():
            object.__setattr__(self, name, value)

    def __setattr__(self, name: str, value: Any) -> None:
        raise AttributeError(
            f"a {type(self).__name__} is immutable; make a new one to change {name}"
        )

    def __getstate__(self) -> dict[str, Any]:
        slots = [name for cls in type(self).__mro__ for name in getattr(cls, "__slots__", ())]
        filled = {name: getattr(self, name) for name in slots if hasattr(self, name)}
        state = filled | getattr(self, "__dict__", {})
        # Read-only views of mappings cannot be pickled: they travel as what they show.
        return {
            name: value.copy() if isinstance(value, MappingProxyType) else value
            for name, value in state.items()
        }

    def __setstate__(self, state: dict[str, Any]) -> None:
        self._set(**{name: _closed(value) for name, value in state.items()})


def unlocked(cls: Any) -> Any:
    """A subclass whose attributes can be set; a value made of it is given its own class last.

    It takes no arguments. That takes a third of the time of `_set`, and two thirds of that of
    `object.__new__`, for values that are made at each step online.
    """
    plain = {"__setattr__": object.__setattr__, "__init__": object.__init__}
    return type(cls.__name__, (cls,), {"__slots__": (), **plain})


def _closed(value: Any) -> Any:
    """A value that came out of a pickle, where it is neither a view nor read-only."""
    if isinstance(value, dict):
        return MappingProxyType(value)
    if isinstance(value, np.ndarray):
        value.flags.writeable = False
    return value
