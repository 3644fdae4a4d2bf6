"""The settings of an experiment's `sweep`: the keywords that its signature declares."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Literal, cast, get_args, get_origin, get_type_hints

import numpy as np

from experiments.studies.errors import StudyError

Value = str | int | float | bool

# What a word of the command line means, by the type that is asked for.
_WORDS: dict[type, Callable[[str], Any]] = {
    str: lambda word: word,
    int: int,
    float: float,
    bool: lambda word: {"true": True, "false": False}[word.lower()],
}


@dataclass(frozen=True)
class Setting:
    """A keyword of a sweep.

    Attributes
    ----------
    name : str
    kind : type
        str, int, float or bool.
    choices : tuple of str
        All values that there are; empty where any of its type will do.
    default : str, int, float or bool
    """

    name: str
    kind: type
    choices: tuple[str, ...]
    default: Value

    def __str__(self) -> str:
        of = f"one of {', '.join(self.choices)}" if self.choices else self.kind.__name__
        return f"{self.name}: {of}; {self.default} by default"

    def parsed(self, word: str) -> Value:
        """The value that a word of the command line means.

        Raises
        ------
        StudyError
        """
        try:
            return self.checked(_WORDS[self.kind](word))
        except (ValueError, KeyError):
            raise self._refused(word) from None

    def checked(self, value: Any) -> Value:
        """A value, as a plain number or word.

        Raises
        ------
        StudyError
        """
        plain: Any = value.item() if isinstance(value, np.generic) else value
        if self.kind is float and type(plain) is int:
            plain = float(plain)
        if type(plain) is not self.kind or (self.choices and plain not in self.choices):
            raise self._refused(value)
        if isinstance(plain, float) and not np.isfinite(plain):
            raise self._refused(value)
        return cast(Value, plain)

    def _refused(self, value: Any) -> StudyError:
        due = f"one of {', '.join(self.choices)}" if self.choices else f"of {self.kind.__name__}"
        return StudyError(f"setting {self.name}: found {value!r}; its values are {due}")


def declared(function: Callable[..., Any]) -> dict[str, Setting]:
    """The settings of a sweep, ``function(runs, rng, *, setting=default, ...)``.

    A setting's type is that of its annotation, ``Literal`` of words or a plain type, or without
    one that of its default.

    Raises
    ------
    StudyError
        If the function is of another form.
    """
    name = getattr(function, "__qualname__", None)
    if name is None or not callable(function):
        raise StudyError(
            f"a study runs a function, function(runs, rng, *, setting=default); found {function!r}"
        )
    hints = get_type_hints(function)
    first, *rest = inspect.signature(function).parameters.values() or (None,)
    second, *keywords = rest or (None,)
    if (
        first is None
        or second is None
        or any(each.kind is not inspect.Parameter.POSITIONAL_OR_KEYWORD for each in (first, second))
        or any(
            each.kind is not inspect.Parameter.KEYWORD_ONLY or each.default is each.empty
            for each in keywords
        )
    ):
        raise StudyError(
            f"{name} takes {inspect.signature(function)}; a study calls function(runs, rng, *, "
            "setting=default), its settings being keywords with defaults"
        )
    return {each.name: _setting(name, each.name, hints, each.default) for each in keywords}


def _setting(function: str, name: str, hints: Mapping[str, Any], default: Any) -> Setting:
    hint = hints.get(name, type(default))
    choices = get_args(hint) if get_origin(hint) is Literal else ()
    kind = str if choices else hint
    if kind not in _WORDS or not all(isinstance(each, str) for each in choices):
        raise StudyError(
            f"setting {name} of {function} is of {hint!r}; a setting is of str, int, float or "
            "bool, or a Literal of words"
        )
    setting = Setting(name, kind, choices, default)
    setting.checked(default)
    return setting


def gridded(
    function: str, known: Mapping[str, Setting], over: Mapping[str, Iterable[Any]]
) -> dict[str, tuple[Value, ...]]:
    """The values of a grid, checked.

    Raises
    ------
    StudyError
        If a setting is not known, a value is of a wrong kind or there twice, or there are none.
    """
    grid = {}
    for name, values in over.items():
        if name not in known:
            raise StudyError(
                f"{function} has no setting {name!r}; it has {', '.join(known) or 'none'}"
            )
        if isinstance(values, str) or not isinstance(values, Iterable):
            raise StudyError(f"setting {name}: found {values!r}; give a list of values")
        found = tuple(known[name].checked(value) for value in values)
        if not found or len(set(found)) < len(found):
            raise StudyError(
                f"setting {name}: found {list(found)}; give each value once, one or more"
            )
        grid[name] = found
    return grid


def words(known: Mapping[str, Setting], over: Iterable[str]) -> dict[str, list[Value]]:
    """The grid that ``key=a,b,c`` of the command line mean.

    Raises
    ------
    StudyError
        If one cannot be read.
    """
    grid: dict[str, list[Value]] = {}
    for each in over:
        name, equals, values = each.partition("=")
        if not equals:
            raise StudyError(f"--over {each}: write --over setting=value,value")
        if name in grid:
            raise StudyError(f"--over {each}: {name} is there already; name all its values in one")
        if name not in known:
            raise StudyError(f"--over {each}: settings are {', '.join(known) or 'none'}")
        grid[name] = [known[name].parsed(word.strip()) for word in values.split(",")]
    return grid
