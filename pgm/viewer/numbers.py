"""Contents of a page: how much, numbers packed by planes of bytes, and the names of things."""

import base64
import zlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, TypedDict

import numpy as np
import numpy.typing as npt

from pgm.boundary import as_tuple, is_whole
from pgm.cpds import CPD
from pgm.errors import GraphError
from pgm.inference import Status
from pgm.kernels.arrays import Array
from pgm.networks.markov import Factor
from pgm.variables import Discrete, Variable

Run = tuple[int, ...]


@dataclass(frozen=True)
class Limits:
    """The most that a page holds.

    entries: Of a table; of larger ones the largest entries are kept, and the marginals.
    refuse: Whether more steps are an error, and not cut.
    moved: Whether it tells how far evidence moved beliefs, for which the prior is inferred.
    factors: Whether it has potentials and messages, beside what a path is drawn of.
    """

    runs: int
    steps: int
    clusters: int
    entries: int
    numbers: int
    refuse: bool
    moved: bool
    factors: bool = True


FILE = Limits(8, 20_000, 2_000, 4_096, 8_000_000, True, True)
REPORT = Limits(8, 20_000, 2_000, 4_096, 8_000_000, refuse=False, moved=False, factors=False)
CELL = Limits(1, 200, 150, 256, 200_000, False, False)


def chosen_runs(
    run: int | Sequence[int] | Sequence[Run] | None, lead: Run, limits: Limits
) -> tuple[list[Run], str | None]:
    """The runs that a page shows, and a note about the runs left out."""
    total = int(np.prod(lead))
    if run is None:
        count = min(total, limits.runs)
        found = [tuple(int(k) for k in np.unravel_index(r, lead)) for r in range(count)]
        note = f"{count} of {total:,} runs are shown; pgm.view(..., run=(k,)) shows run k"
        return found, note if count < total else None
    given = as_tuple(run)
    several = given is not None and all(as_tuple(each) is not None for each in given) and given
    wanted = [as_tuple(each) or () for each in several] if several else [_index(run)]
    if len(wanted) > limits.runs:
        raise GraphError(f"a page holds {limits.runs} runs, not {len(wanted)}; name fewer")
    for each in wanted:
        fits = len(each) == len(lead) and all(map(is_whole, each))
        if not fits or not all(-n <= k < n for k, n in zip(each, lead, strict=True)):
            raise GraphError(
                f"run={run!r}: there is no run {each}; the axes of runs are {lead}, and a run is "
                "a place along each of them"
            )
    found = [tuple(int(k) % n for k, n in zip(each, lead, strict=True)) for each in wanted]
    note = f"{len(found)} of {total:,} runs {'is' if len(found) == 1 else 'are'} shown"
    return found, note if len(found) < total else None


def _index(run: object) -> Run:
    return (run,) if isinstance(run, int | np.integer) else tuple(as_tuple(run) or ("none",))  # type: ignore[return-value]


def chosen_steps(
    steps: tuple[int, int] | None, last: int, limits: Limits
) -> tuple[range, str | None]:
    """The steps that a page shows, and a note about the steps left out."""
    if steps is None:
        if last < limits.steps:
            return range(last + 1), None
        if limits.refuse:
            raise GraphError(
                f"a page holds {limits.steps:,} steps of a chain, which has {last + 1:,}; give "
                f"steps=(first, last), as steps=(0, {limits.steps - 1})"
            )
        note = f"steps 0 to {limits.steps - 1} of 0 to {last:,} are shown in this page"
        return range(limits.steps), note
    ends = as_tuple(steps)
    if ends is None or len(ends) != 2 or not all(map(is_whole, ends)):
        raise GraphError(f"steps=(first, last) are two steps, not {steps!r}")
    first, end = map(int, ends)
    if not 0 <= first <= end <= last:
        raise GraphError(f"steps={steps!r}: the chain has the steps 0 to {last}")
    if end - first >= limits.steps:
        raise GraphError(f"a page holds {limits.steps:,} steps, not {end - first + 1:,}")
    note = f"steps {first:,} to {end:,} of 0 to {last:,} are shown"
    return range(first, end + 1), None if (first, end) == (0, last) else note


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
    """Numbers rounded to a number of mantissa bits; infinities and NaN stay."""
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
        "units": list(given.units),
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


def factor(given: Factor, family: Iterable[Variable]) -> dict[str, Any]:
    """A factor: a CPD, or one without direction, whose variables stand where parents do."""
    if isinstance(given, CPD):
        return cpd(given, family)
    return {
        "kind": type(given).__name__,
        "child": None,
        "given": [_place(variable) for variable in family],
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
