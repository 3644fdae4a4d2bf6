"""Products of matrices in memory, tile by tile, each in registers."""

from __future__ import annotations

from typing import NamedTuple

from pgm.kernels.machine.emitter.code import Code
from pgm.kernels.machine.emitter.numbers import Number
from pgm.kernels.machine.emitter.wholes import Whole
from pgm.kernels.machine.matrices.in_memory.views import (
    Index,
    View,
    lanes_where,
    size_of,
    tiled,
    transposed,
)


class Plan(NamedTuple):
    """The tiles of a product: full ones of `tall` rows, and the `rest` of the rows below them.

    One function serves all products of the same plan.
    """

    tall: int
    rest: int
    wide: int
    full: int
    half: bool
    told: str

    @classmethod
    def of(cls, a: View, out: View, half: bool) -> Plan:
        """The plan of a product, or of the half below its diagonal."""
        most, wide = out.layout.tile(out.height, out.packs)
        tall, wide = size_of(out.height, most), size_of(out.packs, wide)
        full, rest = divmod(out.height, tall)
        told = f"{'half ' if half else ''}{tall} {rest} {a.packs}{'t' * a.turned} {out.packs}"
        return cls(tall, rest, wide, full, half, told)


def product(
    code: Code, a: View, b: View, out: View, plan: Plan, inside: Whole, full: Whole
) -> None:
    """The product A B, or, of a symmetric one, the half below its diagonal.

    Tiles of rows and packs are summed in registers, along the columns of A, which are `inside`.
    """

    def rows(i: Index, height: int) -> None:
        def tile(q: Index, packs: int) -> None:
            sums = [[code.varying(0.0) for _ in range(packs)] for _ in range(height)]
            with code.loop(inside) as k:
                right = [b.pack(k, q + p) for p in range(packs)]
                for r, line in enumerate(sums):
                    left = a.entry(i + r, k)
                    for total, pack in zip(line, right, strict=True):
                        total.set(total.get() + left * pack)
            for r, line in enumerate(sums):
                for p, total in enumerate(line):
                    out.put(i + r, q + p, total.get())

        last = (i + (height - 1)) // out.layout.across if plan.half else None
        tiled(code, out.packs, plan.wide, tile, last=last)

    with code.loop(full) as k:
        rows(k * plan.tall, plan.tall)
    if plan.rest:
        rows(full * plan.tall, plan.rest)


def mirrored(code: Code, a: View) -> None:
    """Write the half below the diagonal of a symmetric matrix above it."""
    size = a.layout.across
    if size == 1:
        with code.loop(a.height) as i, code.loop(i) as j:
            a.put_entry(j, i, a.entry(i, j))
        return

    def rows(i: Index, height: int) -> None:
        here = i // size
        with code.loop(code.whole(here)) as q:
            for r, pack in enumerate(transposed(_block(a, i, q, height))):
                a.put(q * size + r, here, pack)
        block = _block(a, i, here, height)
        for r, (below, above) in enumerate(zip(block, transposed(block), strict=True)):
            if r < height:
                lower = lanes_where(code, [lane <= r for lane in range(size)])
                a.put(i + r, here, lower.where(below, above))

    tiled(code, a.height, size, rows)


def turned(code: Code, a: View, out: View) -> None:
    """The transpose Aᵀ of a matrix that is not turned, written down."""
    size = a.layout.across
    if size == 1:
        with code.loop(a.width) as j, code.loop(a.height) as i:
            out.put_entry(j, i, a.entry(i, j))
        return

    def rows(i: Index, height: int) -> None:
        def block(j: Index, width: int) -> None:
            found = transposed(_block(a, i, j // size, height))
            for c in range(width):
                out.put(j + c, i // size, found[c])

        tiled(code, a.width, size, block)

    tiled(code, a.height, size, rows)


def _block(a: View, i: Index, q: Index, height: int) -> list[Number]:
    """A square of packs, of zeros where there are no rows."""
    zero = a.code.constant(0.0)
    return [a.pack(i + r, q) if r < height else zero for r in range(a.layout.across)]
