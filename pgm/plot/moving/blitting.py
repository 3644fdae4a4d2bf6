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
        self._size = (0, 0)

    def draw(self) -> None:
        """Draw the picture: the first time all of it, later what changes."""
        size = self.get_width_height()  # which a writer may change to even numbers
        if self._kept is None or self._size != size:
            self._keep_rest()
            self._size = size
        canvas: Any = self  # whose methods have no types in matplotlib
        canvas.restore_region(self._kept)
        for artist in self._changing:
            axes: Any = artist.axes
            axes.draw_artist(artist)

    def _keep_rest(self) -> None:
        visible = [artist.get_visible() for artist in self._changing]
        for artist in self._changing:
            artist.set_visible(False)
        canvas: Any = super()
        canvas.draw()
        self._kept = canvas.copy_from_bbox(self.figure.bbox)
        for artist, shown in zip(self._changing, visible, strict=True):
            artist.set_visible(shown)

    def print_rgba(self, filename_or_obj: Any, **_: Any) -> None:
        """Write the picture as writers of movies read it."""
        canvas: Any = self
        canvas.draw()
        filename_or_obj.write(canvas.buffer_rgba())
