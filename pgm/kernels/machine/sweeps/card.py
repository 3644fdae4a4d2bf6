"""Sweeps of a chain on a card, each run a thread of its own: the sweeps of `chain`, printed."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

from pgm.kernels.machine.emitter.card import Card, printed, thread
from pgm.kernels.machine.emitter.driver import Device
from pgm.kernels.machine.emitter.kinds import ADDRESS, WHOLE
from pgm.kernels.machine.emitter.module import Module
from pgm.kernels.machine.matrices.in_memory.frame import Frame
from pgm.kernels.machine.matrices.lines import Lines
from pgm.kernels.machine.matrices.loops import Loops
from pgm.kernels.machine.sweeps.chain import Chain, swept
from pgm.kernels.machine.sweeps.extent import is_long
from pgm.kernels.machine.sweeps.told import Forward
from pgm.kernels.machine.sweeps.writer import Writer

# The name of the kernel, ``pgm_sweep(table, first, last)``, and the kinds of its arguments.
SWEEP, KINDS = "sweep", (ADDRESS, WHOLE, WHOLE)


@lru_cache(maxsize=128)
def kernel(chain: Chain, capability: tuple[int, int], loops: bool | None = None) -> str:
    """The sweep of a chain as PTX, for a card of this compute capability or a later one.

    It is a kernel of a table, the first run, and the one after the last: the thread of number k
    sweeps run first + k. `loops` is as of `chain.made`; their matrices lie in memory of the
    thread's own. Raises a ValueError where functions of the program are called, or the capability
    is older than `emitter.card.OLDEST`, and an ImportError where libdevice is due and missing.
    """
    if isinstance(chain, Forward) and chain.asked is not None:
        raise ValueError("a card cannot call the functions of a program: they have to be traced")
    module = Module(target=Card(capability))
    code = module.function(SWEEP, KINDS)
    table, first, last = code.arguments
    frame = Frame.of_function(code)
    looped = is_long(chain, 1) if loops is None else loops
    with code.when(first + thread(code) < last):
        w = Writer(code, table, chain, Loops(code, frame) if looped else Lines(code))
        w.run = first + thread(code)
        swept(w, chain)
    frame.settle()
    return printed(module, [SWEEP], 1 if looped else 2)


@lru_cache(maxsize=128)
def loaded(chain: Chain, device: Device) -> Any:
    """The sweep of a chain on a card, ready to be launched there; see `kernel`."""
    with device.current():
        return device.kernel(kernel(chain, device.capability), SWEEP)
