"""The site: ``make docs`` builds it into build/docs."""

import sys
from pathlib import Path

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), str(HERE.parent)]

from numpydoc.xref import DEFAULT_LINKS
from pygments.lexers.special import TextLexer
from sphinx.highlighting import lexers

import pgm

lexers["csv"] = TextLexer()

project = "pgm"
author = "The pgm developers"
copyright = "The pgm developers"  # Sphinx's own name for it
version = release = pgm.__version__

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "numpydoc",
    "sphinx.ext.mathjax",
    "sphinx_copybutton",
    "building.docstrings",
    "building.links",
    "building.mathjax",
    "building.pictures",
]
exclude_patterns = ["building"]

myst_enable_extensions = ["dollarmath", "amsmath", "deflist"]
myst_heading_anchors = 3
myst_dmath_double_inline = True

autosummary_generate = False
autodoc_member_order = "bysource"
autodoc_typehints = "none"  # docstrings say types and shapes
autodoc_default_options = {"members": True, "inherited-members": False}
numpydoc_show_class_members = False  # autodoc does
numpydoc_class_members_toctree = False
numpydoc_xref_param_type = True
# Types of Python and NumPy are words: links to them would need the network.
numpydoc_xref_aliases = {word: word for word in DEFAULT_LINKS}
numpydoc_xref_ignore = {
    *DEFAULT_LINKS,
    *("optional", "of", "or", "and", "to", "mapping", "pair", "collection", "numpy.ndarray"),
}
default_role = "py:obj"
python_use_unqualified_type_names = True
add_module_names = False

html_theme = "furo"
html_title = "pgm"
html_static_path = ["_static"]
html_css_files = ["pgm.css"]
html_copy_source = False
html_show_sphinx = False
pygments_style = "friendly"
pygments_dark_style = "monokai"
copybutton_exclude = ".linenos, .gp, .go"
