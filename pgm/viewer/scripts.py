"""The viewer's script: its modules as one text, which a page holds."""

from importlib.resources import files

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
    """The modules one after the other, in a scope of their own."""
    folder = files("pgm.viewer").joinpath("script")
    modules = (folder.joinpath(f"{name}.js").read_text("utf-8") for name in SCRIPTS)
    return '"use strict";\n(() => {\n' + "\n".join(modules) + "\n})();\n"
