"""The examples of docstrings give what they say."""

import doctest
import importlib
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


@pytest.mark.parametrize("name", MODULES)
def test_examples_run_as_written(name):
    found = doctest.testmod(importlib.import_module(name))
    plt.close("all")
    assert not found.failed
