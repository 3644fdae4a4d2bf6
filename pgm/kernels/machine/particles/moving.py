"""Particles moved by a transition: draws x_t ~ p(x_t | x_{t−1}), by counters.

Noise of a particle has the counters ``(index B + b, step, law, 0)``, b = 0, ..., B − 1 for the
⌈d / 4⌉ counters of d numbers, as of `pgm.networks.counted`; `index` is the particle's in its run,
which has a key of its own, and `law` the place of the CPD in the transition.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

from pgm.kernels import philox
from pgm.kernels.machine.emitter.code import Code
from pgm.kernels.machine.emitter.memory import Memory
from pgm.kernels.machine.emitter.module import Module
from pgm.kernels.machine.emitter.wholes import Address, Whole
from pgm.kernels.machine.particles.blocks import KINDS, Block, each_block
from pgm.kernels.machine.particles.laws import BEFORE, LawForm, LawWriter
from pgm.kernels.machine.studies.draws import fill, uniform
from pgm.kernels.machine.studies.normals import quantile
from pgm.kernels.machine.studies.sums import LANES, Given, each_pack, together


@lru_cache(maxsize=32)
def moving(size: int, laws: tuple[LawForm, ...], gathered: bool) -> Callable[..., None]:
    """The function that moves particles of `size` components by the laws of a transition.

    Its numbers are the blocks; the number of particles, the step, the row of the inputs; the states
    before and now, (size, particles); the place of each particle's
    ancestor, which is idle unless they are `gathered`; the keys (runs, 2); a check of each block,
    (blocks,), which is NaN where a state is not finite, else 0; and those of each law.
    """
    code = Module().function("moved", KINDS, lanes=LANES)
    given = Given(code, code.arguments[0])
    shares = given.address()
    width, step, row = (given.whole() for _ in range(3))
    before, now, ancestors, keys, checks = (given.address() for _ in range(5))
    writers = [LawWriter(form, given) for form in laws]
    rows = sorted({k for form in laws for k in _read(form)})
    room = code.room(size, "before")
    noise = [_Noise(code, form.height) for form in laws]
    with each_block(code, shares) as block:
        key = tuple(code.wholes(keys).load(block.run * 2 + k) for k in range(2))
        check = code.varying(0.0)
        with each_pack(code, block.size) as first:
            place = block.first + first
            old = Memory(code, before + place, step=width)
            if gathered:
                _gather(code, room, rows, before, width, ancestors.moved(place, "i64"))
                old = room
            new = Memory(code, now + place, step=width)
            for k, (form, writer, white) in enumerate(zip(laws, writers, noise, strict=True)):
                white.draw((key[0], key[1]), block, first, step, k)
                parents = writer.parents(row, block.run, new, old)
                for value in writer.child.write(parents, white.normal, new.moved(form.child)):
                    check.set(check.get() + value * 0.0)
        Memory(code, checks, lanes=1).store(block.number, together(check.get()))
    return code.module.compile().callable("moved")


def _read(form: LawForm) -> list[int]:
    """The components of the slice before that a law reads."""
    return [
        parent.first + k
        for parent in form.parents
        if parent.where == BEFORE
        for k in range(parent.width)
    ]


def _gather(
    code: Code, room: Memory, rows: list[int], before: Address, width: Whole, ancestors: Address
) -> None:
    """Put the states of a pack's ancestors beside each other, of some components."""
    places = code.wholes(ancestors)
    each = [places.load(lane) for lane in range(LANES)]
    for row in rows:
        line, pack = before + width * row, code.constant(0.0)
        for lane, place in enumerate(each):
            pack = pack.with_lane(lane, Memory(code, line, lanes=1).load(place))
        room.store(row, pack)


class _Noise:
    """The standard normal numbers of a law's child, for a pack."""

    def __init__(self, code: Code, height: int) -> None:
        self._code, self._height = code, height
        self._counters = -(-height // philox.BLOCK)
        self._words = code.room(self._counters * philox.BLOCK, "words")
        self.normal = code.room(height, "white")

    def draw(
        self, key: tuple[Whole, Whole], block: Block, first: Whole, step: Whole, law: int
    ) -> None:
        code = self._code
        counter = block.begin + first, step, code.whole(law), code.whole(0)
        fill(code, self._words.address, self._counters, key, counter)
        for i in range(self._height):
            number = uniform(code, self._words.address + i * LANES)
            self.normal.store(i, quantile(code, number))
