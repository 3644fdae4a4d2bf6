"""Values that are a picture in a notebook."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from pgm.display.shown import Shown


class Drawn(Shown):
    """A network or graph: text in a terminal, a picture above that text in a notebook."""

    __slots__ = ()

    def _repr_html_(self) -> str:
        return self._summary().html(picture(self))


def picture(value: Any) -> str:
    """The drawing of a network or graph, as markup of SVG; empty where there is none."""
    try:
        # By name: drawing lies layers above the values drawn, and loads matplotlib, which is
        # wanted by notebooks alone.
        pictures = import_module("pgm.plot.notebook")
    except ImportError:
        return ""
    found: str = pictures.svg(value)
    return found
