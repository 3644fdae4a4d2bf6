"""Numbers packed into a page, by planes of bytes; variables, CPDs and statuses as it names them."""

import base64
import zlib
from collections.abc import Iterable
from typing import Any, TypedDict

import numpy as np
import numpy.typing as npt

from pgm.cpds import CPD
from pgm.inference import Status
from pgm.kernels.arrays import Array
from pgm.variables import Discrete, Variable

# Bits of the fraction that are kept: of numbers from which the page computes others, 13 digits; of
# those that it only shows, to six digits, nine.
EXACT, SHOWN = 44, 31
_FRACTION = 52


class Ref(TypedDict):
    """The place of an array in the page's numbers: its first one, its rows and columns."""

    at: int
    rows: int
    columns: int


class Numbers:
    """The numbers of a page, arrays one after the other, each column by column.

    Columns of numbers that vary little then stand together, and compress.
    """

    def __init__(self) -> None:
        self._parts: list[Array] = []
        self.count = 0

    def add(self, array: npt.ArrayLike, bits: int = EXACT) -> Ref:
        """Add an array of rows, or a single row of numbers.

        array: (rows, ...), the other axes becoming columns.
        """
        given = np.asarray(array, dtype=np.float64)
        rows = given.shape[0] if given.ndim > 1 else 1
        columns = given.reshape(rows, given.size // rows if rows else 0).T
        found = Ref(at=self.count, rows=rows, columns=len(columns))
        self._parts.append(rounded(columns, bits).reshape(-1))
        self.count += given.size
        return found

    def flat(self, array: Array, bits: int = EXACT) -> int:
        """Add numbers in their own order; the place of the first."""
        first = self.count
        self._parts.append(rounded(array, bits).reshape(-1))
        self.count += array.size
        return first

    def text(self) -> str:
        """All numbers as base64."""
        whole = np.concatenate([np.zeros(0), *self._parts]).astype("<f8")
        planes = np.ascontiguousarray(whole.view(np.uint8).reshape(-1, 8).T)
        maker = zlib.compressobj(6, wbits=31)  # with the header of gzip
        return base64.b64encode(maker.compress(planes.tobytes()) + maker.flush()).decode()


def rounded(array: Array, bits: int) -> Array:
    """Numbers rounded to so many bits of their fraction; infinite ones and NaN stay."""
    given = np.ascontiguousarray(array, dtype=np.float64)
    drop = np.uint64(_FRACTION - bits)
    half = np.uint64(1) << (drop - np.uint64(1))
    whole = ((given.view(np.uint64) + half) >> drop) << drop
    return np.where(np.isfinite(given), whole.view(np.float64), given)


def lower(matrices: Array) -> Array:
    """The lower triangles of symmetric matrices, row by row: (..., n (n + 1) / 2)."""
    rows, columns = np.tril_indices(matrices.shape[-1])
    found: Array = matrices[..., rows, columns]
    return found


def variable(given: Variable) -> dict[str, Any]:
    """A variable: its name, components and angles, or states."""
    if isinstance(given, Discrete):
        return {"name": repr(given), "states": list(given.states)}
    return {
        "name": repr(given),
        "components": list(given.components),
        "angles": given.angle_mask.tolist(),
    }


def cpd(given: CPD, family: Iterable[Variable] | None = None) -> dict[str, Any]:
    """A CPD: its class, child and parents, each by name and by how many steps before it stands.

    Without a step of its own, a name holds for every step, as ``x`` of ``x[t-1]``.
    """
    child, *parents = (given.child, *given.parents) if family is None else tuple(family)
    return {
        "kind": type(given).__name__,
        "child": _place(child),
        "given": [_place(parent) for parent in parents],
    }


def _place(given: Variable) -> list[Any]:
    return [given.name if given.step is None else repr(given), given.lag]


def went(status: Status, run: int) -> dict[str, Any] | None:
    """The residuals of a schedule's iterations in one run; None where nothing was iterated."""
    residuals = np.asarray(status.residuals)
    if not len(residuals):
        return None
    each = residuals.reshape(len(residuals), -1)[:, run]
    return {
        "residuals": [number(value) for value in each],
        "converged": bool(np.asarray(status.converged).reshape(-1)[run]),
    }


def number(value: float) -> float | None:
    """A number of JSON, which knows no NaN and no infinity."""
    return float(value) if np.isfinite(value) else None


def listed(values: Iterable[float]) -> str:
    """Values of evidence, to six digits."""
    shown = [f"{value:.6g}" if np.isfinite(value) else "not taken" for value in values]
    return shown[0] if len(shown) == 1 else f"({', '.join(shown)})"
