"""A Sphinx extension: a page's programs are run, and what they draw is shown below them."""

from __future__ import annotations

import contextlib
import os
import shutil
import tempfile
import warnings
from pathlib import Path
from typing import Any

import matplotlib
from docutils import nodes
from PIL import Image
from sphinx.application import Sphinx
from sphinx.errors import ExtensionError
from sphinx.transforms import SphinxTransform

from building import programs

_DPI = 160  # twice a screen's, for letters that stay sharp
_TEXT = 720  # dots that a line of text is wide
_FILES = {".gif", ".html"}
_LIVE = "_views"  # the folder of the viewer's pages, within the site
_GRID = "gallery"  # the page that begins with its pictures, small, as links to them


class Pictures(SphinxTransform):
    """Run the programs of a page that draws, and show after each block what it has drawn."""

    default_priority = 200  # before images are collected

    def apply(self, **kwargs: Any) -> None:
        """Put images behind the blocks of Python that drew them."""
        page = Path(self.env.doc2path(self.env.docname))
        if page.suffix != ".md" or not draws(page):
            return
        target = Path(self.app.outdir).parent / "pictures" / self.env.docname
        found = drawn(page, target)
        literal = [
            node
            for node in self.document.findall(nodes.literal_block)
            if node.get("language") == "python"
        ]
        if len(literal) != len(found):
            raise ExtensionError(
                f"{page}: {len(literal)} blocks of Python are shown and {len(found)} were run"
            )
        for node, paths in zip(literal, found, strict=True):
            where = _last_of_block(node)
            for path, width in reversed(paths):
                shown = self._live(path) if path.suffix == ".html" else _image(page, path, width)
                where.parent.insert(where.parent.index(where) + 1, shown)
        if self.env.docname == _GRID:
            first = next(self.document.findall(nodes.paragraph))
            first.parent.insert(first.parent.index(first) + 1, _grid(self.document))

    def _live(self, path: Path) -> nodes.Node:
        """A page of the viewer, in a frame: a copy of it becomes part of the site."""
        name = f"{self.env.docname.replace('/', '-')}-{path.name}"
        folder = Path(self.app.outdir) / _LIVE
        folder.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(path, folder / name)
        up = "../" * self.env.docname.count("/")
        frame = (
            f'<iframe class="drawn" src="{up}{_LIVE}/{name}" sandbox="allow-scripts" '
            'loading="lazy" title="the page that the program above writes"></iframe>'
        )
        return nodes.raw("", frame, format="html")


def draws(page: Path) -> bool:
    """Whether a page's programs draw at all; others are run by the tests alone."""
    code = "".join(block.code for block in programs.blocks(page.read_text(encoding="utf-8")))
    return any(word in code for word in ("pgm.plot.", "plt.", "pgm.view("))


def drawn(page: Path, target: Path) -> list[list[tuple[Path, int]]]:
    """The pictures of each block of a page, as files, and their widths on a screen."""
    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    target.mkdir(parents=True, exist_ok=True)
    result: list[list[tuple[Path, int]]] = []
    with (
        tempfile.TemporaryDirectory() as place,
        contextlib.chdir(place),
        warnings.catch_warnings(),
    ):
        os.symlink(programs.DOCS, Path(place) / "docs")
        warnings.simplefilter("error")
        warnings.simplefilter("default", DeprecationWarning)
        # Of these some pages tell, and their readers see them.
        for told in ("the belief was lost", "functions bend so much over the beliefs"):
            warnings.filterwarnings("ignore", told)
        known: set[Path] = set()
        for k, _ in enumerate(programs.run(page)):
            paths = []
            for number in plt.get_fignums():
                figure = plt.figure(number)
                path = target / f"{k}-{number}.png"
                # Diagrams have room for a title, which is blank where they have none.
                cut = {"bbox_inches": "tight", "pad_inches": 0.04} if _untitled(figure) else {}
                figure.savefig(path, dpi=_DPI, **cut)
                with Image.open(path) as picture:
                    paths.append((path, round(picture.width * 80 / _DPI)))
            plt.close("all")
            moving = {p for p in Path().iterdir() if p.suffix in _FILES} - known
            known |= moving
            for source in sorted(moving):
                path = target / source.name
                path.write_bytes(source.read_bytes())
                paths.append((path, _width(path)))
            result.append(paths)
    return result


def _untitled(figure: Any) -> bool:
    """Whether it is a diagram, without axes, that has no title."""
    return any(not ax.axison and not ax.get_title() for ax in figure.axes[:1])


def _width(path: Path) -> int:
    """Of a moving picture, or of a page, which is as wide as the text."""
    if path.suffix == ".html":
        return _TEXT
    with Image.open(path) as picture:
        return min(picture.width, _TEXT)


def _image(page: Path, path: Path, width: int) -> nodes.Node:
    uri = os.path.relpath(path, page.parent)
    alt = "the picture that the program above draws"
    return nodes.image(uri=uri, alt=alt, width=f"{width}px", classes=["drawn"])


def _grid(document: nodes.document) -> nodes.Node:
    """The first picture of each section that has one, with its title, as a link to the section."""
    grid = nodes.container(classes=["thumbnails"])
    for section in document.findall(nodes.section):
        own = [child for child in section.children if isinstance(child, nodes.image)]
        if own:
            picture = nodes.image(uri=own[0]["uri"], alt="", classes=["thumbnail"])
            title = nodes.inline("", section.next_node(nodes.title).astext())
            link = nodes.reference("", "", picture, title, refid=section["ids"][0], internal=True)
            grid += nodes.paragraph("", "", link)
    return grid


def _last_of_block(node: nodes.Element) -> nodes.Element:
    """The block itself, or the output that stands right behind it."""
    after = node.next_node(descend=False, siblings=True)
    if isinstance(after, nodes.literal_block) and after.get("language") == "text":
        return after
    return node


def setup(app: Sphinx) -> dict[str, Any]:
    """Tell Sphinx of the transform."""
    app.add_transform(Pictures)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
