"""Numbers in text, as the doubles nearest to what is written."""

from __future__ import annotations

import re
from array import array

# A stretch of a run of numbers, never cut within one; it bounds the memory of converting a run.
STRETCH = re.compile(r"[-+.0-9eE,\s]{1,65536}+[-+.0-9eE]*+")
WORD = re.compile(r"[^,\s]++")


def numbers(text: str, start: int, into: array[float]) -> int:
    """Append the numbers from a place on, which white space or commas keep apart.

    Returns
    -------
    int
        Where they end: at the first thing that is no number, or at the end of the text.
    """
    while stretch := STRETCH.match(text, start):
        held = len(into)
        try:
            into.extend(map(float, stretch[0].replace(",", " ").split()))
        except ValueError:
            del into[held:]
            for word in WORD.finditer(text, start, stretch.end()):
                try:
                    into.append(float(word[0]))
                except ValueError:
                    return word.start()
        start = stretch.end()
    return start


def whole(value: float, most: int = 2**31 - 1) -> int | None:
    """A number as a count or an index, if it is one."""
    return int(value) if 0 <= value <= most and value == int(value) else None
