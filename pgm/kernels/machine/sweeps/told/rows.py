"""CPDs at their rows, and how they are linearised."""

from __future__ import annotations

from dataclasses import dataclass

from pgm.kernels.machine.emitter.functions import Function
from pgm.kernels.machine.sweeps.told.table import Array

Rows = tuple[tuple[float, ...], ...]


@dataclass(frozen=True)
class Points:
    """The points of a rule for N(0, I), (N, n), and its regression on them.

    `mean` (1, N), `slope` (n, N), `rest` (K, N) and `signs` (K,), empty for ones, are as of
    `step.Rule`. `centred` says that the first point is the origin; `rounding` is that of a value
    beside its summands, and `variances` (d,) are the least of the CPD's own noise. `known` are the
    components of x that may have no variance; the points lie alike on both sides of each.
    """

    points: Rows
    mean: Rows
    slope: Rows
    rest: Rows
    signs: tuple[float, ...]
    centred: bool
    rounding: float
    variances: tuple[float, ...]
    known: tuple[int, ...] = ()


@dataclass(frozen=True)
class Lines:
    """Linearisations that are read from memory, of all rows of a step.

    Attributes
    ----------
    cov : Array or None
        Where the program, which linearises, finds the belief's covariance (n, n), its mean being
        the first of the points; None where machine code linearises, by values at points.
    value, matrix : Array
        The value at the mean, (d,), and F (d, n).
    error : Array or None
        The covariance (d, d) of the linearisation's error; None where there is none.
    sure : Array
        Whether all of it is right, (1,).
    """

    cov: Array | None
    value: Array
    matrix: Array
    error: Array | None
    sure: Array


@dataclass(frozen=True)
class Called:
    """A function that cannot be compiled: machine code waits until its program has called it.

    Attributes
    ----------
    number : int
        Of the function, among those of the chain that are called.
    points, values : Array
        Where it is called, (N, n), and what it gives there at each row of a step, (N, d).
    lines : Lines
        Its linearisations.
    """

    number: int
    points: Array
    values: Array
    lines: Lines


@dataclass(frozen=True, kw_only=True)
class Row:
    """A CPD at its rows: y = F x + b + e of its parents x, or a function that is linearised.

    Attributes
    ----------
    parents : tuple of int
        The places of x in a slice, or in the pair of the states before and a slice.
    height : int
        The number of components of y.
    noise : Array
        The covariance (d, d) of e, but for errors of linearisations.
    matrix, offset : Array or None
        F (d, n) and b (d,) of an affine CPD, and else where they are kept, if they are.
    function : Function or None
        Of a CPD that is linearised in machine code.
    called : Called or None
        Of one whose function the program calls.
    points : Points or None
        Of the rule by which it is linearised; None of `Taylor`.
    inputs : tuple of Array
        The observed arguments, (m,) each, in the order of the function's.
    shifts : tuple of Array
        Of an affine CPD whose inputs come later, their matrices B (d, m): b + B u + ... is its
        offset.
    kept : Array or None
        Where the covariance of e with the error is kept.
    angles : tuple of int
        The components of y that are angles.
    """

    parents: tuple[int, ...]
    height: int
    noise: Array
    matrix: Array | None = None
    offset: Array | None = None
    function: Function | None = None
    called: Called | None = None
    points: Points | None = None
    inputs: tuple[Array, ...] = ()
    shifts: tuple[Array, ...] = ()
    kept: Array | None = None
    angles: tuple[int, ...] = ()

    @property
    def curved(self) -> bool:
        """Whether it has to be linearised."""
        return self.function is not None or self.called is not None


@dataclass(frozen=True, kw_only=True)
class Motion(Row):
    """A CPD of a transition, a row a step.

    Attributes
    ----------
    bare : tuple of int
        The components of y without noise of their own.
    unsure : bool
        Whether its errors may be indefinite.
    turning : tuple of (int, int, int)
        An angle of y, its place in the pair a step before, and that among the parents.
    """

    bare: tuple[int, ...] = ()
    unsure: bool = False
    turning: tuple[tuple[int, int, int], ...] = ()
