"""Values that show themselves: in a terminal, in a notebook, and not as arrays."""

from __future__ import annotations

from html import escape
from reprlib import recursive_repr
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from pgm.display.brief import brief
from pgm.display.summary import Summary
from pgm.errors import ArrayError


class Shown:
    """A value displayed by its `_summary`, in text and HTML, under its `_title`."""

    __slots__ = ()

    @property
    def _title(self) -> str:
        raise NotImplementedError(f"{type(self).__name__} has no title")

    def _summary(self) -> Summary:
        return Summary(self._title)

    def __repr__(self) -> str:
        return self._summary().text()

    def _repr_html_(self) -> str:
        return self._summary().html()


def titled(value: object) -> str:
    """A value of any kind in one line, for messages."""
    return value._title if isinstance(value, Shown) else brief(value)


class InCode:
    """A small value, like a choice of parameters, whose text in HTML is that in a terminal."""

    __slots__ = ()

    def _repr_html_(self) -> str:
        return f"<code>{escape(repr(self))}</code>"


class ByAttributes(InCode):
    """A value of a class that users extend: it shows its attributes, whoever wrote `__init__`."""

    __slots__ = ()

    @recursive_repr()
    def __repr__(self) -> str:
        given = ", ".join(f"{name}={brief(value)}" for name, value in vars(self).items())
        return f"{type(self).__name__}({given})"


class NoArray:
    """A value that NumPy refuses to put silently into an array of objects.

    An array of objects that is asked for, such as a data frame's column, may hold it.
    """

    __slots__ = ()

    # What to take instead, for the message.
    _arrays: ClassVar[str] = ".mean and .cov"

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> npt.NDArray[np.object_]:
        if dtype is not None and np.dtype(dtype) == object:
            held = np.empty((), dtype=object)
            held[()] = self
            return held
        raise ArrayError(f"{articled(self)} is no array; take its {self._arrays}")


def articled(value: object) -> str:
    """The name of a value's class with its article, "an OnlineBelief"."""
    name = type(value).__name__
    return f"{'an' if name[0] in 'AEIOUaeiou' else 'a'} {name}"
