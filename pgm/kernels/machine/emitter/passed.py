"""Arrays' cells passed to functions of a module, which are shared by all arrays that lie alike."""

from __future__ import annotations

from pgm.kernels.machine.emitter.code import Code
from pgm.kernels.machine.emitter.memory import Memory
from pgm.kernels.machine.emitter.wholes import Address, Whole


def place(cells: Memory) -> list[Address | Whole]:
    """Where an array's cells are, as arguments of a function."""
    whole = cells.code.whole
    return [cells.address, whole(cells.step), whole(cells.apart)]


def inside(code: Code, like: Memory, address: Address, step: Whole, apart: Whole) -> Memory:
    """An array's cells as a function sees them that is given their place."""
    near = is_near(like)
    return Memory(code, address, step=1 if near else step, runs=like.runs, apart=apart)


def lie(cells: Memory) -> str:
    """How an array's cells lie, in names of functions."""
    return f"{cells.runs.name} {'near' if is_near(cells) else 'apart'}"


def is_near(cells: Memory) -> bool:
    """Whether an array's cells are known to be next to each other."""
    return isinstance(cells.step, int) and cells.step == 1
