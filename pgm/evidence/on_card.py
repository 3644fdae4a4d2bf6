"""Evidence that lies on a CUDA card, as CuPy, JAX, Numba and PyTorch hand it over.

They do so by the CUDA array interface, others by DLPack alone. Nothing is copied: where the numbers
lie is all that is read here.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from pgm.errors import EvidenceError
from pgm.evidence.values import Constant, Sightings
from pgm.factors.scope import listed
from pgm.kernels import dlpack
from pgm.kernels.arrays import Array
from pgm.resources import NUMBER
from pgm.variables import Discrete, Variable

_FLOAT = "<f8"


class Numbers(NamedTuple):
    """Numbers of a variable on a card, (rows, d) or (runs, rows, d): their address and strides.

    Strides are in bytes; `owner` keeps the memory.
    """

    variable: Variable
    address: int
    shape: tuple[int, ...]
    strides: tuple[int, ...]
    owner: object

    @property
    def runs(self) -> int | None:
        """How many runs there are, None for numbers that all runs have."""
        return self.shape[0] if len(self.shape) == 3 else None

    @property
    def rows(self) -> int:
        """How many rows each run has."""
        return self.shape[-2]

    @property
    def distances(self) -> tuple[int, int, int]:
        """The floats from row to row, from run to run, and from component to component."""
        down, cell = (stride // NUMBER for stride in self.strides[-2:])
        across = self.strides[0] // NUMBER if len(self.shape) == 3 else 0
        return down, across, cell

    def of(self, run: int) -> Numbers:
        """The numbers of one run, (rows, d)."""
        begin = self.address + run * self.strides[0]
        return self._replace(address=begin, shape=self.shape[1:], strides=self.strides[1:])


def lies_there(evidence: Any) -> bool:
    """Whether some of the evidence lies on a CUDA card."""
    if not isinstance(evidence, Mapping):
        return False
    return any(is_there(each) for value in evidence.values() for each in _parts(value))


# What of evidence lies on a card: by the variable or the sensor that it is given for, and whose
# numbers it has, the sensor's own or those of a parent.
Places = dict[tuple[Variable, Variable], Numbers]


def lying_of(evidence: Mapping[Variable, Any]) -> Places:
    """The numbers of evidence that lie on a card.

    An EvidenceError refuses numbers of other types, shapes and layouts.
    """
    found = {}
    for variable, value in evidence.items():
        if isinstance(value, Constant) and is_there(value.value):
            raise _refused(variable, "as a constant", "give the numbers of a constant as NumPy's")
        each = {variable: value}
        if isinstance(value, Sightings):
            each = {variable: value.values, **value.given}
        for of, array in each.items():
            if is_there(array):
                found[variable, of] = _lying(of, array)
    return found


def brought(
    evidence: Mapping[Variable, Any], places: Places, home: Callable[[Numbers], Array]
) -> dict[Variable, Any]:
    """The evidence with NumPy's arrays, found by `home`, for numbers that lie on a card."""

    def of(variable: Variable, parent: Variable, value: Any) -> Any:
        lying = places.get((variable, parent))
        return value if lying is None else home(lying)

    found: dict[Variable, Any] = {}
    for variable, value in evidence.items():
        if isinstance(value, Sightings):
            given = {parent: of(variable, parent, each) for parent, each in value.given.items()}
            found[variable] = Sightings(of(variable, variable, value.values), value.step, given)
        else:
            found[variable] = of(variable, variable, value)
    return found


def _parts(value: Any) -> tuple[Any, ...]:
    if type(value) is np.ndarray:
        return ()
    if isinstance(value, Sightings):
        return value.values, *value.given.values()
    return (getattr(value, "value", value),)


def is_there(array: Any) -> bool:
    """Whether an object is an array on a CUDA card."""
    if array is None or isinstance(array, np.ndarray | float | int | list | tuple):
        return False
    if hasattr(array, "__cuda_array_interface__"):
        return True
    device = getattr(array, "__dlpack_device__", None)
    return device is not None and device()[0] == dlpack.CUDA


def _lying(variable: Variable, array: Any) -> Numbers:
    """Where numbers of a variable lie, refused unless machine code can read them there."""
    if isinstance(variable, Discrete):
        raise _refused(variable, "and is discrete", "a card takes measurements of numbers")
    if hasattr(array, "__cuda_array_interface__"):
        told = array.__cuda_array_interface__
        shape, kind = tuple(told["shape"]), str(told["typestr"])
        strides = told.get("strides")
        if strides is None:  # the last axis fastest
            strides = [NUMBER * math.prod(shape[k + 1 :]) for k in range(len(shape))]
        if told.get("mask") is not None:
            raise _refused(variable, "with a mask", "let NaN stand for what was not measured")
        address, owner = int(told["data"][0]), array
    else:
        tensor = dlpack.opened(array.__dlpack__())
        shape, kind, strides = tensor.shape, tensor.type, tensor.strides
        address, owner = tensor.address, tensor.owner
    if kind != _FLOAT:
        raise _refused(variable, f"as numbers of type {kind}", "float64 (<f8) was due")
    size = variable.dimension
    if len(shape) not in (2, 3) or shape[-1] != size:
        raise _refused(
            variable,
            f"in the shape {shape}",
            f"(rows, {size}) or (runs, rows, {size}) was due, the last axis its components "
            f"({listed(variable.components)})",
        )
    shape, strides = (tuple(map(int, each)) for each in (shape, strides))
    if 0 in shape:
        raise _refused(variable, "and is empty", "leave it out, or give it as an array of NumPy's")
    whole = not any(each % NUMBER for each in (*strides, address))
    ahead = all(stride > 0 for stride, n in zip(strides[-2:], shape[-2:], strict=True) if n > 1)
    if not whole or not ahead or min(strides) < 0:
        raise _refused(
            variable,
            f"with the strides {tuple(strides)}",
            "rows and components were due that lie one after another; a copy has such",
        )
    return Numbers(variable, address, shape, tuple(strides), owner)


def _refused(variable: Variable, how: str, advice: str) -> EvidenceError:
    return EvidenceError(
        f"evidence for {variable!r} lies on a card {how}; {advice}", variable=variable
    )
