"""The examples of docstrings give what they say, and each public name has one."""

import doctest
import importlib
import inspect
from pathlib import Path

import matplotlib.pyplot as plt
import pytest

import pgm

PACKAGE = Path(pgm.__file__).parent
MODULES = [
    ".".join(path.relative_to(PACKAGE.parent).with_suffix("").parts)
    for path in sorted(PACKAGE.rglob("*.py"))
    if ">>> " in path.read_text(encoding="utf-8")
]
# The modules whose public names are documented by examples.
PUBLIC = [
    "pgm",
    "pgm.linearisers",
]
# Parts of the package whose names in `pgm` have no examples yet.
WITHOUT = ("pgm.comparison.", "pgm.io.", "pgm.viewer.")


def called(module):
    """The names of a module that a user calls: neither modules nor errors."""
    for name in importlib.import_module(module).__all__:
        value = getattr(importlib.import_module(module), name)
        error = inspect.isclass(value) and issubclass(value, Exception)
        if callable(value) and not error and not value.__module__.startswith(WITHOUT):
            yield f"{module}.{name}", value


@pytest.mark.parametrize("name", MODULES)
def test_examples_run_as_written(name):
    found = doctest.testmod(importlib.import_module(name))
    plt.close("all")
    assert not found.failed


@pytest.mark.parametrize("module", PUBLIC)
def test_each_name_that_is_called_has_an_example_that_runs(module):
    parser = doctest.DocTestParser()
    without = [
        name
        for name, value in called(module)
        if all(
            example.options.get(doctest.SKIP)
            for example in parser.get_examples(inspect.getdoc(value) or "")
        )
    ]
    assert not without
