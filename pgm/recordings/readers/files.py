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
from pgm.io.networks.cursor import shown
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
        self._words = frozenset(words)
        self._lines: dict[str, list[int]] = {}

    def others(self, lines: Iterable[Line]) -> Iterator[Line]:
        """The lines that are not left out."""
        for line in lines:
            if line.words[0] in self._words:
                self.leave(line, line.words[0])
            else:
                yield line

    def leave(self, line: Line, kind: str) -> None:
        """Leave a line out, as one of a kind."""
        self._lines.setdefault(kind, []).append(line.number)

    def told(self, name: str) -> list[Dropped]:
        """The lines left out, by kind, of a file or stream of this name."""
        return [
            Dropped(name, f"{kind}, lines from 1", np.array(rows))
            for kind, rows in self._lines.items()
        ]


def stranger(line: Line, kinds: Iterable[str]) -> FileError:
    """The error of a line of a kind that is not read, which can be left out."""
    word = shown(line.words[0])
    hint = f"; skip=({word},) leaves such lines out" if line.words[0][0].isalpha() else ""
    return line.fault(f"{word}; {', '.join(kinds)} was due{hint}")


@contextmanager
def told_of(origin: Origin) -> Iterator[None]:
    """Errors of values that a file holds, as errors of the file."""
    try:
        yield
    except EvidenceError as error:
        raise origin.fault(str(error)) from error
