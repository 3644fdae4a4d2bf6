"""Fingerprints of models, evidence and methods, by which another process knows them again."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from types import CodeType, FunctionType, MethodType, ModuleType
from typing import Any

import numpy as np

from pgm.immutable import Immutable
from pgm.variables import Variable

_PLAIN = bool | int | float | complex | str | bytes | None


def fingerprint(value: Any) -> str:
    """A digest of a value's numbers, and of the code of its functions, with what that reads.

    Of a function it has the instructions and constants, whatever their lines, the defaults, the
    cells of the closure, and the globals that it names; of an object its class, its public
    attributes, and its function where it is called. Attributes that begin with an underscore are
    found anew, and left out, and so is all that a module or an object of C holds.
    """
    reader = _Reader()
    reader.read(value)
    return reader.digest.hexdigest()[:16]


class _Reader:
    """A walk through a value, in an order that depends on the value alone."""

    def __init__(self) -> None:
        self.digest = hashlib.sha256()
        # What was met, by its id, with its number: kept, so that no other takes its id.
        self._met: dict[int, tuple[int, Any]] = {}

    def read(self, value: Any) -> None:
        """Add a value to the digest."""
        if isinstance(value, np.ndarray | np.generic):
            array = np.asarray(value)
            self._word("array", array.dtype.str, array.shape)
            if array.dtype.hasobject:
                self._each(array.ravel().tolist())
            else:
                self.digest.update(np.ascontiguousarray(array).tobytes())
        elif isinstance(value, _PLAIN):
            self._word(value)
        elif isinstance(value, Variable):
            self._word(repr(value), value.components, value.angles, value.units)
        elif isinstance(value, type | ModuleType):
            self._word("name", getattr(value, "__module__", ""), value.__name__)
        elif id(value) in self._met:
            self._word("again", self._met[id(value)][0])
        else:
            self._met[id(value)] = len(self._met), value
            self._parts(value)

    def _parts(self, value: Any) -> None:
        if isinstance(value, Mapping):
            self._word("mapping", len(value))
            self._each(each for pair in value.items() for each in pair)
        elif isinstance(value, Sequence):
            self._word("sequence", len(value))
            self._each(value)
        elif isinstance(value, set | frozenset):
            self._word("set", sorted(map(repr, value)))
        elif isinstance(value, CodeType):
            # Which tells neither lines nor the file.
            self._word("code", value.co_code, value.co_names, value.co_varnames, value.co_freevars)
            self._each(value.co_consts)
        elif isinstance(value, FunctionType):
            cells = [_content(cell) for cell in value.__closure__ or ()]
            named = [value.__globals__.get(name) for name in sorted(_names(value.__code__))]
            self._word("function", len(cells), len(named))
            self._each((value.__code__, value.__defaults__, value.__kwdefaults__, *cells, *named))
        elif isinstance(value, MethodType):
            self._each(("method", value.__func__, value.__self__))
        elif isinstance(value, partial):
            self._each(("partial", value.func, value.args, value.keywords))
        else:
            state, kind = _state(value), type(value)
            self._word("object", kind.__module__, kind.__qualname__, getattr(value, "__name__", ""))
            self._each(each for name in sorted(state) for each in (name, state[name]))
            own = (vars(each).get("__call__") for each in kind.__mro__)
            call = next((each for each in own if isinstance(each, FunctionType)), None)
            # Of this library the figures tell whether it has changed.
            if call is not None and call.__module__.partition(".")[0] != "pgm":
                self.read(call)

    def _word(self, *words: Any) -> None:
        self.digest.update(repr(words).encode())

    def _each(self, values: Iterable[Any]) -> None:
        for value in values:
            self.read(value)


def _names(code: CodeType) -> set[str]:
    """The names that a code reads, with those of the functions that it defines."""
    within = (each for each in code.co_consts if isinstance(each, CodeType))
    return set(code.co_names).union(*map(_names, within))


def _content(cell: Any) -> Any:
    try:
        return cell.cell_contents
    except ValueError:  # of a name that was never bound
        return "empty"


def _state(value: Any) -> dict[str, Any]:
    """The attributes of an object that say what it is, by name."""
    if isinstance(value, Immutable):
        state = value.__getstate__()
    else:
        state = dict(getattr(value, "__dict__", {}))
    # What measurements are given with has a property over a mapping.
    given = {"given": state["_given"]} if "_given" in state else {}
    return {name: each for name, each in state.items() if not name.startswith("_")} | given
