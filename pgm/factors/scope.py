"""Scopes: which variables, in which order, share one stacked vector; unknown ones."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Iterable, Sequence
from typing import Any, Protocol

import numpy as np

from pgm.boundary import as_floats, as_tuple, is_unordered
from pgm.errors import ModelError
from pgm.kernels.arrays import Array, Index, Mask, as_index
from pgm.variables import Discrete, Variable

Scope = tuple[Variable, ...]

# The place of the first bad one, for messages.
Place = Callable[[Mask | np.bool_], str]

# How many of many items a message lists.
MOST = 8


def as_scope(
    scope: Variable | Iterable[Variable], what: str = "a scope", *, ordered: bool = True
) -> Scope:
    """A variable or several, as a tuple, each once; in a set only where order does not matter."""
    items = as_tuple(scope)
    result: Scope = (scope,) if items is None else items
    if ordered:
        require_order(scope, what)
    if not all(issubclass(kind, Variable) for kind in set(map(type, result))):
        found = next(v for v in result if not isinstance(v, Variable))
        raise ModelError(f"{what} holds variables, not {found!r}; give the variable itself")
    if len(set(result)) < len(result):
        twice = next(v for v in result if result.count(v) > 1)
        raise ModelError(f"{what} holds {twice!r} twice; name each variable once", variable=twice)
    if len({variable.name for variable in result}) < len(result):
        one_name_each(result)
    return result


def require_order(scope: object, what: str) -> None:
    """Refuse a set of variables, since the entries and axes of arrays stand in an order."""
    if is_unordered(scope):
        raise ModelError(
            f"{what} is a set, which has no order; give a tuple, since the order of the variables "
            "says which entries belong to which"
        )


def one_name_each(variables: Iterable[Variable]) -> None:
    """Refuse different variables of one name; copies of a variable at other steps are allowed."""
    seen: dict[str, Variable] = {}
    for variable in variables:
        first = seen.setdefault(variable.name, variable)
        if first is not variable and kind(first) != kind(variable):
            raise ModelError(
                f"two different variables are called {variable.name!r}: one with "
                f"{described(first)}, one with {described(variable)}{cut_short(first, variable)}; "
                "rename one or, if they are to be the same, make it once and use it everywhere",
                variable=variable.template,
            )


def kind(variable: Variable) -> tuple[tuple[str, ...] | None, ...]:
    """The parts that all copies of a variable share beside its name."""
    states = variable.states if isinstance(variable, Discrete) else None
    return variable.components, variable.angles, variable.units, states


def cut_short(first: Variable, second: Variable) -> str:
    """A clause of where two variables of one name differ that `described` leaves out, if any."""
    if isinstance(first, Discrete) == isinstance(second, Discrete):
        for one, other in zip(kind(first), kind(second), strict=True):
            for place, (own, its) in enumerate(zip(one or (), other or (), strict=False)):
                if own != its:
                    return "" if place < MOST else f" (number {place + 1} is {own!r} and {its!r})"
    return ""


def namesake(variable: object, known: Iterable[Variable]) -> str:
    """A clause that says how a variable differs from one of its name; empty if none has it."""
    if not isinstance(variable, Variable):
        return ""
    for other in known:
        if other.name == variable.name and kind(other) != kind(variable):
            return (
                f": the variable of that name is a different one, with {described(other)} where "
                f"this one has {described(variable)}{cut_short(other, variable)}; use that one"
            )
    return ""


def is_alike(one: Variable, other: Variable) -> bool:
    """Whether variables have the same components, angles and units; a single one has any name."""
    if one.units != other.units:
        return False
    if len(one.components) == len(other.components) == 1:
        return bool(one.angles) == bool(other.angles)
    return one.components == other.components and one.angles == other.angles


def described(variable: Variable) -> str:
    """A variable's kind in words."""
    if isinstance(variable, Discrete):
        return f"states ({listed(variable.states)})"
    units = f", units ({listed(variable.units)})" if variable.units else ""
    return f"components ({listed(variable.components)}), angles ({listed(variable.angles)}){units}"


