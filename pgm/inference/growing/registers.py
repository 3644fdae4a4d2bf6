"""Registers that only grow: a longer one shares the memory of those that it has grown from."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import islice
from threading import Lock
from typing import Any, TypeVar

K = TypeVar("K")
T = TypeVar("T")


class Register(Mapping[K, T]):
    """The first entries of a mapping that others may have extended.

    Of two registers that are grown from one the second is a copy.
    """

    __slots__ = ("_entries", "_lock", "count")

    def __init__(self) -> None:
        self.count = 0
        self._entries: dict[K, tuple[int, T]] = {}
        self._lock = Lock()

    def __len__(self) -> int:
        return self.count

    def __contains__(self, key: object) -> bool:
        found = self._entries.get(key)  # type: ignore[arg-type]
        return found is not None and found[0] < self.count

    def __getitem__(self, key: K) -> T:
        found = self._entries[key]
        if found[0] >= self.count:
            raise KeyError(key)
        return found[1]

    def __iter__(self) -> Iterator[K]:
        with self._lock:  # nothing is added while they are counted off
            return iter(list(islice(self._entries, self.count)))

    def extended(self, more: Mapping[K, T]) -> Register[K, T]:
        """The register with more entries, of keys that it does not have."""
        longer: Register[K, T] = object.__new__(type(self))
        with self._lock:
            own = len(self._entries) == self.count
            entries = self._entries if own else dict(islice(self._entries.items(), self.count))
            for key, entry in more.items():
                entries[key] = len(entries), entry
        longer._entries, longer.count = entries, self.count + len(more)
        longer._lock = self._lock if own else Lock()
        return longer

    def __getstate__(self) -> dict[str, Any]:
        return {"entries": dict(self.items())}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.count, self._lock = len(state["entries"]), Lock()
        self._entries = {key: (k, entry) for k, (key, entry) in enumerate(state["entries"].items())}
