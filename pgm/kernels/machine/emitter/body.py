"""The text of a function: its instructions in order, in blocks that end by a branch."""

from __future__ import annotations


class Body:
    """The instructions of a function in LLVM's assembly language, as far as they are written."""

    def __init__(self) -> None:
        self._entry: list[str] = []
        self._lines: list[str] = []
        self._count = 0

    def value(self, instruction: str) -> str:
        """Write an instruction; returns the name of its value."""
        self._count = count = self._count + 1
        self._lines.append(f"%v{count} = {instruction}")
        return f"%v{count}"

    def line(self, text: str) -> None:
        """Write an instruction that has no value."""
        self._lines.append(text)

    def reserve(self, kind: str, aligned: int = 0, name: str = "") -> str:
        """Take memory for the whole function, wherever it is asked for; returns its name."""
        place = name or f"%m{len(self._entry)}"
        self._entry.append(f"{place} = alloca {kind}{f', align {aligned}' if aligned else ''}")
        return place

    def written(self) -> list[str]:
        """All instructions: those that take memory run once, so they come first."""
        return [*self._entry, *self._lines]

    def labels(self, *names: str) -> list[str]:
        """Names for blocks, which no other block of the function has."""
        self._count += 1
        return [f"{name}{self._count}" for name in names]

    def begin(self, label: str) -> None:
        """Begin a block; the one before it has ended by a branch."""
        self._lines.append(f"{label}:")

    def to(self, label: str) -> None:
        """End the block: go on with another."""
        self._lines.append(f"br label %{label}")

    def fork(self, truth: str, yes: str, no: str) -> None:
        """End the block: go on with one of two others."""
        self._lines.append(f"br i1 {truth}, label %{yes}, label %{no}")

    def place(self) -> int:
        """The number of instructions so far."""
        return len(self._lines)

    def forget(self, count: int) -> None:
        """Take back the last instructions."""
        del self._lines[-count:]
