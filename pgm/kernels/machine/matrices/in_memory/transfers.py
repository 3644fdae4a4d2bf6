"""Matrices read from arrays, whose runs and rows lie as they will, and written to them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from pgm.kernels.machine.emitter.code import Code
from pgm.kernels.machine.emitter.memory import Memory
from pgm.kernels.machine.emitter.numbers import Number
from pgm.kernels.machine.emitter.passed import inside, is_near, lie, place
from pgm.kernels.machine.emitter.wholes import Whole
from pgm.kernels.machine.matrices.in_memory.stored import Space, Stored
from pgm.kernels.machine.matrices.in_memory.views import Index, View, shuffled


def read(space: Space, cells: Memory, height: int, width: int) -> Stored:
    """The matrix of an array's cells, row by row."""
    found = space.new(height, width)

    def write(code: Code, out: View, *where: Any) -> None:
        *here, rows = where
        _read(code, out, inside(code, cells, *here), rows, near=is_near(cells))

    _transfer(space, "read", write, found, cells)
    return found


def write(space: Space, cells: Memory, matrix: Stored) -> None:
    """Put a matrix into an array's cells."""
    plain = matrix.plain() if matrix.shape[1] != 1 else matrix.T.plain()

    def written(code: Code, a: View, *where: Any) -> None:
        *here, rows = where
        _write(code, a, inside(code, cells, *here), rows, near=is_near(cells))

    _transfer(space, "write", written, plain, cells)


def _transfer(
    space: Space, name: str, how: Callable[..., None], matrix: Stored, cells: Memory
) -> None:
    told = f"{name} {lie(cells)} {matrix.width}"
    space.call(told, how, matrix, given=[*place(cells), matrix.height])


def _read(code: Code, out: View, cells: Memory, rows: Whole, *, near: bool) -> None:
    across = out.layout.across
    if across == 1:
        with code.loop(rows * out.width) as k:
            out.put(0, k, cells.load(k))
        return
    full, rest = divmod(out.width, across)
    with code.loop(rows) as i:
        begin = i * out.width
        for place in range(full if near else 0):
            out.put(i, place, _part(code, cells, begin + place * across, across))
        if near and rest:
            out.put(i, full, _part(code, cells, begin + full * across, rest))
        elif not near:
            with code.loop(out.packs) as p:
                out.put(i, p, 0.0)
            with code.loop(out.width) as j:
                out.put_entry(i, j, _one(code, cells, begin + j))


def _write(code: Code, a: View, cells: Memory, rows: Whole, *, near: bool) -> None:
    across = a.layout.across
    if across == 1:
        with code.loop(rows * a.width) as k:
            cells.store(k, a.pack(0, k))
        return
    full, rest = divmod(a.width, across)
    with code.loop(rows) as i:
        begin: Index = i * a.width
        for q in range(full if near else 0):
            cells.store(begin + q * across, a.pack(i, q))
        if near and rest:
            where, pack = cells.moved(begin + full * across).address, a.pack(i, full)
            part = shuffled(pack, pack, range(rest))
            code.line(f"store <{rest} x double> {part.text}, ptr {where.text}, align 8")
        elif not near:
            with code.loop(a.width) as j:
                number, where = a.entry(i, j), cells.moved(begin + j).address
                code.line(f"store double {number.text}, ptr {where.text}, align 8")


def _one(code: Code, cells: Memory, index: Index) -> Number:
    where = cells.moved(index).address
    return Number(code, code.value(f"load double, ptr {where.text}, align 8"))


def _part(code: Code, cells: Memory, index: Index, count: int) -> Number:
    """The pack of so many numbers that are next to each other, and of zeros."""
    if count == code.lanes:
        return cells.load(index)
    kind, where = f"<{count} x double>", cells.moved(index).address
    part = code.value(f"load {kind}, ptr {where.text}, align 8")
    lanes = ", ".join(f"i32 {min(k, count)}" for k in range(code.lanes))
    two = f"{kind} {part}, {kind} zeroinitializer"
    found = code.value(f"shufflevector {two}, <{code.lanes} x i32> <{lanes}>")
    return Number(code, found, code.lanes)
