"""One-line text of values: numbers rounded to their accuracy, arrays by shape."""

from __future__ import annotations

import math
import reprlib
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from pgm.display.summary import LEFT_OUT, Listing, one_line, places

# Significant digits of a number, and of a deviation.
DIGITS = 4
SURE = 3
# Sizes from and up to which a number is written without an exponent.
SMALL, LARGE = 1e-4, 1e6
# Decimals, beyond which a column is no longer written with as many in each row.
DECIMALS = 7
# The most digits that float64 has.
MOST = 16


def number(value: float, digits: int = DIGITS) -> str:
    """A number to some significant digits; its whole part is never rounded below a million."""
    value = float(value) + 0.0  # there is no minus zero here
    if not math.isfinite(value) or value == 0.0:
        return f"{value:g}"
    size = abs(value)
    if SMALL <= size < LARGE:
        text = f"{value:.{max(digits - 1 - _power(size), 0)}f}"
        return text.rstrip("0").rstrip(".") if "." in text else text
    return f"{value:.{digits}g}"


def column(values: Iterable[float], digits: int = DIGITS) -> list[str]:
    """Numbers that stand below each other, with equally many decimals where that is legible."""
    found = [float(value) + 0.0 for value in values]
    sizes = [abs(value) for value in found if math.isfinite(value) and value]
    if not sizes:
        return [f"{value:g}" for value in found]
    if max(sizes) < LARGE and min(sizes) >= SMALL:
        decimals = max(digits - 1 - _power(max(sizes)), 1 - _power(min(sizes)), 0)
        if decimals <= DECIMALS:
            return _shortened([_fixed(value, decimals) for value in found])
    return [number(value, digits) for value in found]


def beside(means: Sequence[float], deviations: Sequence[float], *, alike: bool = True) -> list[str]:
    """Means with their deviations, ``12.346 ± 0.123``: three digits of the deviation, no more.

    Numbers of one quantity (`alike`) have equally many decimals where that is legible.
    """
    pairs = [(float(mean) + 0.0, float(std)) for mean, std in zip(means, deviations, strict=True)]
    known = [std for _, std in pairs if math.isfinite(std) and std > 0.0]
    largest = max((abs(part) for pair in pairs for part in pair if math.isfinite(part)), default=0)
    decimals = max((SURE - 1 - _power(std) for std in known), default=0)
    if alike and known and largest < LARGE and decimals <= DECIMALS:
        decimals = max(decimals, 0)
        cells = [(_fixed(mean, decimals), _fixed(std, decimals)) for mean, std in pairs]
    else:
        cells = [_pair(mean, std) for mean, std in pairs]
    wide = [max((len(cell[k]) for cell in cells), default=0) for k in (0, 1)]
    return [f"{mean:>{wide[0]}} ± {std:>{wide[1]}}" for mean, std in cells]


def count(number: int, word: str, many: str = "") -> str:
    """A number of things: ``1 run``, ``1,000 runs``."""
    return f"{number:,} {word if number == 1 else many or word + 's'}"


def _pair(mean: float, std: float) -> tuple[str, str]:
    if not (math.isfinite(std) and std > 0.0 and math.isfinite(mean)):
        return number(mean, MOST if std == 0.0 else DIGITS), number(std)
    decimals = SURE - 1 - _power(std)
    largest = max(abs(mean), std)
    if largest < LARGE and decimals <= DECIMALS:
        return _fixed(mean, max(decimals, 0)), _fixed(std, max(decimals, 0))
    if mean == 0.0:
        return "0", number(std, SURE)
    digits = _power(mean) + decimals
    return f"{mean:.{min(max(digits, 0), MOST - 1)}e}", f"{std:.{SURE - 1}e}"


def _fixed(value: float, decimals: int) -> str:
    if value == 0.0 or not math.isfinite(value):
        return f"{value:g}"
    text = f"{value:.{decimals}f}"
    return text.removeprefix("-") if float(text) == 0.0 else text


def _shortened(texts: list[str]) -> list[str]:
    broken = [text for text in texts if "." in text]
    zeros = min((len(text) - len(text.rstrip("0")) for text in broken), default=0)
    if not zeros:
        return texts
    return [text[:-zeros].removesuffix(".") if "." in text else text for text in texts]


def _power(size: float) -> int:
    return math.floor(math.log10(abs(size)))


# Numbers that are listed, and those of a vector in one cell.
LISTED, VECTOR = 12, 4
_SHORT = reprlib.Repr()
_SHORT.maxlist = _SHORT.maxtuple = _SHORT.maxdict = _SHORT.maxset = 4
_SHORT.maxstring = _SHORT.maxother = 60


def brief(value: Any) -> str:
    """A value in a few words."""
    if isinstance(value, np.ndarray):
        if value.size <= LISTED and value.dtype.kind in "iufb":
            text = str(value.tolist())
            return f"array({text})" if value.ndim else text
        return f"array of shape {value.shape}"
    return one_line(_SHORT.repr(value))


def called(function: Any) -> str:
    """A function by its name, or another callable by its class."""
    return one_line(getattr(function, "__name__", type(function).__name__))


def vector(values: npt.NDArray[Any]) -> str:
    """A value's numbers in one table cell; states by their indices."""
    found = np.ravel(values)
    text = ", ".join(number(value) for value in found[:VECTOR])
    return text + f", {LEFT_OUT}" * (found.size > VECTOR)


def as_numbers(values: Any) -> npt.NDArray[Any] | None:
    """Values as an array of numbers; None if they are not numbers."""
    if isinstance(values, list | tuple | range):
        try:
            values = np.asarray(values)
        except (TypeError, ValueError, OverflowError):
            return None
    return values if isinstance(values, np.ndarray) and values.dtype.kind in "iuf" else None


def table(columns: Sequence[tuple[str, Any]], digits: int = DIGITS) -> Listing:
    """The first and last rows of columns of numbers, (n,) or (n, d) each, n as of the first.

    The first column has its own number of digits.
    """
    count = len(columns[0][1])
    shown = places((count,))
    rows = [place[0] for place in shown if place is not None]
    heads, cells = [], []
    for head, values in columns:
        array = as_numbers(values)
        if array is None or array.ndim not in (1, 2) or len(array) != count:
            heads.append(head)
            cells.append([brief(array if array is not None else values)] * len(rows))
            continue
        wide = array[:, None] if array.ndim == 1 else array
        for k in range(min(wide.shape[1], 2 * VECTOR)):
            heads.append(head if not k else "")
            cells.append(column(wide[rows, k], DIGITS if cells else digits))
    found = dict(zip(rows, zip(*cells, strict=True), strict=True))
    return Listing(heads, [None if at is None else found[at[0]] for at in shown], names=0)
