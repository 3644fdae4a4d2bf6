"""Bytes and text in and out, up to a limit; files that are written whole or not at all."""

import gzip
import io
import os
import secrets
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any, TypeAlias

from pgm.errors import FileError

Source: TypeAlias = str | os.PathLike[str] | IO[Any]

# Some ten times the largest network of the public repositories, in bytes.
LIMIT = 64 * 2**20
GZIP = b"\x1f\x8b"


@dataclass(frozen=True, slots=True)
class Origin:
    """The name of a file, and the errors that name it and a line."""

    name: str
    path: str | None

    def fault(self, message: str, line: int | None = None) -> FileError:
        """The error of a line, or of the whole file."""
        where = self.name if line is None else f"{self.name}, line {line}"
        return FileError(f"{where}: {message}", path=self.path, line=line)


@dataclass(frozen=True, slots=True)
class Content:
    """The content of a source: text, where it was opened as text, else bytes."""

    data: str | bytes = field(repr=False)
    origin: Origin

    def text(self) -> str:
        """The content as text; bytes are UTF-8."""
        if isinstance(self.data, str):
            return self.data.removeprefix("\ufeff")
        try:
            return self.data.decode("utf-8-sig")
        except UnicodeDecodeError as error:
            raise self.origin.fault(
                f"the byte 0x{self.data[error.start]:02x} is no UTF-8; where the file has another "
                "encoding, give it opened: open(path, encoding='latin-1')",
                line_of(self.data.decode("latin-1"), error.start),
            ) from None


def line_of(text: str, at: int) -> int:
    """The line of a place, from 1; lines end in a line feed, or all in a carriage return."""
    return text.count("\n" if "\n" in text else "\r", 0, at) + 1


def same(one: Source, other: Source) -> bool:
    """Whether two sources are one open file, or paths to one place."""
    paths = [p for p in (one, other) if isinstance(p, str | os.PathLike)]
    return one is other or (len(paths) == 2 and len(set(map(os.path.realpath, paths))) == 1)


def read(source: Source, limit: int) -> Content:
    """All of a source; refuses one that holds more than `limit` bytes, once unpacked."""
    if isinstance(limit, bool) or not isinstance(limit, int) or limit < 1:
        raise FileError(f"limit= is a whole number of bytes, such as 2**28, not {limit!r}")
    if isinstance(source, str | os.PathLike):
        path = os.fspath(source)
        with open(path, "rb") as file:
            return _unpacked(file, Origin(path, path), limit)
    named = getattr(source, "name", None)
    known = os.fspath(named) if isinstance(named, str | os.PathLike) else None
    origin = Origin(known or "the file", known)
    if not callable(getattr(source, "read", None)):
        raise origin.fault(f"a source is a path or an open file, not {type(source).__name__}")
    return _unpacked(source, origin, limit)


def _unpacked(file: IO[Any], origin: Origin, limit: int) -> Content:
    try:
        data = _all(file, limit)
    except UnicodeDecodeError as error:
        raise origin.fault(
            f"it was opened as {error.encoding}, which it is not ({error.reason}); open it with "
            "its own encoding, or as bytes ('rb')"
        ) from None
    except ValueError as error:
        raise origin.fault(
            f"it cannot be read ({error}); is it still open, and for reading?"
        ) from None
    if isinstance(data, bytes) and data.startswith(GZIP) and len(data) <= limit:
        try:
            data = _all(gzip.GzipFile(fileobj=io.BytesIO(data)), limit)
        except (OSError, EOFError, zlib.error) as error:
            raise origin.fault(
                f"it is gzipped, and damaged ({error}); fetch or write it again"
            ) from None
    if len(data) > limit:
        raise origin.fault(
            f"it holds more than {limit} bytes; where it is meant to, raise the limit (limit=)"
        )
    return Content(data, origin)


def _all(file: Any, limit: int) -> str | bytes:
    """The content of a file, or somewhat more than `limit` of it."""
    pieces, held = [], 0
    while held <= limit and (piece := file.read(limit + 1 - held)):  # may be less than asked for
        pieces.append(piece)
        held += len(piece)
    return (b"" if not pieces or isinstance(pieces[0], bytes) else "").join(pieces)


def write(target: Source, text: str) -> None:
    """Write text, as UTF-8 where the target takes bytes; gzipped to a path that ends in .gz."""
    if isinstance(target, str | os.PathLike):
        data = text.encode()
        if os.fspath(target).endswith(".gz"):
            data = gzip.compress(data, mtime=0)  # no time: equal networks make equal files
        with whole(target) as path:
            path.write_bytes(data)
        return
    if not callable(getattr(target, "write", None)):
        raise FileError(f"a target is a path or an open file, not {type(target).__name__}")
    try:
        try:
            target.write("")
        except TypeError:
            target.write(text.encode())
        else:
            target.write(text)
    except UnicodeEncodeError as error:
        raise FileError(
            f"the target was opened as {error.encoding}, which has no {error.object[error.start]!r}"
            "; open it with encoding='utf-8', or as bytes ('wb')"
        ) from None
    except ValueError as error:
        raise FileError(
            f"the target cannot be written ({error}); is it still open, and for writing?"
        ) from None


@contextmanager
def whole(path: str | os.PathLike[str], *, durable: bool = False) -> Iterator[Path]:
    """A path to write to, whose file takes the place of another once it is complete.

    It stands in the same folder and ends as the other does. Where writing fails, or is killed, the
    other file is as it was. What is no ordinary file, like a pipe or a device, is written directly.
    A ``durable`` file has reached the disk before it takes the other's place.

    Examples
    --------
    >>> with whole("summary.json") as path:  # doctest: +SKIP
    ...     path.write_text("{}")
    """
    # Of a link its target is replaced.
    target = Path(os.path.realpath(path))
    if target.exists() and not target.is_file():
        yield target
        return
    # Machines that share a folder may have processes of one number.
    own = f"{os.getpid()}-{secrets.token_hex(4)}"
    beside = target.with_name(f".{target.stem}.{own}{target.suffix}")
    try:
        yield beside
        if target.exists():
            beside.chmod(target.stat().st_mode)
        if durable:
            _to_disk(beside)
        os.replace(beside, target)
        if durable and os.name == "posix":  # elsewhere folders cannot be opened
            _to_disk(target.parent)
    except BaseException:
        beside.unlink(missing_ok=True)
        raise


def _to_disk(path: Path) -> None:
    file = os.open(path, os.O_RDONLY if path.is_dir() else os.O_RDWR)
    try:
        os.fsync(file)
    finally:
        os.close(file)
