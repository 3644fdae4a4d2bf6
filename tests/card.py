"""Code that is printed for a card: run by an interpreter, and assembled by NVIDIA's `ptxas`."""

import subprocess
from functools import cache
from importlib.util import find_spec
from pathlib import Path

import pytest
from fake_driver import install
from ptx import Program

from pgm.kernels.machine.emitter import card as target
from pgm.kernels.machine.emitter import driver as drivers
from pgm.kernels.machine.sweeps import card
from pgm.kernels.machine.sweeps import chain as sweeps

CAPABILITIES = ((7, 5), (8, 0), (9, 0))
# Threads of a block, few, so that there are several blocks, of which the last is not full.
THREADS = 2
_PTXAS = "cuda_nvcc/bin/ptxas"


def ptxas():
    """Where NVIDIA's assembler lies; tests that need it are skipped where it is not installed."""
    places = getattr(find_spec("nvidia"), "submodule_search_locations", None) or ()
    found = [path for each in places if (path := Path(each) / _PTXAS).is_file()]
    if not found:
        pytest.skip("ptxas is not installed: pip install nvidia-cuda-nvcc-cu12")
    return found[0]


def needs_libdevice():
    """A module of tests is skipped where NVIDIA's elementary functions are not installed."""
    try:
        target.libdevice()
    except ImportError as error:
        pytest.skip(str(error), allow_module_level=True)


def assembled(text, capability, to):
    """What `ptxas` says of code for cards of a capability, and the length of what it makes."""
    out = to / "kernel.cubin"
    (to / "kernel.ptx").write_text(text)
    command = [ptxas(), f"-arch=sm_{capability[0]}{capability[1]}", "-o", out, to / "kernel.ptx"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stderr, out.stat().st_size


@cache
def program(chain, loops):
    """The program of a chain's sweep, ready to run."""
    return Program(card.kernel(chain, (8, 0), loops))


def on_a_card(monkeypatch, loops=None):
    """Make sweeps run as a card would; returns the chains that have run, in order."""
    launched = []

    def made(chain, lanes, _=None):
        assert lanes == 1
        kernel = program(chain, loops)

        def sweep(table, first, last):
            launched.append(chain)
            blocks = -(-(last - first) // THREADS)
            kernel.launch("pgm_sweep", [table, first, last], blocks, THREADS)

        return sweep

    monkeypatch.setattr(sweeps, "made", made)
    return launched


def with_a(driver, monkeypatch):
    """Have the machine's card be that of a driver, None for no driver; returns it."""
    forget()
    return install(monkeypatch, driver)


def forget():
    """Have the next call look for the machine's card."""
    drivers.device.cache_clear()
    card.loaded.cache_clear()
