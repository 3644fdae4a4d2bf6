"""Files of a recording: opened, and refused in words that name the file."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from pgm.errors import EvidenceError, FileError
from pgm.io import sources
from pgm.io.sources import Content, Origin, Source

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


@contextmanager
def told_of(origin: Origin) -> Iterator[None]:
    """Errors of values that a file holds, as errors of the file."""
    try:
        yield
    except EvidenceError as error:
        raise origin.fault(str(error)) from error
