"""The page: template, style, script and data in one file that asks nothing of a network."""

from __future__ import annotations

import base64
import hashlib
import json
from importlib.resources import files
from typing import Any

from pgm.viewer.numbers import Numbers
from pgm.viewer.scripts import script


def assembled(data: dict[str, Any], numbers: Numbers) -> str:
    """The text of the page.

    Parameters
    ----------
    data : dict
        Its structure, of what JSON can hold.
    numbers : Numbers

    Returns
    -------
    str
    """
    folder = files("pgm.viewer")
    style = folder.joinpath("viewer.css").read_text("utf-8")
    code = script()
    parts = {
        "{{policy}}": _policy(code, style),
        "{{style}}": style,
        "{{data}}": embedded(data),
        "{{numbers}}": numbers.text(),
        "{{script}}": code,
    }
    before, rest = folder.joinpath("page.html").read_text("utf-8"), ""
    # Each mark once, in order: what a user wrote may hold the text of another.
    found = []
    for mark, text in parts.items():
        head, _, rest = before.partition(mark)
        found += [head, text]
        before = rest
    return "".join([*found, before])


def embedded(data: Any) -> str:
    """JSON that is safe inside a script element: nothing in it ends the element or begins one."""
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