def names(scope: Iterable[Variable]) -> str:
    """The variables' names, for messages."""
    return "(" + ", ".join(map(repr, scope)) + ")"


def listed(items: Iterable[object], most: int = MOST) -> str:
    """The first few of some items, for messages that must not grow with the network."""
    found = tuple(items)
    shown = ", ".join(map(repr, found[:most]))
    return shown if len(found) <= most else f"{shown}, ... ({len(found)} in all)"


def dimension(scope: Iterable[Variable]) -> int:
    """Number of components of the stacked vector."""
    return sum(variable.dimension for variable in scope)


def labels(scope: Iterable[Variable]) -> tuple[str, ...]:
    """The names of the components of the stacked vector."""
    return tuple(name for variable in scope for name in variable.components)


def units(scope: Iterable[Variable]) -> tuple[str, ...]:
    """The units of the components of the stacked vector; empty where none is known."""
    return tuple(variable.unit_of(name) for variable in scope for name in variable.components)


def distinct_labels(scope: Iterable[Variable]) -> tuple[str, ...]:
    """Names of components, preceded by their variable's where several variables share them."""
    scope = tuple(scope)
    count = Counter(labels(scope))
    return tuple(
        name if count[name] == 1 else _name(variable, name)
        for variable in scope
        for name in variable.components
    )


def components(scope: Sequence[Variable]) -> list[str]:
    """The components of the stacked vector as they are shown: ``heading [rad]``, ``x[3].east``."""
    return [
        _name(variable, component, whole=len(scope) > 1) + (unit and f" [{unit}]")
        for variable in scope
        for component in variable.components
        for unit in [variable.unit_of(component)]
    ]


def column_names(variable: Variable) -> list[str]:
    """The columns of a table of records: ``x`` of a scalar, ``x.east`` of a vector's component."""
    if variable.dimension == 1:
        return [repr(variable)]
    return [f"{variable!r}.{component}" for component in variable.components]


def _name(variable: Variable, component: str, *, whole: bool = True) -> str:
    """A component's name; `whole` prefixes its variable's name, unless both are the same."""
    if variable.dimension == 1 and component == variable.name:
        return repr(variable)
    return f"{variable!r}.{component}" if whole else component


def angle_mask(scope: Sequence[Variable]) -> Mask:
    """The mask of components of the stacked vector that are angles."""
    if not scope:
        return np.zeros(0, dtype=bool)
    return np.concatenate([variable.angle_mask for variable in scope])


def positions(scope: Sequence[Variable], wanted: Iterable[Variable]) -> Index:
    """The places of the components of some variables in the stacked vector of a scope."""
    starts = dict(zip(scope, np.cumsum([0, *(v.dimension for v in scope)]), strict=False))
    places: list[int] = []
    for variable in wanted:
        if not isinstance(variable, Variable) or variable not in starts:
            raise ModelError(
                f"{variable!r} is not in the scope ({listed(scope)}){namesake(variable, scope)}",
                variable=variable,
            )
        places.extend(range(starts[variable], starts[variable] + variable.dimension))
    return as_index(places)


def as_value(
    variable: Variable,
    value: object,
    what: str = "value",
    *,
    missing: bool = False,
    **about: Any,
) -> Array:
    """A value of a variable, (..., dimension), NaN where it may be missing; a scalar's a number."""
    what, about = f"{variable!r}: the {what}", {**about, "variable": variable}
    array = as_floats(value, what, labels=variable.components, missing=missing, **about)
    if array.ndim == 0 and variable.dimension == 1:
        array = array[None]
    if array.ndim == 0 or array.shape[-1] != variable.dimension:
        hint = "; give it that axis, value[..., None]" if variable.dimension == 1 else ""
        raise ModelError(
            f"{what} has shape {array.shape}; its last axis must hold the {variable.dimension} "
            f"components ({listed(variable.components)}){hint}",
            **about,
        )
    bad = np.isinf(array) if missing else ~np.isfinite(array)
    if bad.any():
        where, found = in_run(bad.any(axis=-1)), "infinite" if missing else "NaN or infinite"
        raise ModelError(f"{what} has entries that are {found}{where}", **about)
    return array


