"""Forward sweeps that wait for functions that their program calls, for many runs at once."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from functools import lru_cache
from typing import NamedTuple

from pgm.kernels.machine.emitter.kinds import ADDRESS, WHOLE
from pgm.kernels.machine.emitter.module import Module
from pgm.kernels.machine.emitter.waiting import ALIGNED, Waiting, go_on
from pgm.kernels.machine.matrices.in_memory.frame import Frame
from pgm.kernels.machine.matrices.lines import Lines
from pgm.kernels.machine.matrices.loops import Loops
from pgm.kernels.machine.sweeps.chain import forward
from pgm.kernels.machine.sweeps.extent import is_long
from pgm.kernels.machine.sweeps.told import Forward
from pgm.kernels.machine.sweeps.writer import Writer

_FLOATS = ALIGNED // 8


class Asking(NamedTuple):
    """A sweep of packs that wait, each with a frame of so many `floats`, one next to another.

    ``begin(floats, frames, table, first, packs)`` sweeps packs of runs, from run `first` on, until
    they wait or have ended, and ``go_on(floats, frames, numbers, count)`` those packs further whose
    numbers stand in memory. Frames begin at a multiple of `waiting.ALIGNED` bytes, and stay where
    they are.
    """

    floats: int
    begin: Callable[[int, int, int, int, int], None]
    go_on: Callable[[int, int, int, int], None]


@lru_cache(maxsize=128)
def asking(chain: Forward, lanes: int, loops: bool | None = None) -> Asking:
    """The forward sweep of a chain, in which its program calls some functions.

    `loops` is as of `chain.made`.
    """
    module = Module()
    given = ADDRESS, WHOLE, ADDRESS, ADDRESS
    pack = module.function("pack", given, lanes=lanes, internal=True, inline=False, waits=True)
    table, run, frame, space = pack.arguments
    waiting, room = Waiting(pack, frame, size=table), Frame(pack, space)
    looped = is_long(chain, lanes) if loops is None else loops
    matrices = Loops(pack, room) if looped else Lines(pack)
    writer = Writer(pack, table, chain, matrices, waiting)
    writer.run = run
    forward(writer, chain)
    waiting.end()

    # How large a frame is, LLVM knows only once it has compiled the function.
    size = module.function("size", (ADDRESS,))
    nothing = size.address(0)
    size.call(pack, size.arguments[0], 0, nothing, nothing)

    begin = module.function("begin", (WHOLE, ADDRESS, ADDRESS, WHOLE, WHOLE))
    floats, frames, table, first, packs = begin.arguments
    with begin.loop(packs) as k:
        # Behind what the function keeps is the room of its matrices.
        here = frames + k * floats
        begin.call(pack, table, first + k * lanes, here, here + (floats - room.size))

    on = module.function("on", (WHOLE, ADDRESS, ADDRESS, WHOLE))
    floats, frames, numbers, count = on.arguments
    with on.loop(count) as k:
        go_on(on, frames + on.wholes(numbers).load(k) * floats)

    machine = module.compile()
    found = ctypes.c_int64()
    machine.callable("size")(ctypes.addressof(found))
    each = -(-found.value // ALIGNED) * _FLOATS + room.size
    return Asking(each, machine.callable("begin"), machine.callable("on"))
