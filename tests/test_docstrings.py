"""The examples of docstrings give what they say, and each public name has one."""

import doctest
import importlib
import inspect
from pathlib import Path

import numpy as np
import pytest

import pgm

PACKAGE = Path(pgm.__file__).parent
MODULES = [
    ".".join(path.relative_to(PACKAGE.parent).with_suffix("").parts)
    for path in sorted(PACKAGE.rglob("*.py"))
    if ">>> " in path.read_text(encoding="utf-8")
]
# The modules of which each name that a user calls has an example.
PUBLIC = [
    "pgm",
    "pgm.comparison",
    "pgm.consistency",
    "pgm.io",
    "pgm.learning",
    "pgm.linearisers",
    "pgm.maps",
    "pgm.plot",
    "pgm.recordings",
    "pgm.results",
]


def called(module):
    """The names of a module that a user calls, neither modules nor errors, with their values."""
    for name in importlib.import_module(module).__all__:
        value = getattr(importlib.import_module(module), name)
        if callable(value) and not (inspect.isclass(value) and issubclass(value, Exception)):
            yield f"{module}.{name}", value


def has_example(value):
    """Whether the docstring of a value has an example that is run."""
    examples = doctest.DocTestParser().get_examples(inspect.getdoc(value) or "")
    return not all(example.options.get(doctest.SKIP) for example in examples)


@pytest.mark.parametrize("name", MODULES)
def test_examples_run_as_written(name):
    found = doctest.testmod(importlib.import_module(name), extraglobs={"pgm": pgm, "np": np})
    assert not found.failed


@pytest.mark.parametrize("module", PUBLIC)
def test_each_name_that_is_called_has_an_example_that_is_run(module):
    names = dict(called(module))
    assert names
    assert not [name for name, value in names.items() if not has_example(value)]


def explained(value):
    """The parameters of a docstring's section, each with the words that explain it."""
    lines = inspect.getdoc(value).split("Parameters\n----------\n")[1].split("\n\n")[0].split("\n")
    found = {}
    for line in lines:
        if not line.startswith(" "):
            found[name := line.partition(" :")[0]] = ""
        else:
            found[name] += line.strip() + " "
    return found


@pytest.mark.parametrize("value", [pgm.filter, pgm.smooth, pgm.OnlineFilter, pgm.infer, pgm.audit])
def test_each_parameter_is_explained_where_it_stands(value):
    found = explained(value)
    assert list(found) == list(inspect.signature(value).parameters)
    for name, words in found.items():
        assert len(words) > 20, name
        assert not words.startswith(("See ", "As ")), name


@pytest.mark.parametrize(
    ("value", "names"),
    [
        (pgm.filter, "Kalman extended unscented cubature iterated"),
        (pgm.smooth, "Kalman Rauch–Tung–Striebel extended unscented cubature Gauss–Newton"),
        (pgm.OnlineFilter, "Kalman extended unscented Rauch–Tung–Striebel"),
    ],
)
def test_filters_are_found_by_their_names(value, names):
    told = inspect.getdoc(value).split("Parameters\n")[0]
    assert [name for name in names.split() if name not in told] == []
