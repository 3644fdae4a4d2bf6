"""Places along the leading axes of stacked Gaussians."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from pgm.display import Shown
from pgm.errors import ModelError

# What picks from one axis.
Item = int | slice | npt.NDArray[Any]


def lead_index(index: Any, lead: tuple[int, ...], what: Shown) -> Sequence[Item]:
    """An index of leading axes, one item an axis.

    Parameters
    ----------
    index : int, slice, row of places or booleans, Ellipsis, or tuple of them
    lead : tuple of int
        The axes.
    what : Shown
        Whose they are, for errors.

    Raises
    ------
    ModelError
        If the index is of another kind, of more axes, or out of range.
    """
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
