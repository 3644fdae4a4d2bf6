"""A Sphinx extension: MathJax stands on the site itself, so that formulas need no network.

The files come from the package sphinx-mathjax-offline, of which a page needs the typesetter of TeX
and its fonts, one megabyte and a half of twenty-four.
"""

from __future__ import annotations

import shutil
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from sphinx.application import Sphinx
from sphinx.errors import ConfigError

_PACKAGE = "sphinx-mathjax-offline"
_FILES = ("tex-chtml.js", "output/chtml/fonts")


def _copy(app: Sphinx, exception: Exception | None) -> None:
    found = find_spec(_PACKAGE)
    if exception is not None or found is None or found.origin is None:
        return
    source = Path(found.origin).parent / "static" / "mathjax"
    for name in _FILES:
        target = Path(app.outdir) / "_static" / "mathjax" / name
        target.parent.mkdir(parents=True, exist_ok=True)
        if (source / name).is_dir():
            shutil.copytree(source / name, target, dirs_exist_ok=True)
        else:
            shutil.copy2(source / name, target)


def setup(app: Sphinx) -> dict[str, Any]:
    """Name the file that pages load, and copy it with its fonts when the site is built."""
    if find_spec(_PACKAGE) is None:
        raise ConfigError(f"the package {_PACKAGE} is not installed: pip install '.[docs]'")
    app.config.mathjax_path = "mathjax/tex-chtml.js"
    app.connect("build-finished", _copy)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
