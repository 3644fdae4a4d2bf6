"""Builds the wheel: code without comments, the viewer minified, the archive deflated by zopfli."""

import ast
import io
import runpy
import tempfile
import tokenize
import zipfile
from pathlib import Path

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

# Over each file: the wheel is 3 % smaller than by zlib, and 5 passes would leave 0.06 % more.
PASSES = 40


class WheelHook(BuildHookInterface):
    """Puts code without comments and the minified viewer into a wheel, and writes it small."""

    def initialize(self, version, build_data):
        """Write them beside the wheel's other files; a checkout keeps its modules."""
        if version == "editable":
            return
        viewer = Path(self.root) / "pgm" / "viewer"
        texts = {
            "script.js": runpy.run_path(str(viewer / "scripts.py"))["joined"](),
            "viewer.css": (viewer / "viewer.css").read_text("utf-8"),
        }
        written = {f"pgm/viewer/{name}": minified(name, text) for name, text in texts.items()}
        for source in Path(self.root, "pgm").rglob("*.py"):
            place = source.relative_to(self.root).as_posix()
            written[place] = undescribed(uncommented(source.read_text("utf-8")))
        self.folder = tempfile.TemporaryDirectory()
        for place, text in written.items():
            file = Path(self.folder.name, place)
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(text, encoding="utf-8")
            build_data["force_include"][str(file)] = place

    def finalize(self, version, build_data, artifact_path):
        """Remove what was written for the build, and deflate the wheel again."""
        if version != "editable":
            self.folder.cleanup()
            deflate(Path(artifact_path))


def uncommented(text):
    """Code without comments, which are for readers of the repository: 3 % of the wheel.

    Docstrings stay, and every line keeps its number, for tracebacks.
    """
    lines = text.splitlines(keepends=True)
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type == tokenize.COMMENT:
            row, column = token.start
            lines[row - 1] = lines[row - 1][:column].rstrip() + "\n"
    return "".join(lines)


def undescribed(text):
    """Code without docstrings of private functions and classes, which `help` does not show either.

    They are 1.6 % of the wheel. Lines keep their numbers.
    """
    lines, found = text.splitlines(keepends=True), [(ast.parse(text), False)]
    while found:
        parent, private = found.pop()
        for node in ast.iter_child_nodes(parent):
            hidden = private or isinstance(parent, ast.FunctionDef)
            if isinstance(node, (ast.FunctionDef, ast.ClassDef)):
                hidden |= node.name.startswith("_") and not node.name.endswith("__")
                if hidden and ast.get_docstring(node) and len(node.body) > 1:
                    first, last = node.body[0].lineno, node.body[0].end_lineno
                    lines[first - 1 : last] = ["\n"] * (last - first + 1)
            found.append((node, hidden))
    return "".join(lines)


def minified(name, text):
    """The text of a script or a style sheet without what a browser does not need.

    Where the minifier publishes no binary (pyproject.toml excepts Apple's processors) it is
    missing, and the text stays as it is: larger, and the same to a browser.
    """
    try:
        from minify import string
    except ImportError:
        return text
    return string({".js": "text/javascript", ".css": "text/css"}[Path(name).suffix], text)


def deflate(path):
    """Write the zip archive again with zopfli's deflate streams; its members stay as they are."""
    from zopfli.zlib import compress  # an editable install does without

    with zipfile.ZipFile(path) as archive:
        members = [(member, archive.read(member)) for member in archive.infolist()]
    written = []
    with zipfile.ZipFile(path, "w") as archive:
        for member, data in members:
            entry = zipfile.ZipInfo(member.filename, member.date_time)
            entry.create_system = member.create_system
            entry.external_attr = member.external_attr
            # zlib's container: two bytes before the stream, its checksum of four after.
            archive.writestr(entry, compress(data, numiterations=PASSES)[2:-4])
            # `zipfile` takes no stream ready-made: it stored the bytes, and now is told their
            # content. The central directory is written when the archive closes.
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry.CRC, entry.file_size = member.CRC, member.file_size
            written.append(entry)
    with path.open("r+b") as file:
        for entry in written:
            file.seek(entry.header_offset)
            file.write(entry.FileHeader())
