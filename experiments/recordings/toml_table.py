"""Tables of a TOML file whose every key is asked for; what is wrong is told with file and key."""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from pgm.errors import FileError

_NEEDED = object()


@dataclass(frozen=True, eq=False)
class TomlTable:
    """A table of a file.

    Attributes
    ----------
    file : Path
    name : str
        Its own, such as ``[sensors.radio]``; empty of the whole file.
    values : mapping
    asked : set of str
        Keys that were asked for.
    """

    file: Path
    name: str
    values: Mapping[str, Any]
    asked: set[str] = field(default_factory=set)

    @classmethod
    def read(cls, file: Path) -> TomlTable:
        """The whole file.

        Raises
        ------
        FileError
            If it cannot be read, or is no TOML.
        """
        try:
            text = file.read_text(encoding="utf-8")
            return cls(file, "", tomllib.loads(text))
        except OSError as error:
            raise FileError(
                f"{file}: it cannot be read ({error.strerror or error})", path=str(file)
            ) from None
        except UnicodeDecodeError as error:
            raise FileError(f"{file}: it is no UTF-8 ({error})", path=str(file)) from None
        except tomllib.TOMLDecodeError as error:
            raise FileError(f"{file}: it is no TOML: {error}", path=str(file)) from None

    def fault(self, key: str, found: str, due: str) -> FileError:
        """The error of a key."""
        where = f"{self.name}.{key}" if self.name else key
        return FileError(f"{self.file}: {where} {found}; {due} was due", path=str(self.file))

    def take(self, key: str, due: str, check: Callable[[Any], bool], default: Any = _NEEDED) -> Any:
        """A value that passes a check; `due` says in words which."""
        self.asked.add(key)
        if key not in self.values:
            if default is _NEEDED:
                raise self.fault(key, "is missing", due)
            return default
        value = self.values[key]
        if not check(value):
            raise self.fault(key, f"is {value!r}", due)
        return value

    def text(self, key: str, due: str, default: Any = _NEEDED) -> Any:
        """A text that is not empty."""
        return self.take(key, due, lambda v: isinstance(v, str) and v != "", default)

    def flag(self, key: str, default: bool) -> Any:
        """True or false."""
        return self.take(key, "true or false", lambda v: isinstance(v, bool), default)

    def whole(self, key: str, default: int) -> Any:
        """A whole number from 1 on."""
        good = lambda v: isinstance(v, int) and not isinstance(v, bool) and v >= 1  # noqa: E731
        return self.take(key, "a whole number, 1 or more,", good, default)

    def number(self, key: str, due: str, good: Callable[[float], bool], default: Any) -> Any:
        """A number that is good."""
        found = self.take(key, due, lambda v: is_number(v) and good(float(v)), default)
        return float(found) if is_number(found) else found

    def numbers(
        self,
        key: str,
        components: tuple[str, ...],
        good: Callable[[float], bool] = lambda v: bool(np.isfinite(v)),
        kind: str = "",
        default: Any = _NEEDED,
    ) -> Any:
        """Numbers, one for each component, each of them good."""
        count = len(components)
        due = (
            f"{kind}{'a number' if count == 1 else f'{count} numbers'}, ({', '.join(components)}),"
        )

        def fits(value: Any) -> bool:
            each = value if isinstance(value, list) else [value]
            return len(each) == count and all(is_number(v) and good(float(v)) for v in each)

        found = self.take(key, due, fits, default)
        if found is default and default is not _NEEDED:
            return found
        return tuple(float(v) for v in (found if isinstance(found, list) else [found]))

    def table(self, key: str, *, needed: bool = False) -> TomlTable:
        """A table below; an empty one where there is none."""
        default: Any = _NEEDED if needed else {}
        name = f"{self.name}.{key}" if self.name else key
        found = self.take(key, f"a table, [{name}],", lambda v: isinstance(v, dict), default)
        return TomlTable(self.file, name, found)

    def tables(self, key: str) -> dict[str, TomlTable]:
        """All tables below a table."""
        below = self.table(key)
        return {name: below.table(name) for name in below.values}

    def done(self) -> None:
        """Refuse keys that were not asked for."""
        if strange := sorted(set(self.values) - self.asked):
            where = f"{self.name}.{strange[0]}" if self.name else strange[0]
            raise FileError(
                f"{self.file}: {where} is unknown; known are {', '.join(sorted(self.asked))}",
                path=str(self.file),
            )


def is_number(value: Any) -> bool:
    """Whether it is a number of TOML."""
    return isinstance(value, int | float) and not isinstance(value, bool)
