"""Moving pictures as files, written whole or not at all; GIFs with one palette for all pictures."""

from collections.abc import Callable, Sequence
from io import BytesIO
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.animation import AbstractMovieWriter, FFMpegWriter
from matplotlib.artist import Artist
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from PIL import Image

from pgm.boundary import is_number
from pgm.errors import ModelError
from pgm.io.sources import whole
from pgm.plot.drawing.colours import INK, MUTED
from pgm.plot.drawing.colours import PALETTE as COLOURS

_COLOURS = 256
# Colours chosen for the first picture; the others are free for colours that later pictures bring.
_FIRST = 128
# A new colour of so many pixels, so far from all of the palette in one channel, enters it while
# there is room; those of fewer are the blurred borders of shapes.
_OFTEN, _FAR = 8, 5
# The colours of lines are kept as they are, however thin the first lines are.
_LINES = np.array([to_rgb(c) for c in ("white", "black", INK, MUTED, *COLOURS)]) * 255.0
# Red, green and blue of a pixel that is read as one number.
_SHIFTS = np.array([0, 8, 16], dtype=np.uint32)
_OPAQUE = 0xFFFFFF


class Palette:
    """Up to 256 colours, and the nearest of them to each colour of the pictures.

    first: The picture, in RGB, for which the first colours are chosen.
    """

    def __init__(self, first: Image.Image) -> None:
        cut = first.quantize(_FIRST, Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE)
        chosen = np.array(cut.getpalette(), dtype=np.int16).reshape(-1, 3)[:_FIRST]
        self._colours = np.concatenate([np.rint(_LINES).astype(np.int16), chosen])
        self._nearest = np.full(1 << 24, -1, dtype=np.int16)

    @property
    def flat(self) -> list[int]:
        """All channels after one another."""
        values: list[int] = self._colours.reshape(-1).tolist()
        return values

    def indices(self, pixels: npt.NDArray[np.uint32]) -> npt.NDArray[np.uint8]:
        """The index of the colour of each pixel, which is a number of four bytes, RGBA."""
        codes = pixels & _OPAQUE
        found = self._nearest[codes]
        if (unmet := found < 0).any():
            self._meet(*np.unique(codes[unmet], return_counts=True))
            found = self._nearest[codes]
        indices: npt.NDArray[np.uint8] = found.astype(np.uint8)
        return indices

    def _meet(self, codes: npt.NDArray[np.uint32], counts: npt.NDArray[np.intp]) -> None:
        new = (codes[:, None] >> _SHIFTS & 255).astype(np.int16)
        often = new[counts >= _OFTEN]
        while len(often) and len(self._colours) < _COLOURS:
            away = _apart(often, self._colours).min(axis=1)
            if away.max() < _FAR:
                break
            self._colours = np.concatenate([self._colours, often[away.argmax()][None]])
        self._nearest[codes] = _apart(new, self._colours).argmin(axis=1)


def _apart(a: npt.NDArray[np.int16], b: npt.NDArray[np.int16]) -> npt.NDArray[np.int16]:
    found: npt.NDArray[np.int16] = np.abs(a[:, None] - b).max(axis=-1)
    return found


class GifWriter(AbstractMovieWriter):
    """A GIF that keeps an index a pixel, of a palette that all pictures share.

    A part that stays as it is from picture to picture is then written once. Matplotlib's own writer
    keeps four channels of all pictures until the end, and chooses the colours of each apart.
    """

    @classmethod
    def isAvailable(cls) -> bool:
        """Whether it can write: always."""
        return True

    def setup(self, fig: Figure, outfile: str | PathLike[str], dpi: float | None = None) -> None:
        """Begin a file."""
        super().setup(fig, Path(outfile), dpi)
        self._palette: Palette | None = None
        self._pictures: list[Image.Image] = []

    def grab_frame(self, **savefig_kwargs: Any) -> None:
        """Add the figure, as it looks now, to the film as one frame."""
        drawn = BytesIO()
        self.fig.savefig(drawn, **savefig_kwargs, format="rgba", dpi=self.dpi)
        width, height = self.frame_size
        pixels = np.frombuffer(drawn.getbuffer(), "<u4").reshape(height, width)
        if self._palette is None:
            whole = Image.frombytes("RGBA", (width, height), drawn.getvalue())
            self._palette = Palette(whole.convert("RGB"))
        self._pictures.append(Image.fromarray(self._palette.indices(pixels)))

    def finish(self) -> None:
        """Write the pictures; the film begins again at its end."""
        if self._palette is None:
            return
        for picture in self._pictures:
            picture.putpalette(self._palette.flat)
        first, *others = self._pictures
        first.save(
            self.outfile,
            save_all=True,
            append_images=others,
            duration=round(1000 / self.fps),
            loop=0,
        )


_WRITERS: dict[str, Any] = {".gif": GifWriter, ".mp4": FFMpegWriter}


def movie_writer(path: str | PathLike[str], rate: float) -> AbstractMovieWriter:
    """The writer of a file of this kind, at some pictures a second."""
    if not is_number(rate) or not 0.0 < rate < np.inf:
        raise ModelError(f"rate is a number of pictures a second, above 0, not {rate!r}")
    path = Path(path)
    kind = _WRITERS.get(path.suffix.lower())
    if kind is None:
        raise ModelError(
            f"{path.name!r} is no moving picture that can be written: its name ends in .gif, or "
            "where there is ffmpeg in .mp4"
        )
    if not kind.isAvailable():
        raise ModelError(
            f"{path.name!r} needs the program ffmpeg, which is not found; install it, or write a "
            ".gif"
        )
    writer: AbstractMovieWriter = kind(fps=rate)
    return writer


def write_movie(
    writer: AbstractMovieWriter,
    path: str | PathLike[str],
    figure: Figure,
    draw: Callable[[int], None],
    count: int,
    dpi: int,
) -> Path:
    """Write a figure as it looks after ``draw(0)``, ``draw(1)``, …, ``draw(count - 1)``.

    The layout is that of the first picture, so that nothing shakes.

    dpi: Dots an inch.
    """
    target = Path(path)
    draw(0)  # a refusal comes before there is a file
    figure.canvas.draw()
    figure.set_layout_engine("none")
    with whole(target) as part, writer.saving(figure, str(part), dpi):
        writer.grab_frame()
        for k in range(1, count):
            draw(k)
            writer.grab_frame()
    return target


class BlittedCanvas(FigureCanvasAgg):
    """A canvas that redraws only what changes between pictures.

    changing: Drawn in each picture, in this order; the rest is drawn once.
    """

    def __init__(self, figure: Figure, changing: Sequence[Artist] = ()) -> None:
        super().__init__(figure)
        self._changing = changing
        self._kept: Any = None
        self._size = (0, 0)

    def draw(self) -> None:
        """Draw the whole picture the first time, later only the changes."""
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
