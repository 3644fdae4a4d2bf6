"""Checks of the numbers that schedules take, and of linearisers."""

from __future__ import annotations

from numbers import Real
from typing import Any, TypeGuard

import numpy as np

from pgm.errors import ModelError


def require_count(owner: object, name: str, value: object) -> None:
    """Refuse what is no whole number, 1 or more."""
    whole = isinstance(value, int | np.integer) and not isinstance(value, bool)
    if not whole or value < 1:  # type: ignore[operator]
        raise ModelError(f"{owner!r}: {name} must be a whole number, 1 or more, not {value!r}")


def require_tolerance(owner: object, tolerance: object) -> None:
    """Refuse what is no number, 0 or more."""
    if not is_number(tolerance) or not tolerance >= 0.0:
        raise ModelError(f"{owner!r}: a tolerance must be 0 or more, not {tolerance!r}")


def is_number(value: object) -> TypeGuard[float]:
    """Whether a value is a real number, and no bool."""
    return isinstance(value, Real) and not isinstance(value, bool)


def require_lineariser(lineariser: Any) -> None:
    """Refuse what cannot be called, and a rule that was not made."""
    if not callable(lineariser) or isinstance(lineariser, type):
        raise ModelError(f"{lineariser!r} is no lineariser; give one like pgm.Taylor()")
