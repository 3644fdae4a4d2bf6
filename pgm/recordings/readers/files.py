"""Files of a recording: opened, and refused in words that name the file."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from pgm.boundary import as_tuple
from pgm.errors import EvidenceError, FileError
from pgm.io import sources
from pgm.io.dropped import Dropped
from pgm.io.networks.cursor import SHOWN, shown
from pgm.io.sources import Content, Line, Origin, Source

# Bytes that a file may hold once unpacked.
LIMIT = 2**30


def content(source: Source) -> Content:
    """All of a file, which is there and can be read."""
    try:
        return sources.read(source, LIMIT)
    except FileError:
        raise
    except (OSError, ValueError) as error:  # a NUL in a path, or a file that was closed
        name = os.fspath(source) if isinstance(source, str | os.PathLike) else "the file"
        why = getattr(error, "strerror", None) or error
        raise FileError(
            f"{name} cannot be read ({type(error).__name__}: {why})", path=str(name)
        ) from error


def folder(path: Any) -> Path:
    """A folder, which is there."""
    if not isinstance(path, str | os.PathLike):
        raise FileError(f"a folder's path was due, not {type(path).__name__}")
    found = Path(os.fsdecode(path))
    if not found.is_dir():
        raise FileError(f"{found} is no folder", path=str(found))
    return found


def name(source: Source) -> str:
    """The name of a recording: of its file or folder, without the ending."""
    return Path(source).stem if isinstance(source, str | os.PathLike) else ""


class Skipped:
    """The lines of a file that `skip` passes over by their first word, and their record."""

    def __init__(self, skip: Any) -> None:
        words = as_tuple(skip)
        if words is None or not all(isinstance(word, str) and word for word in words):
            raise EvidenceError(
                f"skip= names the first words of lines to leave out, like ('EQUIV',), not {skip!r}"
            )
        self._asked = tuple(dict.fromkeys(words))
        self._lines: dict[str, list[int]] = {}

    def others(self, lines: Iterable[Line]) -> Iterator[Line]:
        """The lines that are kept."""
        for line in lines:
            if line.words[0] in self._asked:
                self.leave(line, line.words[0])
            else:
                yield line

    def leave(self, line: Line, kind: str) -> None:
        """Leave a line out, and count it under its kind."""
        self._lines.setdefault(kind, []).append(line.number)

    def told(self, name: str) -> list[Dropped]:
        """The lines left out, by kind, of a file or stream of this name."""
        return [
            Dropped(name, f"{kind}, lines from 1", np.array(rows))
            for kind, rows in self._lines.items()
        ]

    def stranger(self, line: Line, kinds: Iterable[str]) -> FileError:
        """The error for a line of an unknown kind, with the `skip=` that leaves it out, too."""
        word = line.words[0]
        hint = ""
        if word[0].isalpha():
            skip = (*self._asked, word)
            short = all(len(each) <= SHOWN for each in skip)
            hint = f"; skip={skip!r} leaves such lines out" if short else ""
        return line.fault(f"{shown(word)}; {', '.join(kinds)} was due{hint}")


@contextmanager
def told_of(origin: Origin) -> Iterator[None]:
    """Errors of values that a file holds, as errors of the file."""
    try:
        yield
    except EvidenceError as error:
        raise origin.fault(str(error)) from error
