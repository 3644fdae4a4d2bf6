"""Rich display in notebooks, and pages; they are made by `pgm.plot` and `pgm.viewer`.

A network is declared below the modules that draw it, and these load matplotlib. `pgm/__init__`,
which knows every layer, hands in what loads them; nothing is loaded before a notebook asks.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from pgm.display.shown import Shown

# Loads a function from a value to markup; networks and graphs, and posteriors, have one each. Those
# of reports take a path and more.
Loader = Callable[[], Callable[..., Any]]
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
        markup: str = _loaders[Viewed]()(self)
        return markup


class Judged(Viewed):
    """A result that writes a report on itself, too."""

    __slots__ = ()

    def _report(self, *asked: Any) -> Path:
        written: Path = _loaders[Judged]()(self, *asked)
        return written


class Surveyed:
    """A result over many runs, which writes a report on them."""

    __slots__ = ()

    def _report(self, *asked: Any) -> Path:
        written: Path = _loaders[Surveyed]()(self, *asked)
        return written


def hand_in(*, pictures: Loader, pages: Loader, reports: Loader, surveys: Loader) -> None:
    """Take the loaders of functions that draw or write values, by the classes of this module."""
    _loaders.update({Drawn: pictures, Viewed: pages, Judged: reports, Surveyed: surveys})


def picture(value: Drawn) -> str:
    """The drawing of a network or graph, as markup of SVG; empty where matplotlib is missing."""
    try:
        draw = _loaders[Drawn]()
    except ImportError as error:
        if (error.name or "").partition(".")[0] != "matplotlib":
            raise
        return ""
    markup: str = draw(value)
    return markup
