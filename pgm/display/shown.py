"""Values in a few words, by component, and how they show themselves."""

from __future__ import annotations

import math
import reprlib
from collections.abc import Callable, Iterable, Sequence
from html import escape
from importlib import import_module
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from pgm.display.summary import ALL, LEFT_OUT, Listing, Place, Summary, few, one_line, places
from pgm.errors import ArrayError

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

    Those of one quantity, `alike`, have as many decimals where that is legible.
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
    """The numbers of one value in one cell; states by their indices."""
    found = np.ravel(values)
    text = ", ".join(number(value) for value in found[:VECTOR])
    return text + f", {LEFT_OUT}" * (found.size > VECTOR)


def as_numbers(values: Any) -> npt.NDArray[Any] | None:
    """Values as an array of numbers, if they are such; None of others."""
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


class Shown:
    """A value that is printed as its `_summary`, in text and HTML; `_title` is its first line."""

    __slots__ = ()

    @property
    def _title(self) -> str:
        raise NotImplementedError(f"{type(self).__name__} has no title")

    def _summary(self) -> Summary:
        return Summary(self._title)

    def __repr__(self) -> str:
        return self._summary().text()

    def _repr_html_(self) -> str:
        return self._summary().html()


def titled(value: object) -> str:
    """A value of any kind in one line, for messages."""
    return value._title if isinstance(value, Shown) else brief(value)


class InCode:
    """A small value, like a choice of parameters, whose text in HTML is that in a terminal."""

    __slots__ = ()

    def _repr_html_(self) -> str:
        return f"<code>{escape(repr(self))}</code>"


class NoArray:
    """A value that NumPy would else put into an array of objects, without a word.

    Those that are asked for, as columns of a data frame are, may hold it.
    """

    __slots__ = ()

    # What to take instead, for the message.
    _arrays: ClassVar[str] = ".mean and .cov"

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> npt.NDArray[np.object_]:
        if dtype is not None and np.dtype(dtype) == object:
            held = np.empty((), dtype=object)
            held[()] = self
            return held
        raise ArrayError(f"a {type(self).__name__} is no array; take its {self._arrays}")


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
        pictures = import_module("pgm.plot.diagrams.notebook")
    except ImportError as error:
        if (error.name or "").partition(".")[0] != "matplotlib":
            raise
        return ""
    found: str = pictures.svg(value)
    return found


Array = npt.NDArray[np.float64]
# The most components beside each other, and of how many correlations are shown.
WIDE, CORRELATED = 12, 6


def by_component(names: Sequence[str], mean: Array, cov: Array) -> Listing:
    """One belief: its mean and deviation, a row a component, and where few their correlations."""
    std = deviations(cov)
    shown = few(len(names))
    kept = [k for k in shown if k is not None]
    # Each component has units of its own, and so its own decimals.
    cells = dict(
        zip(kept, beside(mean[kept].tolist(), std[kept].tolist(), alike=False), strict=True)
    )
    heads, rest = ["", "mean ± deviation"], correlations(cov, std) if len(names) > 1 else None
    if rest is not None:
        heads += ["correlations", *[""] * (len(names) - 2)]
    rows: list[Sequence[str] | None] = []
    for k in shown:
        if k is None:
            rows.append(None)
        elif rest is None:
            rows.append([names[k], cells[k]])
        else:
            below = [_correlation(rest[k, j]) for j in range(k)]
            rows.append([names[k], cells[k], *below, *[""] * (len(names) - 1 - k)])
    return Listing(heads, rows)


