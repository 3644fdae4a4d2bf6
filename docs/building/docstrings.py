"""A Sphinx extension: docstrings as they are written are read as reStructuredText.

They are plain text first: shapes are ``(*runs, n)``, norms are |x|, and a formula may be an
indented paragraph. Stars and bars that mark nothing are escaped, such paragraphs keep their lines.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sphinx.application import Sphinx

_LITERAL = re.compile(r"(``.*?``|`[^`]*`)")
_ENDED = re.compile(r"((?<!`)`[^`]+`)(?=[a-z])")  # `Gaussian`s
_EMPHASIS = re.compile(r"(?<![\w(*])\*(?=\w)([^*]*\w)\*(?!\w)")
_ARGUMENTS = re.compile(r"^\*{1,2}\w+(\s*:.*)?$")  # `**style`, the name of a parameter


def escaped(lines: list[str]) -> list[str]:
    """The lines of a docstring, with the signs escaped that would else be read as markup."""
    result: list[str] = []
    directive: int | None = None  # how far one is indented whose body goes on
    example = False
    for line in lines:
        indent = len(line) - len(line.lstrip())
        text = line.strip()
        example = text.startswith(">>>") or (example and bool(text))
        if text.startswith(".. "):
            directive = indent
        elif directive is not None and text and indent <= directive:
            directive = None
        if example or directive is not None or _ARGUMENTS.match(text):
            result.append(line)
            continue
        parts = _LITERAL.split(line)
        parts[::2] = [_escape(part) for part in parts[::2]]
        result.append(_ENDED.sub(r"\1\\ ", "".join(parts)))
    return result


def _escape(text: str) -> str:
    kept = _EMPHASIS.sub("\0\\1\1", text)
    return kept.replace("*", r"\*").replace("|", r"\|").replace("\0", "*").replace("\1", "*")


def with_formulas(lines: list[str]) -> list[str]:
    """The lines, with indented paragraphs before the first section as blocks of their own."""
    result: list[str] = []
    for k, line in enumerate(lines):
        if set(line.strip()) == {"-"}:
            return result + lines[k:]
        begins = line.startswith("    ") and (k == 0 or not lines[k - 1].strip())
        goes_on = any(before.startswith(("    ", "   ")) for before in _paragraph_before(lines, k))
        if begins and not goes_on:
            result += [".. code-block:: none", "", line]
        else:
            result.append(line)
    return result


def _paragraph_before(lines: list[str], k: int) -> list[str]:
    """The last line with text above a line, if it is indented or a directive."""
    for line in reversed(lines[:k]):
        if line.strip():
            return [line] if line.startswith("   ") else ["   "] if line.startswith("..") else []
    return []


def _process(app: Sphinx, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    lines[:] = escaped(with_formulas(lines))


def setup(app: Sphinx) -> dict[str, Any]:
    """Read docstrings before numpydoc does."""
    app.connect("autodoc-process-docstring", _process, priority=400)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
