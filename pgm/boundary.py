"""Checks of users' numbers, arrays and sequences, with messages in words."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from numbers import Real
from typing import Any, TypeGuard

import numpy as np
import numpy.typing as npt

from pgm.errors import EvidenceError, ModelError, PgmError
from pgm.kernels.arrays import Array, Integers

_FLOAT = np.dtype(np.float64)
# Types that NumPy turns into floats without a loss; lists of anything else are read one by one.
_PLAIN = {bool, int, float, np.float64, np.float32, np.int64, np.int32}
_DEEPEST = 64  # axes of an array
_KINDS = {
    "c": "complex ones; take .real, if the imaginary part is to be lost",
    "M": "dates; take (dates - dates[0]) / np.timedelta64(1, 's') for seconds",
    "m": "durations; take durations / np.timedelta64(1, 's') for seconds",
    "S": "texts (bytes)",
    "T": "texts (str)",
    "U": "texts (str)",
    "V": "records",
}


class _Unfit(Exception):
    """The reason, in words, why a value is no array of numbers."""


def is_whole(value: object) -> TypeGuard[int]:
    """Whether a value is an integer; a bool or a NumPy duration is not."""
    return isinstance(value, int | np.integer) and not isinstance(value, bool | np.timedelta64)


def is_number(value: object) -> TypeGuard[float]:
    """Whether a value is a real number that a float can hold: no bool, and no duration."""
    if not isinstance(value, Real) or isinstance(value, bool | np.timedelta64):
        return False
    try:
        float(value)
    except OverflowError:
        return False
    return True


def as_tuple(value: object) -> tuple[Any, ...] | None:
    """The items of a sequence or the like, a generator's too; None of a text, or one item."""
    if isinstance(value, str | bytes) or not isinstance(value, Iterable):
        return None
    if isinstance(value, np.ndarray) and not value.ndim:
        return None
    return tuple(value)


def is_unordered(value: object) -> bool:
    """Whether a value is a set of several items, which stand in no order."""
    return isinstance(value, set | frozenset) and len(value) > 1


def as_mapping(
    value: Any, what: str, error: type[PgmError] = EvidenceError, **about: Any
) -> Mapping[Any, Any]:
    """A mapping, the empty one in place of None."""
    if value is None:
        return {}
    if not isinstance(value, Mapping):
        raise error(
            f"{what} is a mapping of variables to values, not {type(value).__name__}", **about
        )
    return value


def as_lengths(size: Any, what: str) -> tuple[int, ...]:
    """The lengths of axes of draws, one or several; `what` says how many draws they are."""
    shape = (size,) if is_whole(size) else as_tuple(size)
    if (
        shape is None
        or is_unordered(size)
        or not all(is_whole(length) and length >= 0 for length in shape)
    ):
        raise ModelError(f"size is how many draws {what}, or a tuple of such; not {size!r}")
    return tuple(map(int, shape))


def as_generator(rng: Any) -> np.random.Generator:
    """The generator of draws, given or of a seed; None is refused: draws must be repeatable."""
    if isinstance(rng, np.random.Generator):
        return rng
    if not is_whole(rng) or rng < 0:
        raise ModelError(
            "rng is a numpy.random.Generator or a seed, a whole number from 0, so that draws can "
            f"be repeated; not {rng!r}"
        )
    return np.random.default_rng(int(rng))


def as_floats(
    value: Any,
    what: str,
    error: type[PgmError] = ModelError,
    *,
    labels: Sequence[str] = (),
    missing: bool = False,
    verb: str = "be",
    **about: Any,
) -> Array:
    """A user's value as an array of floats, not copied if it is one; truth values count as 0 and 1.

    `what` is the subject of the message, and `verb` what it must do: be numbers, or return them.
    `labels` name the entries along the last axis: a structured array or data frame is taken by
    them, in any order, and refused if its columns have other ones; a data frame whose columns have
    no names is taken as it stands. With `missing`, masked entries, None and pandas' NA are NaN.
    """
    if type(value) is np.ndarray and value.dtype == _FLOAT:
        return value
    if type(value) is float:  # of which CPDs of a network have thousands
        return np.array(value)
    try:
        return _read(value, labels, missing)
    except _Unfit as fault:
        raise error(f"{what} must {verb} numbers, not {fault}", **about) from fault.__cause__


def as_wholes(value: Any, what: str, error: type[PgmError] = ModelError, **about: Any) -> Integers:
    """A user's value as an array of integers; an empty array may have any type of number."""
    try:
        numbers = _read(value, (), False)
    except _Unfit as fault:
        raise error(f"{what} must be whole numbers, not {fault}", **about) from fault.__cause__
    given = value if isinstance(value, np.ndarray) else np.asarray(value)
    if numbers.size and given.dtype.kind not in "iu":
        raise error(
            f"{what} must be whole numbers, not an array of shape {given.shape} and type "
            f"{given.dtype}",
            **about,
        )
    return numbers.astype(np.intp)


