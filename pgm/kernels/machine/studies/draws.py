"""Philox in machine code: the words of `pgm.kernels.philox`, and uniform and normal numbers.

A counter's words are whole numbers of one run, made by products of 128 bits. They are laid beside
those of the next runs, and turned into numbers for a pack of runs at once.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import numpy as np

from pgm.kernels import philox
from pgm.kernels.arrays import Array, Integers, address
from pgm.kernels.machine.emitter.code import Code
from pgm.kernels.machine.emitter.kinds import ADDRESS, packed
from pgm.kernels.machine.emitter.memory import Cells as Values
from pgm.kernels.machine.emitter.module import Module
from pgm.kernels.machine.emitter.numbers import Number
from pgm.kernels.machine.emitter.wholes import Address, Whole
from pgm.kernels.machine.studies.normals import quantile
from pgm.kernels.machine.studies.sums import LANES, Given, each_pack, table

_ROUNDS = 10
_MULTIPLIERS = 0xD2E7470EE14C6C93, 0xCA5A826395121157
_KEY_STEPS = 0x9E3779B97F4A7C15, 0xBB67AE8584CAA73B
# The bits of a float in [1, 2) above its fraction, and by how many bits a word exceeds that.
_ONE, _SPARE = 0x3FF << 52, 12
_HALF_A_CELL = 2.0**-53

Words4 = tuple[Whole, Whole, Whole, Whole]


def numbers(
    source: philox.Philox,
    first: int,
    runs: int,
    rows: Integers,
    variable: int,
    request: int,
    count: int,
    *,
    normal: bool,
) -> Array:
    """Numbers (rows, runs, count) for each run from `first` on, as of `counted.Stream`.

    They are standard normal, or uniform; of as many runs as a pack has at least. In memory runs lie
    beside each other.
    """
    found = np.empty((len(rows), count, runs)).transpose(0, 2, 1)
    rows = np.ascontiguousarray(rows, dtype=np.int64)
    given = table(len(rows), runs, first, variable, request, rows, source.key, found)
    _numbers(count, normal)(address(given))
    return found


@lru_cache(maxsize=32)
def _numbers(count: int, normal: bool) -> Callable[[int], None]:
    code = Module().function("numbers", (ADDRESS,), lanes=LANES)
    given = Given(code, code.arguments[0])
    rows, runs, first, variable, request = (given.whole() for _ in range(5))
    every, keys = given.address(), code.wholes(given.address(), 2)
    out = given.address()
    key, blocks = (keys.load(0), keys.load(1)), -(-count // philox.BLOCK)
    words = code.room(blocks * philox.BLOCK)
    with code.loop(rows) as k:
        row = code.wholes(every).load(k)
        with each_pack(code, runs) as run:
            fill(code, words.address, blocks, key, (first + run, row, variable, request))
            for i in range(count):
                number = uniform(code, words.address + i * LANES)
                if normal:
                    number = quantile(code, number)
                code.memory(out + (runs * (k * count + i) + run)).store(0, number)
    return code.module.compile().callable("numbers")


def fill(code: Code, room: Address, blocks: int, key: tuple[Whole, Whole], counter: Words4) -> None:
    """Put the words of a pack's runs into memory, word by word.

    Of each run there are the words of so many counters, from ``(run blocks, row, variable,
    request)`` on; `counter` has the first run in the place of the first.
    """
    run, *rest = counter
    cells, lanes = Values(code, room, Whole), code.lanes
    with code.loop(lanes) as lane, code.loop(blocks) as block:
        # As NumPy does, which adds one to a counter before it takes its words.
        found = words(key, ((run + lane) * blocks + block + 1, rest[0], rest[1], rest[2]))
        for k, word in enumerate(found):
            cells.store((block * philox.BLOCK + k) * lanes + lane, word)


def words(key: tuple[Whole, Whole], counter: Words4) -> Words4:
    """The four words of a counter by Philox4x64-10."""
    a, b, c, d = counter
    low, high = key
    for round_ in range(_ROUNDS):
        if round_:
            low, high = low + signed(_KEY_STEPS[0]), high + signed(_KEY_STEPS[1])
        (over_a, under_a), (over_c, under_c) = (
            each.product(signed(factor)) for each, factor in zip((a, c), _MULTIPLIERS, strict=True)
        )
        a, b, c, d = over_c ^ b ^ low, under_c, over_a ^ d ^ high, under_a
    return a, b, c, d


def uniform(code: Code, place: Address) -> Number:
    """The uniform numbers of a pack's words: see `philox.uniforms`."""
    lanes, kind = code.lanes, packed("i64", code.lanes)
    spare, one = (f"splat (i64 {each})" if lanes > 1 else str(each) for each in (_SPARE, _ONE))
    word = code.value(f"load {kind}, ptr {place.text}, align 8")
    cell = code.value(f"lshr {kind} {word}, {spare}")
    bits = code.value(f"or {kind} {cell}, {one}")
    number = code.value(f"bitcast {kind} {bits} to {packed('double', lanes)}")
    # Of 1 + k 2⁻⁵² both sums are exact.
    return (Number(code, number, lanes) - 1.0) + _HALF_A_CELL


def signed(word: int) -> int:
    """A word of 64 bits as LLVM's assembly language has it."""
    return word - (1 << 64) if word >> 63 else word
