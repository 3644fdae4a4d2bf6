"""Numbers that lie on a card, looked at and added up there, a thread a run."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

from pgm.kernels.machine.emitter.card import Card, printed, thread
from pgm.kernels.machine.emitter.driver import Device
from pgm.kernels.machine.emitter.kinds import ADDRESS, WHOLE
from pgm.kernels.machine.emitter.module import Module
from pgm.kernels.numbers import where

# The kinds of a kernel's arguments: the address of numbers, floats from row to row, from run to
# run and from cell to cell, how many rows and cells there are, where answers go, and how many runs.
KINDS = (ADDRESS, *(WHOLE,) * 5, ADDRESS, WHOLE)
# What is found among a run's numbers.
FINITE, MISSING, INFINITE = 0.0, 1.0, 2.0
_LOOK, _ADD = "look", "add"


@lru_cache(maxsize=8)
def kernel(name: str, capability: tuple[int, int]) -> str:
    """A kernel as PTX that finds a number of each run: the worst of its numbers, or their sum.

    ``"look"`` finds `FINITE`, `MISSING` for NaN, or `INFINITE`; ``"add"`` adds in the order of
    rows.
    """
    module = Module(target=Card(capability))
    code = module.function(name, KINDS)
    first, down, across, cell, rows, cells, out, runs = code.arguments
    run = thread(code)
    with code.when(run < runs):
        found = code.varying(0.0)
        with code.loop(rows) as row, code.loop(cells) as k:
            number = code.memory(first + (row * down + run * across + k * cell)).load(0)
            if name == _ADD:
                found.set(found.get() + number)
            else:
                missing = where(number == number, FINITE, MISSING)
                worst = where(abs(number) == float("inf"), INFINITE, missing)
                found.set(where(worst > found.get(), worst, found.get()))
        code.memory(out + run).store(0, found.get())
    return printed(module, [name])


@lru_cache(maxsize=8)
def loaded(name: str, device: Device) -> Any:
    """A kernel on a card, ready to be launched there; see `kernel`."""
    with device.current():
        return device.kernel(kernel(name, device.capability), name)


def look(device: Device) -> Any:
    """The kernel that looks whether numbers are finite."""
    return loaded(_LOOK, device)


def add(device: Device) -> Any:
    """The kernel that adds up the rows of each run."""
    return loaded(_ADD, device)
