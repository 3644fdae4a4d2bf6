"""How the tests run: property tests draw the same examples everywhere, and are not timed."""

import gc
import subprocess
import sys
from importlib.util import find_spec

import pytest
from hypothesis import settings

gc.disable()  # until all tests are collected
settings.register_profile("everywhere", deadline=None, derandomize=True, max_examples=30)
# pytest --hypothesis-profile=thorough draws many, and others each time.
settings.register_profile("thorough", deadline=None, max_examples=1000)
settings.load_profile("everywhere")

# Folders of long tests come first, so that no worker is left alone with one.
LONG = tuple(f"tests/{folder}/" for folder in ("experiments", "viewer", "docs", "plot"))
KERNELS = ("forward", "online"), ("forward_together", "backward_together", "backward", "newton")
COMPILED = """
from importlib import import_module
from pgm.kernels.compiled import sweeps
from pgm.kernels.compiled.memory import ready
for name in {}:
    if hasattr(sweeps, name):
        ready(getattr(sweeps, name), "int64(int64,int64,int64,int64)")
    else:
        import_module(f"pgm.kernels.compiled.{{name}}")
"""


COMPILERS = pytest.StashKey[list[subprocess.Popen]]()


def pytest_configure(config):
    """Begin to have machine code on the disk, before workers each compile it."""
    if not getattr(config.option, "numprocesses", None):
        return
    config.option.loadscopereorder = False
    if find_spec("llvmlite") is not None:
        each = [[sys.executable, "-c", COMPILED.format(names)] for names in KERNELS]
        config.stash[COMPILERS] = [subprocess.Popen(command) for command in each]


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_node_collection_finished(node):
    """Workers have collected meanwhile; their first test waits."""
    for process in node.config.stash.get(COMPILERS, []):
        process.wait()


def pytest_collection_modifyitems(items):
    """Sort by folders."""
    items.sort(key=lambda item: not item.nodeid.startswith(LONG))


def pytest_collection_finish():
    """Let the collector of garbage pass by what stays to the end: modules and tests."""
    gc.freeze()
    gc.enable()
