"""Tables of a few words."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TypeVar

from pgm.display.shown import Shown, titled
from pgm.display.summary import TITLE, Listing, Summary

Key = TypeVar("Key")


class Told(Shown, Mapping[Key, str]):
    """A mapping with a few words about each value, for display."""

    __slots__ = ("_found", "_more", "_of")

    def __init__(self, title: str, found: Mapping[Key, str], *more: str) -> None:
        self._of, self._found, self._more = title, dict(found), more

    def __getitem__(self, key: Key) -> str:
        return self._found[key]

    def __iter__(self) -> Iterator[Key]:
        return iter(self._found)

    def __len__(self) -> int:
        return len(self._found)

    @property
    def _title(self) -> str:
        return self._of

    def _summary(self) -> Summary:
        rows = [(titled(key), words) for key, words in self._found.items()]
        return Summary(self._title, [Listing(("", ""), rows, 2, TITLE), *self._more])
