"""The axes of a table: one for each discrete variable of its scope, after the leading axes."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, cast

import numpy as np
import numpy.typing as npt

from pgm.boundary import as_floats, is_whole, masked_whole
from pgm.errors import EvidenceError, GraphError, ModelError, NumericalError
from pgm.factors.scope import Place, Scope, as_scope, in_run, listed, names, namesake
from pgm.kernels.arrays import Array, Integers, Mask
from pgm.variables import Discrete, Variable

States = tuple[Discrete, ...]
# How many variables a table may have: NumPy's 64 axes, less some for axes of runs.
AXES = 60


def as_states(scope: Variable | Iterable[Variable]) -> States:
    """A discrete variable or several, as a tuple; refuses all else."""
    found = []
    for variable in as_scope(scope):
        if not isinstance(variable, Discrete):
            raise ModelError(
                f"a table is over discrete variables; {variable!r} is continuous", variable=variable
            )
        found.append(variable)
    if len(found) > AXES:
        raise ModelError(
            f"a table over {len(found)} variables: NumPy's arrays have axes for {AXES}; take "
            "fewer at once, or leave out those of one state"
        )
    return tuple(found)


def discrete(scope: Scope) -> States:
    """The scope as one of discrete variables, once this has been checked."""
    return cast(States, scope)


def sizes(scope: States) -> tuple[int, ...]:
    """The number of states of each variable."""
    return tuple(variable.size for variable in scope)


def require_axes(scope: States, what: str, advice: str = "", **about: Any) -> None:
    """Refuse, by a `GraphError`, a table over more variables than NumPy's arrays have axes for.

    `what` names the table in the error's text, as "the joint"; `advice` is what to do instead of
    leaving variables out of the network, as "ask for fewer, or "; `about` are attributes of the
    error.
    """
    if len(scope) > AXES:
        single = list(dict.fromkeys(v.template for v in scope if v.size == 1))
        raise GraphError(
            f"{what} over ({listed(scope)}) is a table of too many axes: NumPy's arrays have them "
            f"for {AXES} variables; {advice}leave variables of one state, ({listed(single)}), out "
            "of the network",
            variable=single[0] if single else scope[0],
            **about,
        )


def as_lead(scope: States, lead: int | tuple[int, ...]) -> tuple[int, ...]:
    """The leading axes that a user asks for, as a tuple."""
    axes = lead if isinstance(lead, tuple) else (lead,)
    for length in axes:
        if not is_whole(length) or length < 0:
            raise ModelError(
                f"table over {names(scope)}: lead is how many tables there are, a whole number or "
                f"a tuple of such, not {lead!r}"
            )
    return tuple(map(int, axes))


def as_entries(
    scope: States, values: npt.ArrayLike, log_scale: npt.ArrayLike, lead: tuple[int, ...]
) -> tuple[Array, Array]:
    """The values and log-scale of tables as arrays; refuses what no table can have."""
    what = f"table over {names(scope)}"
    entries = as_floats(values, f"{what}: the values").copy()
    scale = as_floats(log_scale, f"{what}: log_scale").copy()
    due = sizes(scope)
    if entries.ndim < len(due) or entries.shape[entries.ndim - len(due) :] != due:
        raise ModelError(
            f"{what}: the values have shape {entries.shape}; it must end in {due}, the numbers of "
            "states"
        )
    leads = {"values": entries.shape[: entries.ndim - len(due)], "log_scale": scale.shape}
    for part, own in leads.items():
        if not _is_within(own, lead):
            raise ModelError(
                f"{what}: {part} has leading axes {own}, which do not broadcast to lead={lead}; "
                f"a table has shape {due}, and where several are meant, lead= says how many"
            )
    if not np.isfinite(entries).all() or (entries < 0.0).any():
        raise ModelError(f"{what}: the values have entries that are negative, NaN or infinite")
    if np.isnan(scale).any() or (scale == np.inf).any():
        raise ModelError(f"{what}: log_scale must be finite, or −inf for a table of zeros")
    return entries, scale


def require_positive(scope: States, largest: Array) -> None:
    """Refuse tables of which one is all zero, by the largest entry of each."""
    empty = np.argwhere(largest == 0.0)
    if empty.shape[0]:
        first = tuple(map(int, empty[0]))
        where = f" (first in run {first[0] if len(first) == 1 else first})" if first else ""
        raise NumericalError(
            f"the table over {names(scope)} is all zero{where}: it has neither "
            "probabilities nor a largest entry; the factors it is made of contradict each other"
        )


def require_known(scope: States, largest: Array) -> None:
    """Refuse tables of which one is NaN, by the largest entry of each.

    Such a table stands for a run whose evidence is impossible, where that is allowed.
    """
    lost = np.argwhere(np.isnan(largest))
    if lost.shape[0]:
        first = tuple(map(int, lost[0]))
        # A table does not know which of its axes are of runs, and which of steps.
        where = f" at index {first[0] if len(first) == 1 else first} of its runs, steps" * bool(
            first
        )
        raise NumericalError(
            f"the table over {names(scope)} is NaN{where}, as a belief is whose evidence is "
            "impossible: it has neither draws nor a largest entry; take the tables whose values "
            "are not NaN"
        )


def _is_within(own: tuple[int, ...], lead: tuple[int, ...]) -> bool:
    try:
        return np.broadcast_shapes(own, lead) == lead
    except ValueError:
        return False


def axes_of(scope: States, wanted: Iterable[Variable]) -> tuple[int, ...]:
    """The axes of some variables, counted from the last."""
    place: dict[Variable, int] = {v: k for k, v in enumerate(scope, -len(scope))}
    wanted = as_scope(wanted, ordered=False)
    for variable in wanted:
        if variable not in place:
            raise ModelError(
                f"{variable!r} is not in the scope {names(scope)}{namesake(variable, scope)}",
                variable=variable,
            )
    return tuple(place[variable] for variable in wanted)


def without(scope: States, drop: Iterable[Variable]) -> States:
    """The scope's remaining variables."""
    gone = set(drop)
    return tuple(variable for variable in scope if variable not in gone)


