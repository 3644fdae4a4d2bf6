"""The numbers of a UAI file, one after the other."""

from __future__ import annotations

import itertools
import re
from array import array
from typing import NoReturn

import numpy as np

from pgm.errors import FileError
from pgm.io.networks.cursor import shown
from pgm.io.networks.numbers import WORD, numbers, whole
from pgm.io.networks.sources import Content, line_of
from pgm.kernels.arrays import Array

COMMENT = re.compile("#[^\r\n]*+")


class Words:
    """The numbers of a file, taken one after the other; places count them from 0.

    Attributes
    ----------
    at : int
        The place of the next number.
    """

    def __init__(self, content: Content, *, heading: bool) -> None:
        # Blanks for comments, so that lines and places stay.
        self._text = COMMENT.sub(lambda found: " " * len(found[0]), content.text())
        self._origin = content.origin
        self._start = self._heading() if heading else 0
        self._values = array("d")
        self.at = 0
        end = numbers(self._text, self._start, self._values)
        if end < len(self._text):
            found = shown(self._text[end : end + 100].split()[0])
            raise self._error(f"{found} stands where a number is due; correct or remove it", end)

    @property
    def left(self) -> int:
        """The number of numbers left."""
        return len(self._values) - self.at

    def count(self, what: str) -> int:
        """The next number, which must be whole and not negative."""
        if not self.left:
            self.fail(f"the file ends where {what} is due; is it whole?")
        found = whole(self._values[self.at])
        if found is None:
            self.fail(f"{self._values[self.at]:.9g} stands where {what} is due", self.at)
        self.at += 1
        return found

    def take(self, count: int) -> Array:
        """The next numbers, of a table."""
        if self.left < count:
            self.fail(f"{self.left} numbers are left of {count} of a table; is the file whole?")
        self.at += count
        return np.array(self._values[self.at - count : self.at])

    def finish(self) -> None:
        """Refuse what is left."""
        if self.left:
            self.fail(f"{self.left} numbers follow the last table; remove them", self.at)

    def fail(self, message: str, at: int | None = None) -> NoReturn:
        """Raise the error of a place, or of the end."""
        raise self.fault(message, len(self._values) if at is None else at)

    def fault(self, message: str, at: int | None) -> FileError:
        """The error of a place."""
        if at is None:
            return self._origin.fault(message)
        words = WORD.finditer(self._text, self._start)
        word = next(itertools.islice(words, at, None), None)
        return self._error(message, word.start() if word else len(self._text))

    def _error(self, message: str, at: int) -> FileError:
        return self._origin.fault(message, line_of(self._text, at))

    def _heading(self) -> int:
        word = WORD.search(self._text)
        found = word[0] if word else ""
        if found == "MARKOV":
            raise self._error(
                "it is a Markov network, whose tables are no probabilities of a child; only "
                "networks of the type BAYES are read",
                0,
            )
        if word is None or found != "BAYES":
            raise self._error(f"expected BAYES at the start, found {shown(found)}", 0)
        return word.end()
