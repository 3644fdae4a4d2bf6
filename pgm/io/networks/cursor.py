"""A place in a text that moves on token by token, in time that grows with the length alone."""

from __future__ import annotations

import json
import re
from array import array
from typing import NoReturn

from pgm.errors import FileError
from pgm.io.sources import Origin, line_of

# A stretch of a run of numbers, never cut within one; it bounds the memory of converting a run.
STRETCH = re.compile(r"[-+.0-9eE,\s]{1,65536}+[-+.0-9eE]*+")
ITEM = re.compile(r"[^,\s]++")
# Every repetition is possessive: nothing that was matched is ever tried again.
QUOTE = r'"[^"\\]*+(?:\\(?s:.)[^"\\]*+)*+"'
SPACE = r"(?:\s++|//[^\r\n]*+|/\*(?s:.*?)\*/)"
TOKEN = re.compile(
    SPACE + r"*+(?:"
    r"([{}()\[\],;|])"
    r"|(" + QUOTE + ")"
    r'|((?:[^\s{}()\[\],;|"/]|/(?![/*]))++)'
    r"|\Z)"
)
COMMENTS = re.compile(SPACE + "++")
PROPERTY = re.compile(r'[^;"{}]*+(?:' + QUOTE + r'[^;"{}]*+)*+;')
INSIDE = r'(?:[^{}"/]++|' + QUOTE + "|" + SPACE + "|/(?![/*]))*+"
BLOCK = re.compile(INSIDE + r"\{" + INSIDE + r"\}")
END, MARK, QUOTED, WORD = None, 1, 2, 3  # which group of a token matched
# What an error shows of a text, in characters.
SHOWN = 40


def numbers(text: str, start: int, into: array[float]) -> int:
    """Append the numbers from a place on, which white space or commas keep apart.

    Returns: Where they end: at the first thing that is no number, or at the end of the text.
    """
    while stretch := STRETCH.match(text, start):
        held = len(into)
        try:
            into.extend(map(float, stretch[0].replace(",", " ").split()))
        except ValueError:
            del into[held:]
            for word in ITEM.finditer(text, start, stretch.end()):
                try:
                    into.append(float(word[0]))
                except ValueError:
                    return word.start()
        start = stretch.end()
    return start


class Cursor:
    """A reading position in a text, token by token.

    kind: Of the token that was read last: MARK, QUOTED, WORD, or END.
    value: That token, without its quotes.
    """

    def __init__(self, text: str, origin: Origin) -> None:
        self.text, self.origin = text, origin
        self.kind: int | None = END
        self.value = ""
        self.start = self._at = 0

    def step(self) -> str:
        """Read the next token."""
        token = TOKEN.match(self.text, self._at)
        if token is None:
            self._unclosed()
        self.kind = token.lastindex
        self._at = token.end()
        if self.kind is None:
            self.start, self.value = self._at, ""
        else:
            self.start, self.value = token.start(self.kind), token[self.kind]
            if self.kind == QUOTED:
                self.value = self._unquoted(self.value)
        return self.value

    def expect(self, mark: str, what: str) -> None:
        """Read a token that must be a mark."""
        self.step()
        self.must_be(mark, what)

    def must_be(self, mark: str, what: str) -> None:
        """Refuse the token that was read, if it is not a certain mark."""
        if self.kind != MARK or self.value != mark:
            self.fail(f"expected '{mark}' {what}, found {self.found()}")

    def keyword(self) -> str:
        """The token that was read, where a keyword may stand; empty if it is no bare word."""
        return self.value if self.kind == WORD else ""

    def at_mark(self, mark: str) -> bool:
        """Whether the token that was read is a certain mark."""
        return self.kind == MARK and self.value == mark

    def numbers(self, into: array[float]) -> None:
        """Read numbers up to a semicolon, which is read too."""
        at = numbers(self.text, self._at, into)
        while comments := COMMENTS.match(self.text, at):
            at = numbers(self.text, comments.end(), into)
        self._at = at
        self.expect(";", "after the numbers")

    def skip_property(self) -> None:
        """Read a property, whatever it says, up to its semicolon outside quotes."""
        found = PROPERTY.match(self.text, self._at)
        if found is None:
            self.fail("the property has no ';' at its end, or braces outside of quotes")
        self._at = found.end()

    def skip_block(self) -> None:
        """Move past the braces of a block without reading its content."""
        found = BLOCK.match(self.text, self._at)
        if found is None:
            self.fail("the block that starts here has no '{', or no '}' at its end")
        self._at = found.end()

    def restart(self, at: int) -> None:
        """Read the token at an earlier place again."""
        self._at = at
        self.step()

    def found(self) -> str:
        """The token that was read, for messages."""
        return "the end of the file" if self.kind is END else shown(self.value)

    def fail(self, message: str) -> NoReturn:
        """Raise the error of the token that was read."""
        raise self.fault(message, self.start)

    def fault(self, message: str, at: int | None) -> FileError:
        """The error of a place, or of the whole text."""
        return self.origin.fault(message, None if at is None else line_of(self.text, at))

    def _unquoted(self, text: str) -> str:
        if "\\" not in text:
            return text[1:-1]
        try:
            return str(json.loads(text, strict=False))
        except ValueError:
            self.fail(
                f"the quoted name {shown(text)} has an escape that is none; a backslash is "
                'written \\\\, a quote \\"'
            )

    def _unclosed(self) -> NoReturn:
        """Only a quote or a comment without an end is no token."""
        space = COMMENTS.match(self.text, self._at)
        at = space.end() if space else self._at
        what, end = ("quote", '"') if self.text[at] == '"' else ("comment", "*/")
        raise self.fault(f"the {what} that starts here is never closed; add {end} at its end", at)


def shown(text: str) -> str:
    """A piece of a file, for messages that must not grow with it."""
    return repr(text if len(text) <= SHOWN else text[: SHOWN - 3] + "...")