def spread(values: Array, own: States, scope: States) -> Array:
    """A view of values with an axis for each variable of a wider scope, of length one if new."""
    if own == scope:
        return values
    place = {variable: k for k, variable in enumerate(scope)}
    order = sorted(range(len(own)), key=lambda k: place[own[k]])
    lead = values.ndim - len(own)
    values = values.transpose(*range(lead), *(lead + k for k in order))
    known = set(own)
    own_sizes = (v.size if v in known else 1 for v in scope)
    return values.reshape((*values.shape[:lead], *own_sizes))


def at(scope: States, index: Iterable[int]) -> str:
    """A combination of states, for messages."""
    return ", ".join(f"{v!r}={v.states[k]!r}" for v, k in zip(scope, index, strict=True))


# What stands for "not observed in this run".
MISSING = -1
# What stands, while names are looked up, for one that is no state's.
STRANGER = -2


class _Unfit(Exception):
    """The reason, in words, why a value is no state, and which values are."""


def as_indices(variable: Discrete, value: Any, where: Place = in_run) -> Integers:
    """Evidence, names or indices of states, as an array of indices (...); −1 is "not observed"."""
    try:
        return _indices(variable, value, where)
    except _Unfit as fault:
        raise EvidenceError(
            f"evidence for {variable!r} {''.join(fault.args)}", variable=variable
        ) from None


def as_known(variable: Discrete, value: Any, what: str, **about: Any) -> Integers:
    """Names or indices of states, none of which is missing, as an array of indices (...)."""
    try:
        indices = _indices(variable, value, in_run)
        _refuse(variable, indices, indices == MISSING, in_run)
    except _Unfit as fault:
        raise ModelError(f"{what} {fault.args[0]}", variable=variable, **about) from None
    return indices


def _indices(variable: Discrete, value: Any, where: Place) -> Integers:
    if hasattr(value, "columns"):
        raise _malformed(variable, "a data frame, of which pgm.records makes evidence")
    value = masked_whole(value)
    if isinstance(value, np.ma.MaskedArray):
        masked = np.ma.getmaskarray(value)
        array = np.array(np.ma.getdata(value), dtype=object)
        array[masked] = MISSING
        return _indices(variable, array, where)
    try:
        array = np.asarray(value)
    except ValueError:
        raise _malformed(variable, "rows of unequal length") from None
    if array.dtype.kind == "U" and not isinstance(value, np.ndarray | str):
        array = np.asarray(value, dtype=object)  # numpy makes names of a list's numbers
    if array.size == 0:
        return np.zeros(array.shape, dtype=np.intp)
    if array.dtype.kind in "UTO":
        return _looked_up(variable, array, where)
    if array.dtype.kind not in "iu":
        raise _malformed(variable, f"{_words(array)} of type {array.dtype}")
    _refuse(variable, array, (array < MISSING) | (array >= variable.size), where)
    return array.astype(np.intp)


def _looked_up(variable: Discrete, array: Any, where: Place) -> Integers:
    place = {state: index for index, state in enumerate(variable.states)}
    found = [
        place.get(name, STRANGER) if isinstance(name, str) else _whole(variable, name)
        for name in array.ravel().tolist()
    ]
    indices = np.array(found, dtype=np.intp).reshape(array.shape)
    _refuse(variable, array, indices == STRANGER, where)
    return indices


def _whole(variable: Discrete, value: Any) -> int:
    if not is_whole(value):
        raise _malformed(variable, repr(value))
    return int(value) if MISSING <= value < variable.size else STRANGER


def _refuse(variable: Discrete, array: Any, bad: Mask, where: Place) -> None:
    if bad.any():
        first = array[bad].ravel()[0]
        shown = repr(str(first) if isinstance(first, str) else int(first))
        raise _Unfit(
            f"is {shown}{where(bad)}, which is none of its states ({listed(variable.states)}), 0 "
            f"to {variable.size - 1}",
            ", nor −1 for not observed",
        )


def _malformed(variable: Discrete, found: str) -> _Unfit:
    return _Unfit(
        f"must be names or indices of states, not {found}; its states are "
        f"({listed(variable.states)})",
        ", −1 is not observed, and weights of the states are pgm.soft(weights)",
    )


def _words(array: Any) -> str:
    return f"an array of shape {array.shape}" if array.ndim else "a value"
