"""The Gaussian of a belief over a single variable, from the belief's numbers, in machine code.

Python calls ``marginal(numbers)`` with the bytes of a belief (`online`); mean and covariance are
arrays that show them, and are not copied.
"""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING

from pgm.kernels.machine.emitter.arrays import shown
from pgm.kernels.machine.emitter.module import Module
from pgm.kernels.machine.emitter.python import Python, written

if TYPE_CHECKING:
    from pgm.kernels.machine.emitter.compiled import Compiled

MARGINAL = "marginal"
# What it is bound to: the class of arrays and the dtype of float64, the class of Gaussians, and
# their scope.
_ARRAYS, _FLOAT, _GAUSSIANS, _SCOPE = range(4)


@lru_cache(maxsize=128)
def made(size: int, slots: tuple[int, int, int, int]) -> Compiled:
    """The machine code for a variable of so many components; see `python.bound`.

    `slots` are the places of a Gaussian's mean, covariance, scope and steps.
    """
    module = Module()
    written(module, MARGINAL, 1, lambda python: _write(python, size, slots))
    return module.compile()


def _write(python: Python, size: int, slots: tuple[int, int, int, int]) -> None:
    (numbers,) = python.given
    begin = python.bytes(numbers, 8 * (size + size * size))
    kinds = python.mine(_ARRAYS), python.mine(_FLOAT)
    mean = shown(python, kinds, (size,), begin, numbers)
    cov = shown(python, kinds, (size, size), begin + size, numbers)
    found = python.new(python.mine(_GAUSSIANS))
    no_steps = python.code.address(id(None))
    values = python.passed(mean), python.passed(cov), python.more(python.mine(_SCOPE))
    for place, value in zip(slots, (*values, python.more(no_steps)), strict=True):
        python.fill(found, place, value)
    python.code.give(python.passed(found))
