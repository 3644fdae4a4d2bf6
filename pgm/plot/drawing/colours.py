"""Colours that the colour-blind can tell apart, and dashes."""

from collections import Counter
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import EllipseCollection, PathCollection
from matplotlib.colors import to_hex

# Okabe and Ito (2008), without black, which is the truth's, and yellow, which white swallows.
PALETTE = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")

# Where all colours are taken they begin again, with other dashes or marks.
DASHES = ("-", "--", ":", "-.")
_MARKS = (".", "s", "^", "x")

INK = "#222222"
MUTED = "#767676"
OBSERVED = "#D0D0D0"
CLUSTER = "#E9F2F9"
SEPSET = "#FCEBD2"

# Perceptually uniform, so that it reads in grey too; more is darker.
SCALE = matplotlib.colormaps["viridis_r"]

# Of probabilities, so that what cannot be is white.
CHANCE = matplotlib.colormaps["Blues"]


def readable_on(colour: tuple[float, float, float, float]) -> str:
    """Black or white, whichever stands out more on a colour (contrast of WCAG 2: 4.5 or more)."""
    channels = np.array(colour[:3], dtype=float)
    linear = np.where(channels <= 0.04045, channels / 12.92, ((channels + 0.055) / 1.055) ** 2.4)
    return "black" if linear @ [0.2126, 0.7152, 0.0722] > 0.179 else "white"


class Look(NamedTuple):
    """The colour of a series, and the style of its lines: ``-``, ``--``, ``:`` or ``-.``."""

    colour: str
    dash: str

    @property
    def mark(self) -> str:
        """A marker for series of points alone, which no dash tells apart."""
        return _MARKS[DASHES.index(self.dash)]


def next_look(ax: Axes) -> Look:
    """The first look that no series of an axes has yet: all colours, then dashed, then dotted."""
    used = Counter(_looks(ax))
    every = [Look(colour, dash) for dash in DASHES for colour in PALETTE]
    return min(every, key=lambda look: used[look])  # the first of those used least


def next_colour(ax: Axes) -> str:
    """The first of the colours that an axes has least of."""
    used = Counter(look.colour for look in _looks(ax))
    return min(PALETTE, key=lambda colour: used[colour])


def look_of(ax: Axes, colour: str | None) -> Look:
    """A solid look of a colour; the next without."""
    return next_look(ax) if colour is None else Look(colour, DASHES[0])


def _looks(ax: Axes) -> Iterator[Look]:
    for line in ax.lines:
        dash, mark = str(line.get_linestyle()), line.get_marker()
        if dash not in DASHES:
            dash = DASHES[_MARKS.index(mark)] if mark in _MARKS else DASHES[0]
        yield _look(line.get_color(), dash)
    for collection in ax.collections:
        if isinstance(collection, EllipseCollection):
            styles: Any = collection.get_linestyle()  # an offset and a pattern each
            for colour, style in zip(collection.get_edgecolor()[:1], styles[:1], strict=True):
                yield _look(colour, _dash(style[1]))
        elif isinstance(collection, PathCollection):
            yield from (_look(colour, DASHES[0]) for colour in collection.get_facecolor()[:1])


def _look(colour: Any, dash: str) -> Look:
    return Look(to_hex(colour).upper(), dash)


def _dash(pattern: Sequence[float] | None) -> str:
    if not pattern:
        return DASHES[0]
    if len(pattern) > 2:
        return DASHES[3]
    return DASHES[1] if pattern[0] > pattern[1] else DASHES[2]
