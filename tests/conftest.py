"""How the tests run: property tests draw the same examples everywhere, and are not timed."""

import gc
import sys
from functools import partialmethod

import pytest
from hypothesis import settings

gc.disable()  # until all tests are collected
settings.register_profile("everywhere", deadline=None, derandomize=True, max_examples=30)
# pytest --hypothesis-profile=thorough draws many, and others each time.
settings.register_profile("thorough", deadline=None, max_examples=1000)
settings.load_profile("everywhere")

# Folders of long tests come first, so that no worker is left alone with one.
LONG = tuple(f"tests/{folder}/" for folder in ("experiments", "viewer", "docs", "plot"))


def pytest_configure(config):
    """Sort files as they come, where workers share them."""
    if getattr(config.option, "numprocesses", None):
        config.option.loadscopereorder = False
    if config.option.markexpr == "slow":
        check_machine_code()


@pytest.fixture(autouse=True)
def _figures_are_closed():
    """Leave no figure of pyplot to the next test: Matplotlib warns of the twenty-first."""
    yield
    if pyplot := sys.modules.get("matplotlib.pyplot"):
        pyplot.close("all")


def check_machine_code():
    """Have machine code test each index and alignment, as it does in the slow tests."""
    from pgm.kernels.machine.emitter.module import Module

    Module.__init__ = partialmethod(Module.__init__, checked=True)


def pytest_collection_modifyitems(items):
    """Sort by folders."""
    items.sort(key=lambda item: not item.nodeid.startswith(LONG))


def pytest_collection_finish():
    """Let the collector of garbage pass by what stays to the end: modules and tests."""
    gc.freeze()
    gc.enable()
