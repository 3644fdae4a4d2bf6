"""The programs of a page: its blocks of Python, run one after the other in one namespace."""

from __future__ import annotations

import ast
import contextlib
import io
import re
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

ROOT = Path(__file__).parent.parent.parent
DOCS = ROOT / "docs"

# A fence of Python, and right behind it the text that it prints, where the page shows that. Before
# it a comment may name the test that runs it, where it needs what no page can give.
_BLOCK = re.compile(
    r"(?:^<!-- run by (?P<elsewhere>[\w/]+\.py) -->\n)?"
    r"^```python\n(?P<code>.*?)^```$(?:\s*?\n```text\n(?P<shown>.*?)^```$)?",
    flags=re.MULTILINE | re.DOTALL,
)
_NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?|\bnan\b|\binf\b")


@dataclass(frozen=True)
class Block:
    """A block of Python on a page.

    Attributes
    ----------
    line : int
        Of the page, on which the code begins.
    code : str
    shown : str or None
        The output that the page shows; None where it shows none.
    elsewhere : str or None
        The test that runs the block, where its page does not.
    """

    line: int
    code: str
    shown: str | None
    elsewhere: str | None = None

    @property
    def missing(self) -> list[str]:
        """The packages that the block needs and that are not installed."""
        found = {"llvmlite"} if "compiled=True" in self.code else set()
        found |= {"pymap3d"} if "latitude" in self.code or "datum" in self.code else set()
        for node in ast.walk(ast.parse(self.code)):
            if isinstance(node, ast.Import):
                found |= {alias.name.partition(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module is not None:
                found.add(node.module.partition(".")[0])
        return sorted(name for name in found if find_spec(name) is None)


@dataclass(frozen=True)
class Ran:
    """A block that has run, and what it printed; `skipped` names the packages it lacked."""

    block: Block
    printed: str
    skipped: tuple[str, ...] = ()


def pages() -> list[Path]:
    """The README, and all pages of the site, that hold programs."""
    found = [ROOT / "README.md", *sorted(DOCS.rglob("*.md"))]
    return [page for page in found if _BLOCK.search(page.read_text(encoding="utf-8"))]


def blocks(text: str) -> list[Block]:
    """The blocks of Python of a page's text, in their order."""
    return [
        Block(
            text.count("\n", 0, match.start("code")) + 1,
            match["code"],
            match["shown"],
            match["elsewhere"],
        )
        for match in _BLOCK.finditer(text)
    ]


def run(page: Path) -> Iterator[Ran]:
    """Run the blocks of a page in the working directory, one after the other.

    A block whose packages are not installed is passed over, and says so; so is one of a test's.
    """
    names: dict[str, object] = {"__name__": "__main__"}
    for block in blocks(page.read_text(encoding="utf-8")):
        if block.elsewhere:
            yield Ran(block, "")
            continue
        if block.missing:
            yield Ran(block, "", tuple(block.missing))
            continue
        printed = io.StringIO()
        # Blank lines before the code, so that a traceback tells the page's own line.
        code = compile("\n" * (block.line - 1) + block.code, str(page), "exec")
        with contextlib.redirect_stdout(printed):
            exec(code, names)
        yield Ran(block, printed.getvalue())


def agree(shown: str, printed: str, *, relative: float = 2e-3, absolute: float = 2e-6) -> bool:
    """Whether two outputs have the same words, and numbers that differ by rounding alone."""
    words = [" ".join(_NUMBER.sub("#", text).split()) for text in (shown, printed)]
    if words[0] != words[1]:
        return False
    pairs = zip(_NUMBER.findall(shown), _NUMBER.findall(printed), strict=True)
    return all(_close(float(a), float(b), relative, absolute) for a, b in pairs)


def _close(a: float, b: float, relative: float, absolute: float) -> bool:
    if a != a or b != b:
        return a != a and b != b
    return a == b or abs(a - b) <= absolute + relative * max(abs(a), abs(b))


def with_output(text: str, ran: list[Ran]) -> str:
    """A page's text with each output that it shows replaced by what was printed."""
    printed = iter(ran)

    def renewed(match: re.Match[str]) -> str:
        result = next(printed)
        if match["shown"] is None or result.skipped or agree(match["shown"], result.printed):
            return match[0]
        start, end = match.span("shown")
        whole, offset = match[0], match.start()
        lines = (line.rstrip() for line in result.printed.rstrip().splitlines())
        return whole[: start - offset] + "\n".join(lines) + "\n" + whole[end - offset :]

    return _BLOCK.sub(renewed, text)
