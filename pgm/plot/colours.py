"""Colours that the colour-blind can tell apart, chosen by what an axes already shows."""

from __future__ import annotations

from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import EllipseCollection, PathCollection
from matplotlib.colors import to_hex

# Okabe and Ito (2008), without black, which is the truth's, and yellow, which white swallows.
PALETTE = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")

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


def next_colour(ax: Axes) -> str:
    """The first colour of the palette that no line, ellipse or point of an axes has yet."""
    shown: list[Any] = [line.get_color() for line in ax.lines]
    for collection in ax.collections:
        if isinstance(collection, EllipseCollection):
            shown += list(collection.get_edgecolor()[:1])
        elif isinstance(collection, PathCollection):
            shown += list(collection.get_facecolor()[:1])
    used = {to_hex(colour) for colour in shown}
    for colour in PALETTE:
        if to_hex(colour) not in used:
            return colour
    return PALETTE[len(ax.lines) % len(PALETTE)]