def stacked(
    names: Sequence[str],
    lead: tuple[int, ...],
    steps: Sequence[int] | npt.NDArray[Any] | None,
    moments: Callable[[Place], tuple[Array, Array]],
    most: int = ALL,
) -> Listing:
    """Many beliefs: a row each of the first and the last, with means and deviations.

    `lead` are runs and `steps`; the moments at a place of these are asked for of those shown alone.
    """
    shown = places(lead, most)
    found = {place: moments(place) for place in shown if place is not None}
    columns = []
    for k in range(min(len(names), WIDE)):
        means = [mean[k] for mean, _ in found.values()]
        spreads = [float(deviations(cov[k : k + 1, k : k + 1])[0]) for _, cov in found.values()]
        columns.append(dict(zip(found, beside(means, spreads), strict=True)))
    heads, where = whereabouts(lead, steps)
    more = [f"{LEFT_OUT} {len(names)} in all"] * (len(names) > WIDE)
    rows: list[Sequence[str] | None] = []
    for place in shown:
        if place is None:
            rows.append(None)
        else:
            rows.append([*where(place), *(column[place] for column in columns), *[""] * len(more)])
    return Listing([*heads, *names[:WIDE], *more], rows, names=len(heads))


def whereabouts(
    lead: tuple[int, ...], steps: Sequence[int] | npt.NDArray[Any] | None
) -> tuple[list[str], Callable[[Place], list[str]]]:
    """The heads of the columns that tell run and step, and their cells at a place."""
    runs = len(lead) - (steps is not None)
    heads = ["run"] * (runs > 0) + ["step"] * (steps is not None)

    def cells(place: Place) -> list[str]:
        found = [", ".join(map(str, place[:runs]))] if runs else []
        return found if steps is None else [*found, str(int(steps[place[-1]]))]

    return heads, cells


def axes(lead: tuple[int, ...], steps: Sequence[int] | npt.NDArray[Any] | None) -> str:
    """Leading axes in words, behind a comma: ``, runs (100,), steps 0..60``."""
    runs = lead if steps is None else lead[:-1]
    text = f", runs {runs}" if runs else ""
    if steps is None:
        return text
    found = np.asarray(steps)
    if not found.size or (np.diff(found) != 1).any():
        return f"{text}, {count(found.size, 'step')}"
    return f"{text}, steps {found[0]}..{found[-1]}"


def deviations(cov: Array) -> Array:
    """The roots of the variances, NaN of negative ones."""
    with np.errstate(invalid="ignore"):
        return np.asarray(np.sqrt(np.diagonal(cov, axis1=-2, axis2=-1)))


def correlations(cov: Array, std: Array) -> Array | None:
    """The correlations of a few components; None where they are many, or none is correlated."""
    if len(std) > CORRELATED or not np.isfinite(cov).all() or not (std > 0.0).any():
        return None
    with np.errstate(invalid="ignore", divide="ignore"):
        found = cov / np.outer(std, std)
    apart = found[~np.eye(len(std), dtype=bool)]
    return found if (np.abs(np.nan_to_num(apart)) >= 0.005).any() else None


def _correlation(value: float) -> str:
    return "" if np.isnan(value) else f"{round(value, 2) + 0.0:.2f}"


# The most rows and columns of which all are shown.
ROWS, COLUMNS = 7, 7


def named_matrix(
    rows: Sequence[str],
    columns: Sequence[str],
    values: npt.NDArray[Any],
    symbol: str,
    before: Sequence[tuple[str, npt.NDArray[Any]]] = (),
) -> Listing:
    """A matrix with the names of its rows and columns and its symbol, behind other columns."""
    shown = few(len(rows), ROWS)
    kept = [k for k in shown if k is not None]
    heads, cells = [""], [[rows[k] for k in kept]]
    for name, vector in before:
        heads.append(name)
        cells.append([number(value) for value in vector[kept]])
    for k, name in enumerate(columns[:COLUMNS]):
        heads.append(name if k else f"{symbol}: {name}")
        cells.append(column(values[kept, k]))
    if len(columns) > COLUMNS:
        heads.append(LEFT_OUT)
        cells.append([LEFT_OUT] * len(kept))
    found = dict(zip(kept, zip(*cells, strict=True), strict=True))
    return Listing(heads, [None if k is None else found[k] for k in shown])
