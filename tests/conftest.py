"""How the tests run: property tests draw the same examples everywhere, and are not timed."""

import subprocess
import sys
from importlib.util import find_spec

from hypothesis import settings

settings.register_profile("everywhere", deadline=None, derandomize=True, max_examples=50)
# pytest --hypothesis-profile=thorough draws many, and others each time.
settings.register_profile("thorough", deadline=None, max_examples=1000)
settings.load_profile("everywhere")

KERNELS = ("forward", "backward", "online"), ("forward_together", "backward_together", "newton")
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


def pytest_configure(config):
    """Have machine code on the disk, half of it by each process, before workers each compile it."""
    if not getattr(config.option, "numprocesses", None) or find_spec("numba") is None:
        return
    each = [[sys.executable, "-c", COMPILED.format(names)] for names in KERNELS]
    for process in [subprocess.Popen(command) for command in each]:
        process.wait()
