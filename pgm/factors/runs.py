"""The leading axes of values: the runs they broadcast to, and places along them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from itertools import combinations
from typing import Any

import numpy as np
import numpy.typing as npt

from pgm.display import Shown
from pgm.errors import EvidenceError, ModelError
from pgm.kernels.arrays import Mask, frozen

Shape = tuple[int, ...]
# The place of the first bad one, for messages.
Place = Callable[[Mask | np.bool_], str]


def common_runs(shapes: Iterable[tuple[object, Shape]]) -> Shape:
    """The axes of runs that all evidence broadcasts to; refuses axes that do not, and no runs."""
    found = tuple(shapes)
    try:
        lead = np.broadcast_shapes(*(shape for _, shape in found))
    except ValueError:
        raise EvidenceError(
            "the leading axes of the evidence do not broadcast to one set of runs: "
            f"{clash(found)}; give them the same, or 1"
        ) from None
    if 0 in lead:
        owner, shape = next((owner, shape) for owner, shape in found if 0 in shape)
        raise EvidenceError(f"the axes of runs of {owner} are {shape}: there is no run in it")
    return lead


def clash(shapes: Iterable[tuple[object, Shape]]) -> str:
    """The first two of some shapes that do not broadcast, and whose they are."""
    first: dict[Shape, object] = {}
    for owner, shape in shapes:
        first.setdefault(shape, owner)
    one, other = next(pair for pair in combinations(first, 2) if not _fit(*pair))
    return f"{first[one]} {one}, {first[other]} {other}"


def _fit(one: Shape, other: Shape) -> bool:
    pairs = zip(reversed(one), reversed(other), strict=False)
    return all(a == b or 1 in (a, b) for a, b in pairs)


def flat(array: npt.NDArray[Any], lead: Shape, own: int) -> npt.NDArray[Any]:
    """An array with the axes of runs as one; read-only, since users' functions see it."""
    cut = array.ndim - own
    rest = array.shape[cut:]
    runs = math.prod(array.shape[:cut])
    if runs > 1:
        runs = math.prod(lead)
        array = np.broadcast_to(array, (*lead, *rest))
    return frozen(np.ascontiguousarray(array.reshape(runs, *rest)))


def unflat(array: npt.NDArray[Any], lead: Shape, own: int) -> npt.NDArray[Any]:
    """An array (runs or 1, own axes) with its axes of runs."""
    rest = array.shape[array.ndim - own :]
    return np.broadcast_to(array, (math.prod(lead), *rest)).reshape((*lead, *rest))


def in_row(bad: Mask | np.bool_) -> str:
    """The place of the first bad one of rows, whose axis is the last, behind those of runs."""
    *runs, row = map(int, np.argwhere(bad)[0]) if np.ndim(bad) else (None,)
    if row is None:
        return ""
    of = f" of run {runs[0] if len(runs) == 1 else tuple(runs)}" if runs else ""
    return f" (first in row {row}{of})"


def in_run(bad: Mask | np.bool_) -> str:
    """The place of the first bad one of some runs, for messages."""
    first = tuple(map(int, np.argwhere(bad)[0]))
    return f" (first in run {first[0] if len(first) == 1 else first})" if first else ""


# What picks from one axis.
Item = int | slice | npt.NDArray[Any]


def lead_index(index: Any, lead: tuple[int, ...], what: Shown) -> Sequence[Item]:
    """An index of leading axes, one item an axis; `what` they are of is named in refusals."""
    parts = index if isinstance(index, tuple) else (index,)
    gaps = [k for k, part in enumerate(parts) if part is Ellipsis]
    missing = len(lead) - len(parts) + len(gaps)
    if missing < 0 or len(gaps) > 1:
        raise ModelError(
            f"{what._title} has {len(lead)} leading axes; [{_shown(parts)}] is of others"
        )
    gap = gaps[0] if gaps else len(parts)
    full = (*parts[:gap], *(slice(None),) * missing, *parts[gap + len(gaps) :])
    return [_item(part, length, what) for part, length in zip(full, lead, strict=True)]


def _item(part: Any, length: int, what: Shown) -> Item:
    try:
        if isinstance(part, slice):
            part.indices(length)
            return part
        places = np.asarray(part)
        kind = "i" if places.size == 0 and places.dtype.kind == "f" else places.dtype.kind
        if places.ndim > 1 or kind not in "iub" or (kind == "b" and places.ndim == 0):
            raise TypeError
        places = places if kind == "b" else places.astype(np.intp)
        np.empty(length, dtype=bool)[places]
    except (TypeError, ValueError):
        raise ModelError(
            f"{what._title}: {part!r} picks nothing; give a number, a slice, or a row of places or "
            "booleans"
        ) from None
    except IndexError as error:
        raise ModelError(f"{what._title}: {error}") from None
    return int(places) if places.ndim == 0 else places


def _shown(parts: tuple[Any, ...]) -> str:
    return ", ".join("..." if part is Ellipsis else repr(part) for part in parts)
