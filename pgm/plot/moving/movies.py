"""Moving pictures as files, written whole or not at all."""

from __future__ import annotations

from collections.abc import Callable
from io import BytesIO
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.animation import AbstractMovieWriter, FFMpegWriter
from matplotlib.figure import Figure
from PIL import Image

from pgm.boundary import is_number
from pgm.errors import ModelError
from pgm.io.whole import whole


class GifWriter(AbstractMovieWriter):
    """A GIF whose pictures are brought to 256 colours as they come.

    Matplotlib's own writer keeps all four channels of every picture until the end, is slower, and
    chooses colours that are visibly others.
    """

    @classmethod
    def isAvailable(cls) -> bool:
        """Whether it can write: always."""
        return True

    def setup(self, fig: Figure, outfile: str | PathLike[str], dpi: float | None = None) -> None:
        """Begin a file."""
        super().setup(fig, outfile, dpi)
        self._pictures: list[Image.Image] = []

    def grab_frame(self, **savefig_kwargs: Any) -> None:
        """Take the figure as it is now."""
        drawn = BytesIO()
        self.fig.savefig(drawn, **savefig_kwargs, format="rgba", dpi=self.dpi)
        picture = Image.frombuffer("RGBA", self.frame_size, drawn.getbuffer(), "raw", "RGBA", 0, 1)
        few = {"method": Image.Quantize.MEDIANCUT, "dither": Image.Dither.NONE}
        self._pictures.append(picture.convert("RGB").quantize(256, **few))

    def finish(self) -> None:
        """Write the pictures; the film begins again at its end."""
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
    """The writer of a file of this kind, at some pictures a second.

    Raises
    ------
    ModelError
        If the rate is none, or the file is of another kind, or an MP4 and there is no ffmpeg.
    """
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

    Parameters
    ----------
    writer : matplotlib.animation.AbstractMovieWriter
    path : path
    figure : matplotlib.figure.Figure
    draw : callable
    count : int
    dpi : int
        Dots an inch.

    Returns
    -------
    pathlib.Path
        Of the file.
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