def unknown_name(key: object, known: Collection[Variable], where: str = "the network") -> str:
    """A clause that says why a key is none of the known variables, and what to use instead."""
    named = key.name if isinstance(key, Variable) else key
    alike = _in_order(v for v in known if v.name == named)
    if not isinstance(key, Variable):
        advice = (
            f"use the variable itself, {listed(alike)}"
            if alike
            else f"{where} has the variables {listed(_in_order(known))}"
        )
        return f"which is no variable; {advice}"
    if not alike:
        return f"which {where} does not have; it has {listed(_in_order(known))}"
    if kind(key) != kind(alike[0]):
        return (
            f"which {where} does not have: its variable of that name is a different one, with "
            f"{described(alike[0])} where this one has {described(key)}"
            f"{cut_short(alike[0], key)}; use that one"
        )
    template = key.step is None and not key.lag
    advice = f"name the step, {key.name}.at(k)" if template else "use what it has"
    return f"which {where} has only as {listed(alike)}; {advice}"


def _in_order(variables: Iterable[Variable]) -> list[Variable]:
    return sorted(variables, key=lambda v: (v.name, -1 if v.step is None else v.step, v.lag))


class Component(Protocol):
    """One component of a variable, with the name that it has in a belief."""

    @property
    def variable(self) -> Variable:
        """The variable."""

    @property
    def component(self) -> int:
        """The component's index within its variable."""

    @property
    def label(self) -> str:
        """The component's name, preceded by its variable's where several variables share it."""


def places_of(each: Sequence[Component], asked: Sequence[str], what: str) -> tuple[int, ...]:
    """The places of components by name, each named once, for a result called `what`."""
    labels = [component.label for component in each]
    named = all(isinstance(name, str) for name in asked)
    if not asked or not named or len(set(asked)) < len(asked):
        raise ModelError(
            f"{what} is of one or more of {listed(labels)}, by name, each once; found "
            f"{tuple(asked)}"
        )
    unknown = [name for name in asked if name not in labels]
    if unknown:
        raise ModelError(
            f"{unknown[0]!r} is no component of this belief; those are {listed(labels)}"
        )
    return tuple(labels.index(name) for name in asked)


def whole_variables(each: Sequence[Component]) -> Scope:
    """The variables whose components these are, refused if some are missing or out of order."""
    variables = tuple(dict.fromkeys(component.variable for component in each))
    due = [(v, k) for v in variables for k in range(v.dimension)]
    if [(component.variable, component.component) for component in each] != due:
        labels = [component.label for component in each]
        raise ModelError(
            f"a Gaussian is over whole variables: {listed(labels)} are not all components of "
            f"{listed(variables)} in their order; take .mean and .cov"
        )
    return variables


def in_row(bad: Mask | np.bool_) -> str:
    """The index of the first bad row along the last axis; the axes before it are runs."""
    *runs, row = map(int, np.argwhere(bad)[0]) if np.ndim(bad) else (None,)
    if row is None:
        return ""
    of = f" of run {runs[0] if len(runs) == 1 else tuple(runs)}" if runs else ""
    return f" (first in row {row}{of})"


def in_run(bad: Mask | np.bool_) -> str:
    """The index of the first bad run, for messages."""
    first = tuple(map(int, np.argwhere(bad)[0]))
    return f" (first in run {first[0] if len(first) == 1 else first})" if first else ""


def parted(scope: Scope, variables: Scope) -> Scope:
    """The variables of a scope but for some of them; a ModelError if either part has none."""
    own = as_scope(variables, "one part of a scope")
    for variable in own:
        if variable not in scope:
            raise ModelError(f"{variable!r} is not in the scope {names(scope)}", variable=variable)
    left = tuple(v for v in scope if v not in own)
    if not own or not left:
        raise ModelError(
            f"mutual information is of some variables of the scope {names(scope)} with the others; "
            f"found {names(own)}, which leaves {names(left)}"
        )
    return left
