"""Rich display in notebooks; the pictures are made by `pgm.plot` and `pgm.viewer`.

A network is declared below the modules that draw it, and these load matplotlib. `pgm/__init__`,
which knows every layer, hands in what loads them; nothing is loaded before a notebook asks.
"""

from collections.abc import Callable
from typing import Any

from pgm.display.shown import Shown

# Loads a function from a value to markup; networks and graphs, and posteriors, have one each.
Loader = Callable[[], Callable[[Any], str]]
_loaders: dict[type, Loader] = {}


class Drawn(Shown):
    """A network or graph: text in a terminal, a picture above that text in a notebook."""

    __slots__ = ()

    def _repr_html_(self) -> str:
        return self._summary().html(picture(self))


class Viewed:
    """Base of results that a notebook shows as a page of their graph, beliefs and messages."""

    __slots__ = ()

    def _repr_html_(self) -> str:
        return _loaders[Viewed]()(self)


def hand_in(*, pictures: Loader, pages: Loader) -> None:
    """Take the loaders of the functions that draw a `Drawn` value, and write a `Viewed` one."""
    _loaders.update({Drawn: pictures, Viewed: pages})


def picture(value: Drawn) -> str:
    """The drawing of a network or graph, as markup of SVG; empty where matplotlib is missing."""
    try:
        draw = _loaders[Drawn]()
    except ImportError as error:
        if (error.name or "").partition(".")[0] != "matplotlib":
            raise
        return ""
    return draw(value)
