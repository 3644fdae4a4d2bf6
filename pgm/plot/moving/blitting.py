"""A canvas that draws anew what changes alone, and keeps the rest as it was."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from matplotlib.artist import Artist
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure


class BlittedCanvas(FigureCanvasAgg):
    """The canvas of a figure most of which stays as it is from picture to picture.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
    changing : sequence of Artist
        Drawn in each picture, in this order; the rest is drawn once.
    """

    def __init__(self, figure: Figure, changing: Sequence[Artist] = ()) -> None:
        super().__init__(figure)
        self._changing = changing
        self._kept: Any = None

    def draw(self) -> None:
        """Draw the picture: the first time all of it, later what changes."""
        if self._kept is None:
            for artist in self._changing:
                artist.set_animated(True)
            super().draw()
            self._kept = self.copy_from_bbox(self.figure.bbox)
        self.restore_region(self._kept)
        for artist in self._changing:
            artist.axes.draw_artist(artist)

    def print_rgba(self, filename_or_obj: Any, **_: Any) -> None:
        """Write the picture as writers of movies read it."""
        self.draw()
        filename_or_obj.write(self.buffer_rgba())
