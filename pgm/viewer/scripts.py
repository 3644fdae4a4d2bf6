"""The viewer's script: one text of its modules, which a built wheel holds ready."""

import re
from pathlib import Path

FOLDER = Path(__file__).parent
# In the order in which they build on one another.
SCRIPTS = (
    "numbers",
    "algebra",
    "text",
    "factors",
    "graph_source",
    "chain_source",
    "drawing",
    "pictures",
    "inspector",
    "plot",
    "trajectory",
    "controls",
    "main",
)


def script() -> str:
    """The script of a page: as the wheel has it, or of the modules of a checkout."""
    packed = FOLDER / "script.js"
    return packed.read_text("utf-8") if packed.is_file() else joined()


def joined() -> str:
    """The modules one after the other, without their comments and indents, as a page needs them."""
    modules = (FOLDER.joinpath("script", f"{name}.js").read_text("utf-8") for name in SCRIPTS)
    lean = re.sub(r"^\s*//.*\n|^[ \t]+", "", "\n".join(modules), flags=re.MULTILINE)
    return '"use strict";\n(() => {\n' + lean + "\n})();\n"
