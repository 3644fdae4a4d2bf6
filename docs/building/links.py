"""A Sphinx extension: bare names lead to the reference, whichever module documents them.

Sphinx looks in the module of which a docstring is; but results have a module of their own.
"""

from __future__ import annotations

from collections.abc import Container
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from docutils.nodes import Element
    from sphinx.application import Sphinx
    from sphinx.environment import BuildEnvironment

_SPACES = ("pgm", "pgm.results")


def place(name: str, module: str | None, known: Container[str]) -> str | None:
    """The whole name of what a docstring of a module means by a bare one; None if it is nothing.

    Small letters may be those of an argument; only results mean functions of the package by them.
    """
    if name[:1].isupper() or module == "pgm.results":
        for space in _SPACES:
            if f"{space}.{name}" in known:
                return f"{space}.{name}"
    return None


def _resolve(app: Sphinx, env: BuildEnvironment, node: Element, content: Element) -> Any:
    from sphinx.util.nodes import make_refnode

    if node.get("refdomain") != "py":
        return None
    objects = env.domains.python_domain.objects
    whole = place(node["reftarget"], node.get("py:module"), objects)
    if whole is None:
        return None
    found = objects[whole]
    return make_refnode(app.builder, node["refdoc"], found.docname, found.node_id, content, whole)


def setup(app: Sphinx) -> dict[str, Any]:
    """Look for names that Sphinx does not find."""
    app.connect("missing-reference", _resolve)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
