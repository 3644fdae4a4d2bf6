"""Colours that the colour-blind can tell apart, chosen by what an axes already shows."""

from __future__ import annotations

from typing import Any

from matplotlib.axes import Axes
from matplotlib.collections import EllipseCollection
from matplotlib.colors import to_hex

# Okabe and Ito (2008), without black, which is the truth's, and yellow, which white swallows.
PALETTE = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")

INK = "#222222"
MUTED = "#767676"
OBSERVED = "#D0D0D0"
CLUSTER = "#E9F2F9"
SEPSET = "#FCEBD2"


def next_colour(ax: Axes) -> str:
    """The first colour of the palette that no line and no ellipse of an axes has yet."""
    shown: list[Any] = [line.get_color() for line in ax.lines]
    for collection in ax.collections:
        if isinstance(collection, EllipseCollection):
            shown += list(collection.get_edgecolor()[:1])
    used = {to_hex(colour) for colour in shown}
    for colour in PALETTE:
        if to_hex(colour) not in used:
            return colour
    return PALETTE[len(ax.lines) % len(PALETTE)]
