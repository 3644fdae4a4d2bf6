"""The scripts of pages: modules as one text, which a page holds."""

from importlib.resources import files

# The modules of the viewer and of a report, in the order in which they build on one another.
VIEWING = (
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
REPORTING = (
    "numbers",
    "algebra",
    "text",
    "factors",
    "chain_source",
    "pictures",
    "plot",
    "trajectory",
    "controls",
    "charts",
    "report",
)


def script(names: tuple[str, ...]) -> str:
    """Modules one after the other, in a scope of their own."""
    folder = files("pgm.viewer").joinpath("script")
    modules = (folder.joinpath(f"{name}.js").read_text("utf-8") for name in names)
    return '"use strict";\n(() => {\n' + "\n".join(modules) + "\n})();\n"
