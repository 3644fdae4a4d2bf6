"""Write the output that pages show anew: ``python docs/building/renew.py docs/guide/grids.md``."""

from __future__ import annotations

import contextlib
import os
import sys
import tempfile
from pathlib import Path

import matplotlib

sys.path[:0] = [str(Path(__file__).parent.parent), str(Path(__file__).parent.parent.parent)]

from building import programs


def renew(page: Path) -> None:
    """Run a page's programs and write what they print where the page shows it."""
    with tempfile.TemporaryDirectory() as place, contextlib.chdir(place):
        os.symlink(programs.DOCS, Path(place) / "docs")
        ran = list(programs.run(page))
    text = page.read_text(encoding="utf-8")
    page.write_text(programs.with_output(text, ran), encoding="utf-8")
    for each in ran:
        if each.printed and each.block.shown is None:
            sys.stdout.write(f"{page.name}:{each.block.line} prints\n{each.printed}")


if __name__ == "__main__":
    matplotlib.use("Agg")
    for name in sys.argv[1:]:
        renew(Path(name).resolve())
