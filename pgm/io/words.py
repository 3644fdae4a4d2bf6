"""Lines of words and numbers, as text files of measurements have them."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from pgm.errors import FileError
from pgm.io.sources import Content, Origin
from pgm.kernels.arrays import Array

# Letters of a word that a message shows.
_SHOWN = 40


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
        if len(self.words) != len(due.split()):
            raise self.fault(f"{len(self.words)} words; `{due}` was due")

    def numbers(self, due: str, skip: int = 0) -> list[float]:
        """The finite numbers behind the first words, as many as are due."""
        self.require(due)
        return self.finite(self.words[skip:], f"`{due}`")

    def finite(self, words: Sequence[str], due: str) -> list[float]:
        """The finite numbers that some of the words are."""
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
        (found,) = self.finite([word], what)
        if found != int(found):
            raise self.fault(f"{what} {word}; a whole number was due")
        return int(found)


def lines(content: Content) -> Iterator[Line]:
    """Each line that has words and is no comment, which ``#`` begins."""
    for number, line in enumerate(content.text().splitlines(), start=1):
        if (words := line.split()) and not words[0].startswith("#"):
            yield Line(number, words, content.origin)


def numbers(content: Content, due: str) -> Array:
    """The table of lines that are numbers alone, (lines, words due)."""
    columns = len(due.split())
    texts = [text for text in content.text().splitlines() if text.lstrip()[:1] not in ("", "#")]
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


def _float(word: str) -> float:
    return float(word.replace("_", "?"))  # 1_0 Python reads, and no other tool