def masked_whole(value: Any) -> Any:
    """The user's value, nested lists that hold masked arrays being one masked array."""
    if isinstance(value, list | tuple):
        try:
            if any(issubclass(kind, np.ma.MaskedArray) for kind in _leaves(value)):
                return np.ma.stack([np.ma.asarray(masked_whole(part)) for part in value])
        except (_Unfit, ValueError):  # which are refused as what they are
            pass
    return value


def _read(value: Any, labels: Sequence[str], missing: bool) -> Array:
    names = _column_names(value, labels)
    if names is not None:
        _require_named(names, labels)
        columns = [_read(value[name], (), missing) for name in labels]
        return np.stack(columns, axis=-1)
    if isinstance(value, list | tuple) and not _leaves(value) <= _PLAIN:
        parts = [_read(part, labels, missing) for part in value]
        try:
            return np.stack(parts)
        except ValueError as error:
            raise _Unfit("rows of unequal length") from error
    if isinstance(value, np.ma.MaskedArray):
        return _unmasked(value, missing)
    try:
        array = np.asarray(value)
    except OverflowError as error:
        raise _Unfit("numbers too large for a float, which ends at 1.8e308") from error
    except ValueError as error:
        raise _Unfit("rows of unequal length") from error
    except Exception as error:  # of the __array__ of other libraries
        raise _Unfit(f"{type(value).__name__}, which makes no array: {error}") from error
    if array.ndim == 0 and array.dtype == object:
        return np.asarray(_number(value, missing))
    return _converted(array, missing)


def _leaves(rows: Sequence[Any], depth: int = 0) -> set[type]:
    """The types of the elements of nested lists and tuples."""
    if depth > _DEEPEST:
        raise _Unfit(f"lists nested deeper than {_DEEPEST}")
    found = set(map(type, rows))
    if found.isdisjoint((list, tuple)):
        return found
    inner = [_leaves(row, depth + 1) for row in rows if type(row) in (list, tuple)]
    return (found - {list, tuple}).union(*inner)


def _converted(array: npt.NDArray[Any], missing: bool) -> Array:
    kind = array.dtype.kind
    if kind == "O":
        numbers = [_number(entry, missing) for entry in array.ravel()]
        return np.array(numbers, dtype=float).reshape(array.shape)
    if kind in "fiub":
        with np.errstate(over="ignore"):  # of longer floats: infinities are refused, or not, as any
            return array.astype(_FLOAT)
    raise _Unfit(_KINDS[kind])


def _unmasked(value: Any, missing: bool) -> Array:
    """An array whose masked entries are NaN."""
    masked = np.ma.getmaskarray(value)
    array = np.array(np.ma.getdata(value))
    if masked.any():
        if not missing:
            raise _Unfit(
                f"masked ones, as {masked.sum()} of these {masked.size} are; only a measurement "
                "can be missing"
            )
        if array.dtype == object:
            array[masked] = None
    numbers = _converted(array, missing)
    numbers[masked] = np.nan
    return numbers


def _number(entry: Any, missing: bool) -> float:
    """An entry of an array of objects as a number."""
    if missing and (entry is None or type(entry).__name__ == "NAType"):
        return np.nan
    if is_number(entry):
        return float(entry)
    if is_whole(entry):
        raise _Unfit("numbers too large for a float, which ends at 1.8e308")
    if isinstance(entry, np.generic | str | bool | complex):
        kind = np.asarray(entry).dtype.kind
        raise _Unfit(_KINDS.get(kind, type(entry).__name__))
    raise _Unfit(type(entry).__name__)


def _column_names(value: Any, labels: Sequence[str]) -> list[Any] | None:
    """The names of columns, or of the entries of a frame's row; None where there are none."""
    if isinstance(value, np.ndarray | np.void):
        return None if value.dtype.names is None else list(value.dtype.names)
    if not hasattr(value, "__getitem__"):
        return None
    if hasattr(value, "columns"):
        names = list(value.columns)
        return None if names == list(range(len(names))) else names
    if len(labels) > 1 and hasattr(value, "index") and hasattr(value, "to_numpy"):
        names = list(value.index)
        return names if names and all(isinstance(name, str) for name in names) else None
    return None


def _require_named(names: list[Any], labels: Sequence[str]) -> None:
    found = ", ".join(map(str, names[:8])) + (", ..." if len(names) > 8 else "")
    if not labels:
        raise _Unfit(f"columns with names ({found}); give the bare numbers, as .to_numpy() does")
    if sorted(map(str, names)) != sorted(labels):
        raise _Unfit(
            f"the columns ({found}), where ({', '.join(labels)}) were due; rename them, or give "
            "the bare numbers in that order"
        )
