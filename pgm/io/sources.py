"""Bytes, text and lines of numbers in and out; files that are written whole or not at all."""

import gzip
import io
import math
import os
import re
import secrets
import zlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any, TypeAlias

import numpy as np

from pgm.errors import FileError
from pgm.kernels.arrays import Array

Source: TypeAlias = str | os.PathLike[str] | IO[Any]

# Some ten times the largest network of the public repositories, in bytes.
LIMIT = 64 * 2**20
GZIP = b"\x1f\x8b"
# How much of a file is looked at, in characters or bytes, and how a web page begins.
_HEAD = 4096
_PAGE = re.compile(
    r"\ufeff?(?:\s++|<\?(?s:.*?)\?>|<!--(?s:.*?)-->)*+(<!doctype\s+html\b|<html\b)", re.IGNORECASE
)


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
    _refuse_pages(data, origin)
    return Content(data, origin)


def _refuse_pages(data: str | bytes, origin: Origin) -> None:
    """Refuse a page of the web, as a browser saves it in place of the file that it shows."""
    head = data[:_HEAD] if isinstance(data, str) else data[:_HEAD].decode("utf-8-sig", "replace")
    if page := _PAGE.match(head):
        raise origin.fault(
            "it is a web page (HTML), not the file that the page shows: save the raw file, by the "
            "page's link to it ('Raw' or 'Download'), and read that",
            line_of(head, page.start(1)),
        )


def _all(file: Any, limit: int) -> str | bytes:
    """The content of a file, read up to slightly more than `limit`."""
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


# Letters of a word that a message shows.
_SHOWN = 40
# Digits from which on a float does not hold all whole numbers.
_EXACT = 16


@dataclass(frozen=True, slots=True)
class Line:
    """The words of a line, and its number from 1."""

    number: int
    words: Sequence[str]
    origin: Origin

    def fault(self, found: str) -> FileError:
        """The error of a line, which says what was found."""
        return self.origin.fault(f"found {found}", self.number)

    def require(self, due: str) -> None:
        """Refuse another number of words than are due."""
        count = len(due.split())
        if len(self.words) < count:
            raise self.fault(
                f"{len(self.words)} words; `{due}` was due, {count}: the line may be cut; complete "
                "it, or leave it out"
            )
        if len(self.words) > count:
            raise self.fault(
                f"{len(self.words)} words; `{due}` was due, {count}: leave the others out"
            )

    def numbers(self, due: str, skip: int = 0) -> list[float]:
        """The finite numbers behind the first words, as many as are due."""
        self.require(due)
        return self.finite(self.words[skip:], f"`{due}`")

    def finite(self, words: Sequence[str], due: str) -> list[float]:
        """The finite numbers that some of the words are."""
        found = _finite(words)
        if found is not None:
            return found
        found = []
        for word in words:
            try:
                found.append(_float(word))
            except ValueError:
                found.append(math.nan)
            if not math.isfinite(found[-1]):
                shown = word if len(word) <= _SHOWN else word[:_SHOWN] + "..."
                raise self.fault(f"{shown!r}; {due}, in finite numbers, was due")
        return found

    def whole(self, word: str, what: str) -> int:
        """The whole number that a word is."""
        if len(word) < _EXACT and word.isascii() and word.isdigit():
            return int(word)
        (found,) = self.finite([word], what)
        if found != int(found):
            raise self.fault(f"{what} {word}; a whole number was due")
        return int(found)


def lines(content: Content) -> Iterator[Line]:
    """Each line that has words and is no comment, which ``#`` begins."""
    for number, line in enumerate(_each(content), start=1):
        if (words := line.split()) and not words[0].startswith("#"):
            yield Line(number, words, content.origin)


def _each(content: Content) -> list[str]:
    """The lines as editors count them: a form feed, say, ends none."""
    return io.StringIO(content.text(), newline=None).read().split("\n")


def numbers(content: Content, due: str) -> Array:
    """The table of lines that are numbers alone, (lines, words due)."""
    columns = len(due.split())
    texts = [text for text in _each(content) if text.lstrip()[:1] not in ("", "#")]
    if texts:
        # Many times faster, and what it refuses is then read or refused in words.
        try:
            table = np.loadtxt(texts, comments=None, ndmin=2)
        except ValueError:
            table = np.empty((0, 0))
        if table.shape == (len(texts), columns) and np.isfinite(table).all():
            return table
    rows = [line.numbers(due) for line in lines(content)]
    return np.array(rows).reshape(len(rows), columns)


def number(word: str, line: int, origin: Origin) -> float:
    """The finite number that a word is."""
    try:
        found = _float(word)
    except ValueError:
        raise origin.fault(f"{word!r} is no number", line) from None
    if not math.isfinite(found):
        raise origin.fault(f"{word!r} is not finite; leave the line out", line)
    return found


def _finite(words: Sequence[str]) -> list[float] | None:
    """The numbers that words are; None where one is none, or not finite."""
    if "_" in "".join(words):
        return None
    try:
        found = list(map(float, words))
    except ValueError:
        return None
    return found if all(map(math.isfinite, found)) else None


def _float(word: str) -> float:
    return float(word.replace("_", "?"))  # 1_0 Python reads, and no other tool
