"""The tutorials as notebooks: ``python docs/building/notebooks.py build/notebooks``.

A tutorial is a page of Markdown whose blocks of Python are the cells. A notebook draws its own
pictures and shows all its cells.
"""

from __future__ import annotations

import re
import shutil
import sys
from pathlib import Path

import jupytext
from nbformat import NotebookNode

DOCS = Path(__file__).parent.parent
TUTORIALS = sorted(page for page in (DOCS / "tutorials").glob("*.md") if page.stem != "index")


# A picture that the page begins with, and the tags around a block that the site folds.
_OF_SITE = re.compile(
    r"^(!\[.*\]\(\.\./images/.*\)|</?details>|<summary>.*</summary>)\n", re.MULTILINE
)


def notebook(page: Path) -> NotebookNode:
    """A page as a notebook: its blocks of Python are cells, all else is text between them."""
    found = jupytext.reads(_OF_SITE.sub("", page.read_text(encoding="utf-8")), fmt="md")
    found.metadata["kernelspec"] = {
        "display_name": "Python 3",
        "language": "python",
        "name": "python3",
    }
    return found


def write(folder: Path) -> None:
    """Write all tutorials, and beside them the recording that one of them reads."""
    (folder / "docs").mkdir(parents=True, exist_ok=True)
    shutil.copy2(DOCS / "log.csv", folder / "docs" / "log.csv")
    for page in TUTORIALS:
        target = folder / f"{page.stem}.ipynb"
        jupytext.write(notebook(page), target)
        sys.stdout.write(f"{target}\n")


if __name__ == "__main__":
    write(Path(sys.argv[1]))
