"""Random variables: a name, named components or states, and a step in time."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, overload

import numpy as np
import numpy.typing as npt

from pgm.arguments import public
from pgm.boundary import as_tuple, is_unordered, is_whole
from pgm.display import InCode
from pgm.errors import ModelError
from pgm.resources import require_memory, uncollected
from pgm.units import RAD, SPELLINGS

# Units of components in their order, or by name; of one, its text.
Units = str | Iterable[str] | Mapping[str, str]
# Numbers of memory that the name of a state takes.
_STATE = 8


class _Hashed:
    """The hash of a variable, once it has been asked for; a pickle goes without."""

    __slots__ = ("_hash",)

    _hash: int


@public
@dataclass(frozen=True, slots=True)
class Variable(_Hashed, InCode):
    """A continuous random variable, scalar or vector.

    Parameters
    ----------
    name : str
        Two different variables of one network may not share it.
    components : tuple of str, optional
        Names of the components, in order; a scalar's single component is named like the variable.
    angles : tuple of str, optional
        The components that are angles, in radians.
    step : int, optional
        The step of a concrete copy (see `at`); None in a template, which holds for every step.
    lag : int, optional
        How many steps before the current one a template stands (see `previous`).
    units : str, sequence or mapping of str to str, optional
        The units of the components, in their order (a text: of the only one), or by name; ``""``
        where there is none. Angles are in ``"rad"``, said or not. Readers of recordings convert to
        ``"m"``, ``"km"``, ``"s"``, ``"m/s"``, ``"deg/s"`` and others (`Recording.timeline`),
        plots, data frames and trajectories are labelled by them. Numbers given as arrays are taken
        to be in them.

    Raises
    ------
    ModelError
        If a name is empty or repeats, an angle is no component or has another unit than radians, a
        unit is a known one spelt otherwise, or a step is before the first.

    Examples
    --------
    >>> x = Variable("x", components=("east", "north", "heading"), angles=("heading",))
    >>> x.previous, x.at(3), x.at(3).previous
    (x[t-1], x[3], x[2])
    >>> x.at(3).previous == x.at(2) == x.previous.at(3)
    True
    >>> Variable("u", components=("speed", "turn", "gain"), units={"speed": "m/s"}).units
    ('m/s', '', '')
    """

    name: str
    components: tuple[str, ...] = ()
    angles: tuple[str, ...] = ()
    step: int | None = None
    lag: int = 0
    units: tuple[str, ...] = ()

    if TYPE_CHECKING:
        # The first so that names which several variables share can be given as ``**pose``.
        @overload
        def __init__(
            self,
            name: str,
            components: Iterable[str] = ...,
            angles: Iterable[str] = ...,
            *,
            units: Units = ...,
        ) -> None: ...

        @overload
        def __init__(
            self,
            name: str,
            components: Iterable[str] = ...,
            angles: Iterable[str] = ...,
            step: int | None = ...,
            lag: int = ...,
            units: Units = ...,
        ) -> None: ...

        def __init__(self, *args: Any, **kwargs: Any) -> None: ...

    def __post_init__(self) -> None:
        if not isinstance(self.name, str) or not self.name:
            raise ModelError(f"a variable's name must be a non-empty string, not {self.name!r}")
        for field in ("components", "angles"):
            value = getattr(self, field)
            object.__setattr__(self, field, _names(self, field, value))
        if not self.components:
            object.__setattr__(self, "components", (self.name,))
        if len(set(self.components)) < len(self.components):
            raise ModelError(
                f"variable {self.name}: components {self.components} repeat a name; "
                "give each component a name of its own",
                variable=self,
            )
        unknown = [name for name in self.angles if name not in self.components]
        if unknown:
            raise ModelError(
                f"variable {self.name}: angles {unknown} are not among its components "
                f"{self.components}",
                variable=self,
            )
        # In the components' order, so that a set of angles makes the same variable each time.
        angles = tuple(name for name in self.components if name in self.angles)
        object.__setattr__(self, "angles", angles)
        if type(self.units) is not tuple or self.units:
            object.__setattr__(self, "units", _units(self, self.units))
        for field, value in (("step", self.step), ("lag", self.lag)):
            if value is None and field == "step":
                continue
            if not is_whole(value):
                raise ModelError(
                    f"variable {self.name}: {field} must be a whole number, not {value!r}",
                    variable=self,
                )
            if value < 0:
                raise ModelError(
                    f"variable {self.name}: {field} {value} is before the first, 0", variable=self
                )

    def __hash__(self) -> int:
        # Scopes are hashed a lot.
        try:
            return self._hash
        except AttributeError:
            object.__setattr__(self, "_hash", hash((self.name, self.step, self.lag)))
            return self._hash

    @property
    def dimension(self) -> int:
        """Number of components."""
        return len(self.components)

    @property
    def angle_mask(self) -> npt.NDArray[np.bool_]:
        """The mask of components that are angles, shape (dimension,)."""
        return np.array([name in self.angles for name in self.components], dtype=bool)

    def unit_of(self, component: str) -> str:
        """The unit of a component, ``"rad"`` of an angle; empty where none is known."""
        if component not in self.components:
            raise ModelError(
                f"variable {self.name} has no component {component!r}; it has {self.components}",
                variable=self,
            )
        if self.units:
            return self.units[self.components.index(component)]
        return RAD if component in self.angles else ""

    @property
    def previous(self) -> Variable:
        """The variable one step before; refused at step 0."""
        if self.step is not None:
            return self.at(self.step - 1)
        return self._moved(None, self.lag + 1)

    @property
    def template(self) -> Variable:
        """The variable without a step or lag, which stands for all its copies."""
        return self if self.step is None and not self.lag else self._moved(None, 0)

    def at(self, step: int) -> Variable:
        """The copy at a step; for a template with a lag, that many steps before it.

        One before step 0 is refused.

        Examples
        --------
        >>> x = Variable("x")
        >>> x.at(3), x.previous.at(3)
        (x[3], x[2])
        """
        if not is_whole(step):
            raise ModelError(f"{self!r}.at({step!r}): a step is a whole number", variable=self)
        return self._moved(int(step) - self.lag, 0)

    def _moved(self, step: int | None, lag: int) -> Variable:
        """The copy elsewhere; only its place has to be checked."""
        if step is not None and step < 0:
            raise ModelError(
                f"variable {self.name}: step {step} is before the first, 0", variable=self
            )
        return self._with(step=step, lag=lag)

    def _with(self, **changed: Any) -> Variable:
        """A copy with other fields, which are not checked."""
        copy, place = object.__new__(type(self)), object.__setattr__
        for field in self.__dataclass_fields__:
            place(copy, field, changed[field] if field in changed else getattr(self, field))
        return copy

    def __repr__(self) -> str:
        if self.step is not None:
            return f"{self.name}[{self.step}]"
        return f"{self.name}[t-{self.lag}]" if self.lag else self.name


@public
@dataclass(frozen=True, slots=True, init=False, repr=False)
class Discrete(Variable):
    """A random variable with finitely many named states.

    Parameters
    ----------
    name : str
        Two different variables of one network may not share it.
    states : tuple of str, or int
        Names of the states, in order; a number n stands for ``"0"`` to ``"n−1"``.
    step, lag : int, optional
        See `Variable`.

    Examples
    --------
    >>> rain = Discrete("rain", states=("no", "yes"))
    >>> rain.size, rain.index("yes")
    (2, 1)
    """

    states: tuple[str, ...] = ()

    def __init__(
        self, name: str, states: Iterable[str] | int, *, step: int | None = None, lag: int = 0
    ) -> None:
        for field, value in (("name", name), ("step", step), ("lag", lag)):
            object.__setattr__(self, field, value)
        for field in ("components", "angles", "units"):
            object.__setattr__(self, field, ())
        Variable.__post_init__(self)
        if is_whole(states):
            require_memory(
                int(states) * _STATE,
                f"the names of {name}'s {states} states",
                "make cells of several values each",
                variable=self,
            )
        names = map(str, range(states)) if is_whole(states) else states
        found = _names(self, "states", names)
        if not found:
            raise ModelError(
                f"variable {name}: states must be a tuple of one or more names, or their number, "
                f"not {states!r}",
                variable=self,
            )
        if len(set(found)) < len(found):
            twice = next(state for state in found if found.count(state) > 1)
            raise ModelError(
                f"variable {name}: two states are called {twice!r}; give each a name of its own",
                variable=self,
            )
        object.__setattr__(self, "states", found)

    __hash__ = Variable.__hash__

    @property
    def size(self) -> int:
        """Number of states."""
        return len(self.states)

    def index(self, state: str | int) -> int:
        """The index of a state, 0 to size − 1, by its name or index."""
        if isinstance(state, str) and state in self.states:
            return self.states.index(state)
        if is_whole(state) and 0 <= int(state) < self.size:
            return int(state)
        raise ModelError(
            f"{self!r} has no state {state!r}; its states are {self.states}", variable=self
        )


def _names(variable: Variable, field: str, value: object) -> tuple[str, ...]:
    """Names that a variable is given, in their order."""
    advice = ", or their number" if field == "states" else ""
    if is_unordered(value) and field != "angles":
        raise ModelError(
            f"variable {variable.name}: {field} must be a tuple of names{advice}; {value!r} is a "
            "set, which has no order",
            variable=variable,
        )
    found = as_tuple(value)
    empty = field == "states"  # a state may be called "", a component may not
    if found is None or not all(isinstance(name, str) and (name or empty) for name in found):
        shown = value if found is None else found
        raise ModelError(
            f"variable {variable.name}: {field} must be a tuple of names{advice}, not {shown!r}",
            variable=variable,
        )
    return found


def _units(variable: Variable, given: object) -> tuple[str, ...]:
    """The unit of each component; none at all, where those of angles alone would be known."""
    name, components = variable.name, variable.components
    if isinstance(given, Mapping):
        unknown = [key for key in given if key not in components]
        if unknown:
            raise ModelError(
                f"variable {name}: units has {unknown}, not among its components {components}",
                variable=variable,
            )
        found = tuple(given.get(each, "") for each in components)
    else:
        if is_unordered(given):
            raise ModelError(
                f"variable {name}: units is a set, which has no order; give a tuple, or a mapping "
                "by component",
                variable=variable,
            )
        found = (given,) if isinstance(given, str) else as_tuple(given) or ()
    if len(found) != len(components) or not all(isinstance(unit, str) for unit in found):
        raise ModelError(
            f"variable {name}: units are a text for each of its components {components}, in their "
            f'order or by name, {{{components[0]!r}: "m"}}, not {given!r}',
            variable=variable,
        )
    for component, unit in zip(components, found, strict=True):
        if unit in SPELLINGS:
            raise ModelError(
                f"variable {name}: the unit {unit!r} of {component!r} is spelt "
                f"{SPELLINGS[unit]!r} here",
                variable=variable,
            )
        if component in variable.angles and unit not in ("", RAD):
            raise ModelError(
                f"variable {name}: {component!r} is an angle, and angles are in radians, not "
                f"{unit!r}; np.radians(degrees) makes radians of degrees",
                variable=variable,
            )
    if not any(u for each, u in zip(components, found, strict=True) if each not in variable.angles):
        return ()
    return tuple(
        RAD if each in variable.angles else unit
        for each, unit in zip(components, found, strict=True)
    )


@public
def variables(
    names: str | Iterable[str],
    components: Iterable[str] = (),
    angles: Iterable[str] = (),
    units: Units = (),
) -> tuple[Variable, ...]:
    """Variables of one kind, one a name; scalars, if they are given no components.

    Parameters
    ----------
    names : str or iterable of str
        Names, in one string separated by white space or commas, or one by one.
    components, angles : tuple of str, optional
        Those of each; see `Variable`. Scalars that are angles have a component of one name.
    units : str, sequence or mapping of str to str, optional
        Of the components of each; a text where there is one.

    Examples
    --------
    >>> a, b, c = variables("a b c")
    >>> b.dimension
    1
    >>> poses = variables("x0 x1 x2", ("east", "north", "heading"), angles=("heading",))
    >>> poses[2].angles
    ('heading',)
    """
    if isinstance(names, str):
        names = names.replace(",", " ").split()
    found = None if is_unordered(names) else as_tuple(names)
    if found is None:
        raise ModelError(f"variables takes names in order, in a text or one by one, not {names!r}")
    if not found:
        return ()
    components = tuple(components) if isinstance(components, Iterator) else components
    first = Variable(found[0], components, angles, units=units)
    own = not components  # each is called like its variable
    if own and first.angles:
        raise ModelError(
            f"variables that are angles need a component of one name: give "
            f'components=("angle",), angles=("angle",), not angles={angles!r} alone',
            variable=first,
        )
    made = [first]
    with uncollected(len(found)):
        for name in found[1:]:
            if not isinstance(name, str) or not name:
                Variable(name)  # which refuses it
            scalar = {"components": (name,)} if own else {}
            made.append(first._with(name=name, **scalar))
    if len(set(found)) < len(found):
        twice = next(name for name, times in Counter(found).items() if times > 1)
        raise ModelError(
            f"the name {twice!r} repeats; each variable needs one of its own",
            variable=next(variable for variable in made if variable.name == twice),
        )
    return tuple(made)
