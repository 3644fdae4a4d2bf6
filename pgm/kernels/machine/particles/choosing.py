"""Systematic resampling in machine code; see `pgm.kernels.resampling.systematic`.

Of n particles with weights w, and an offset u in [0, 1), the level j + u, j = 0, ..., n − 1, falls
to the first particle whose cumulative weight, n Σ w / total, exceeds it. Cumulative weights are
summed within a block, beginning with those of the blocks before: a level on a block's edge falls to
one of the two, as both have the edge to the last digit.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

from pgm.kernels.machine.emitter.code import Code
from pgm.kernels.machine.emitter.memory import Memory
from pgm.kernels.machine.emitter.module import Module
from pgm.kernels.machine.emitter.numbers import Number
from pgm.kernels.machine.emitter.wholes import Whole
from pgm.kernels.machine.particles.blocks import KINDS, each_block
from pgm.kernels.machine.studies.sums import Given


@lru_cache(maxsize=1)
def adding() -> Callable[..., None]:
    """The function that sums weights by block, one after another.

    Its numbers are the blocks, the weights and the sums.
    """
    code = Module(contract=False).function("added", KINDS)
    given = Given(code, code.arguments[0])
    shares, weights, sums = (given.address() for _ in range(3))
    with each_block(code, shares) as block:
        own, total = Memory(code, weights + block.first), code.varying(0.0)
        with code.loop(block.size) as i:
            total.set(total.get() + own.load(i))
        Memory(code, sums).store(block.number, total.get())
    return code.module.compile().callable("added")


@lru_cache(maxsize=1)
def choosing() -> Callable[..., None]:
    """The function that puts the place of each chosen particle.

    Its numbers are the blocks; the weights; of each block, the sum of the weights of its run before
    it; of each run, the sum of all, the number n, the offset u, all floats, and the first place;
    and the places.
    """
    code = Module(contract=False).function("chosen", KINDS)
    given = Given(code, code.arguments[0])
    shares, weights, bases = (given.address() for _ in range(3))
    totals, numbers, offsets, starts, chosen = (given.address() for _ in range(5))
    with each_block(code, shares) as block:
        run = block.run
        base = Memory(code, bases).load(block.number)
        total, number, offset = (
            Memory(code, each).load(run) for each in (totals, numbers, offsets)
        )
        out = code.wholes(chosen.moved(code.wholes(starts).load(run), "i64"))
        own, sum_ = Memory(code, weights + block.first), code.varying(0.0)
        level = code.variable(_levels(code, base, total, number, offset))
        with code.loop(block.size) as i:
            sum_.set(sum_.get() + own.load(i))
            below = _levels(code, base + sum_.get(), total, number, offset)
            with code.loop(below, level.get()) as j:
                out.store(j, block.first + i)
            level.set(below)
    return code.module.compile().callable("chosen")


def _levels(code: Code, edge: Number, total: Number, number: Number, offset: Number) -> Whole:
    """How many levels are below an edge: all of them below the last."""
    found = (edge / total * number - offset).intrinsic("ceil")
    return (edge >= total).where(number, found).whole()
