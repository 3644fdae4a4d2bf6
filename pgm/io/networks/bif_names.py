"""Lists of names in BIF, which commas divide, or white space alone."""

from __future__ import annotations

from collections.abc import Container

from pgm.io.networks.cursor import END, MARK, Cursor

# The same list divided by commas and by white space: "very high, low" is two names or three.
Names = tuple[list[str], list[str]]


def names_to(cursor: Cursor, close: str, what: str) -> Names:
    """Read names up to one of some marks, which is read too."""
    names: list[str] = []
    words: list[str] = []
    first = 0  # of the words since the last comma
    while True:
        text = cursor.step()
        if cursor.kind != MARK:
            if cursor.kind is END:
                cursor.fail(f"expected '{close[-1]}' {what}, found the end of the file")
            words.append(text)
            continue
        if len(words) > first:
            names.append(words[-1] if len(words) == first + 1 else " ".join(words[first:]))
            first = len(words)
        if text in close:
            return names, words
        if text != ",":
            cursor.fail(
                f"expected '{close[-1]}' {what}, found '{text}'; quote a name that holds it"
            )


def of_length(count: int, names: list[str], words: list[str]) -> list[str] | None:
    """Whichever division gives as many names as are due."""
    if len(names) == count:
        return names
    return words if len(words) == count else None


def declared(variables: Container[str], names: list[str], words: list[str]) -> list[str]:
    """Whichever division gives names of variables; that by commas, if neither does."""
    if all(name in variables for name in names) or any(name not in variables for name in words):
        return names
    return words
