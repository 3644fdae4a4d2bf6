"""Pages as text: their style, data, numbers and script in one file, which asks for nothing else."""

import base64
import hashlib
import json
from importlib.resources import files
from typing import Any, NamedTuple

from pgm.viewer.numbers import Numbers
from pgm.viewer.scripts import REPORTING, VIEWING, script


class Page(NamedTuple):
    """The parts of a kind of page: its HTML, its styles, and the modules of its script."""

    html: str
    styles: tuple[str, ...]
    modules: tuple[str, ...]


VIEWER = Page("page.html", ("viewer.css",), VIEWING)
REPORT = Page("report.html", ("viewer.css", "report.css"), REPORTING)


def assembled(data: dict[str, Any], numbers: Numbers, page: Page = VIEWER) -> str:
    """The text of a page."""
    folder = files("pgm.viewer")
    style = "\n".join(folder.joinpath(name).read_text("utf-8") for name in page.styles)
    code = script(page.modules)
    parts = {
        "{{policy}}": _policy(code, style),
        "{{style}}": style,
        "{{data}}": embedded(data),
        "{{numbers}}": numbers.text(),
        "{{script}}": code,
    }
    before, rest = folder.joinpath(page.html).read_text("utf-8"), ""
    # Each mark once, in order: what a user wrote may hold the text of another.
    found = []
    for mark, text in parts.items():
        head, _, rest = before.partition(mark)
        found += [head, text]
        before = rest
    return "".join([*found, before])


def embedded(data: Any) -> str:
    """JSON escaped so that it cannot end or begin a script element."""
    text = json.dumps(data, ensure_ascii=True, allow_nan=False, separators=(",", ":"))
    for mark in "<>&":
        text = text.replace(mark, f"\\u{ord(mark):04x}")
    return text


def _policy(script: str, style: str) -> str:
    """A policy that lets this script and this style in, and nothing from anywhere else."""
    own = {"script-src": script, "style-src": style}
    hashes = [f"{what} 'sha256-{_hash(text)}'" for what, text in own.items()]
    return "; ".join(["default-src 'none'", *hashes, "base-uri 'none'", "form-action 'none'"])


def _hash(text: str) -> str:
    return base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()
