"""The kinds of numbers that the steps of a chain are written over, for tests under each of them.

A kind makes a matrix of arrays (runs, m, n) of float64, runs a function of such matrices, which
gives one result or a tuple of them, and tells a result with 60 digits, of each run. Kinds of single
runs take the first one alone.
"""

from functools import cache

import numpy as np
from mpmath import mp

from pgm.beliefs.moments.digits.laid_out import two
from pgm.beliefs.moments.digits.written import Trace
from pgm.kernels import step, written
from pgm.kernels.dense import Dense, Runs, Stack
from pgm.kernels.extended import Twofold
from pgm.kernels.machine.emitter import traces
from pgm.kernels.machine.matrices.lines import Lines as Straight
from pgm.kernels.machine.matrices.loops import Loops
from pgm.kernels.numbers import Matrix
from pgm.tracing.traced import Node, Recorder, bare

RUNS = 3


class Floats:
    """Lists of floats."""

    digits = 1e-14

    def matrix(self, arrays):
        return Matrix(arrays[0].tolist())

    def run(self, function, *matrices):
        return function(*matrices)

    def truths(self, flags):
        """Truths about components, as steps take them, of a vector of ones and zeros."""
        return [x > 0.5 for (x,) in flags.rows]

    def open_share(self, cov):
        """The step of this name, of components with a variance."""
        return step.open_share(cov, [variance != 0.0 for variance in cov.diagonal])

    def numbers(self, found):
        """The matrices of a result with 60 digits, a number as one of a single entry."""
        return [mp.matrix([[self.number(x) for x in row] for row in rows_of(found)])]

    def number(self, x):
        return mp.mpf(float(x))


class RowsOfRuns(Floats):
    """Matrices of arrays, each a row of runs."""

    def matrix(self, arrays):
        return Matrix([list(row) for row in np.moveaxis(arrays, 0, -1)])

    def numbers(self, found):
        whole = np.array([[np.broadcast_to(x, RUNS) for x in row] for row in rows_of(found)])
        return [mp.matrix(whole[..., k].tolist()) for k in range(RUNS)]


# ---- arrays


class OneDense(Floats):
    """One array, by BLAS and LAPACK."""

    def matrix(self, arrays):
        return Dense(arrays[0])

    def truths(self, flags):
        return flags.array[:, 0] > 0.5

    def numbers(self, found):
        return [mp.matrix(np.atleast_2d(getattr(found, "array", found)).tolist())]


class DenseRuns(Floats):
    """Arrays with the runs last."""

    def matrix(self, arrays):
        return Runs(np.ascontiguousarray(np.moveaxis(arrays, 0, -1)))

    def truths(self, flags):
        return flags.array[:, 0] > 0.5

    def numbers(self, found):
        whole = found.array if isinstance(found, Runs) else np.asarray(found)[None, None]
        whole = np.broadcast_to(whole, (*whole.shape[:2], RUNS))
        return [mp.matrix(whole[..., k].tolist()) for k in range(RUNS)]


class Stacks(Floats):
    """Arrays with the runs first."""

    def matrix(self, arrays):
        return Stack(arrays)

    def truths(self, flags):
        return flags.vector > 0.5

    def open_share(self, cov):
        return step.open_share(cov, np.stack(cov.diagonal, axis=-1) != 0.0)

    def numbers(self, found):
        whole = found.array if isinstance(found, Stack) else np.asarray(found)[..., None, None]
        whole = np.broadcast_to(whole, (RUNS, *whole.shape[-2:]))
        return [mp.matrix(each.tolist()) for each in whole]


# ---- programs and traces


class Lines(Floats):
    """Lines of Python, which are compiled and called."""

    along_runs = False

    def run(self, function, *matrices):
        names = [f"a{k}_" for k in range(len(matrices))]
        shapes = {name: each.shape for name, each in zip(names, matrices, strict=True)}
        kept = []

        def body(*given):
            kept.append(function(*given))
            return [x for part in as_tuple(kept[0]) for row in rows_of(part) for x in row], True

        program = written.function(shapes, body, along_runs=self.along_runs)
        values = {name: np.array(each.rows) for name, each in zip(names, matrices, strict=True)}
        numbers = program(**values)
        return back(kept[0], as_tuple(numbers))


class LinesOfRuns(RowsOfRuns):
    """Lines of Python over rows of runs."""

    along_runs = True
    run = Lines.run


class Traced(Floats):
    """Traced numbers, whose graph is evaluated."""

    def run(self, function, *matrices):
        graph, values = Recorder(), []

        def read(number):
            values.append(number)
            return Node(graph, graph.input(0, len(values) - 1))

        given = [Matrix([[read(x) for x in row] for row in each.rows]) for each in matrices]
        found = function(*given)
        known = evaluated(graph, values)
        every = (x for part in as_tuple(found) for row in rows_of(part) for x in row)
        return back(found, (known[x.number] if isinstance(x, Node) else x for x in every))


# ---- twice the digits


class Pairs(Floats):
    """Rows of numbers of twice the digits, of many runs."""

    digits = 1e-30

    def matrix(self, arrays):
        rows = np.moveaxis(arrays, 0, -1)
        return Matrix([[Twofold(x.copy()) for x in row] for row in rows])

    def numbers(self, found):
        rows = rows_of(found)
        return [mp.matrix([[self.number(x, k) for x in row] for row in rows]) for k in range(RUNS)]

    def number(self, x, k):
        if not isinstance(x, Twofold):
            return mp.mpf(float(np.broadcast_to(x, RUNS)[k]))
        return mp.mpf(float(x.hi[k])) + mp.mpf(float(x.lo[k]))


class PairStacks(Floats):
    """Arrays of twice the digits with the runs first, which have no root."""

    digits = 1e-30

    def matrix(self, arrays):
        return Twofold(arrays.copy())

    def numbers(self, found):
        both = zip(found.hi, found.lo, strict=True)
        return [mp.matrix(hi.tolist()) + mp.matrix(lo.tolist()) for hi, lo in both]


# ---- machine code, which sweeps runs one by one, or as lanes of packs


class Registers(Floats):
    """Numbers in registers, in straight lines, compiled at the level of sweeps."""

    lanes, matrices, level = 1, Straight, 2

    def matrix(self, arrays):
        return arrays

    def run(self, function, *arrays):
        applied, kept = made(self, Steps(function), tuple(each.shape[1:] for each in arrays))
        return like(kept, applied(*arrays))

    def make(self, steps, shapes):
        """The steps in machine code, of matrices of some shapes, and a result of theirs."""
        from machine_code import over_matrices  # which skips a test where there is no LLVM

        kept = []

        def write(_, *matrices):
            kept.append(steps.function(*matrices))
            return as_tuple(kept[0])

        return over_matrices(write, shapes, self.matrices, self.lanes, self.level), kept[0]

    def numbers(self, found):
        return [mp.matrix(each.tolist()) for each in found]


class Packs(Registers):
    """Packs of runs in registers."""

    lanes = 8


class InMemory(Registers):
    """Matrices in memory, by loops."""

    matrices, level = Loops, 1

    def truths(self, flags):
        loops = self._loops(flags)
        return loops.truths([x > 0.5 for x in loops.beside(flags)], flags.shape[0])

    def open_share(self, cov):
        loops = self._loops(cov)
        varies = [variance != 0.0 for variance in loops.diagonal(cov)]
        return step.open_share(cov, loops.truths(varies, cov.shape[0]))

    def _loops(self, matrix):
        return Loops(matrix.space.code, matrix.space.frame)


class PacksInMemory(InMemory):
    """Matrices of packs of runs in memory."""

    lanes = 8


class TracedPairs(Registers):
    """Rows of pairs of traced numbers, whose trace is straight lines."""

    digits, level = 1e-30, 0

    def run(self, function, *arrays):
        halves = [each for array in arrays for each in (array, np.zeros_like(array))]
        applied, kept = made(self, Steps(function), tuple(each.shape[1:] for each in arrays))
        found = applied(*halves)
        return like(kept, list(map(Twofold, found[::2], found[1::2])))

    def make(self, steps, shapes):
        from machine_code import over_matrices

        trace, parts, kept = traced_pairs(self.matrix_of, steps, shapes)

        def write(kind, *matrices):
            known = [kind.beside(each) for each in matrices]
            found = traces.written(kind.code, trace, trace.value, lambda k, at: known[k][at])
            left = iter(found)
            return [
                Matrix([[next(left) for _ in range(n)] for _ in range(m)])
                for m, n in parts
                for _ in ("high", "low")
            ]

        halves = [shape for shape in shapes for _ in ("high", "low")]
        options = self.matrices, self.lanes, self.level
        return over_matrices(write, halves, *options, contract=False), kept

    @staticmethod
    def matrix_of(stack):
        """The matrix of a stack of one."""
        _, height, width = stack.shape
        return Matrix([[stack[:, i, j] for j in range(width)] for i in range(height)])

    def numbers(self, found):
        return PairStacks.numbers(self, found)


class PacksOfTracedPairs(TracedPairs):
    """Packs of runs of such pairs."""

    lanes = 8


class TracedPairStacks(TracedPairs):
    """Arrays of pairs of traced numbers, which have no root."""

    @staticmethod
    def matrix_of(stack):
        return stack


class Steps:
    """A function of matrices, equal to those of the same code among equal values."""

    def __init__(self, function):
        self.function = function
        around = (cell.cell_contents for cell in function.__closure__ or ())
        self._key = (function.__code__, *around)

    def __eq__(self, other):
        return self._key == other._key

    def __hash__(self):
        return hash(self._key)


@cache
def made(kind, steps, shapes):
    """The steps in the machine code of a kind, made once for matrices of some shapes."""
    return kind.make(steps, shapes)


@cache
def traced_pairs(matrix_of, steps, shapes):
    """The trace of steps over pairs, the shapes of its results, and a result of theirs."""
    trace = Trace()
    found = steps.function(*(matrix_of(two(trace.given, *shape)) for shape in shapes))
    parts = [stacked(part) for part in as_tuple(found)]
    return trace.function(tuple(parts)), [part.shape[1:] for part in parts], found


# ---- results


def as_tuple(found):
    """The parts of a result."""
    return found if isinstance(found, tuple) else (found,)


def like(found, parts):
    """The parts as a result that is, as another one, a tuple or a single part."""
    return tuple(parts) if isinstance(found, tuple) else parts[0]


def rows_of(part):
    """The numbers of a part, row by row."""
    return part.rows if isinstance(part, Matrix) else [[part]]


def back(found, numbers):
    """A result in the shape of another, of these numbers."""
    left = iter(numbers)
    return like(
        found,
        [
            Matrix([[next(left) for _ in row] for row in part.rows])
            if isinstance(part, Matrix)
            else next(left)
            for part in as_tuple(found)
        ],
    )


def stacked(part):
    """A part of pairs of traced numbers of one run as a stack of a single matrix."""
    if isinstance(part, Twofold) and len(part.shape) == 3:
        return part
    pairs = [
        [x if isinstance(x, Twofold) else Twofold(np.array([x])) for x in row]
        for row in rows_of(part)
    ]
    high, low = (
        np.array([[bare(getattr(x, half)).item() for x in row] for row in pairs], dtype=object)
        for half in ("hi", "lo")
    )
    return Twofold(high[None], low[None])


def evaluated(graph, values):
    """The values of all nodes of a graph."""
    known = []
    for name, *operands in graph.operations:
        if name == "constant":
            known.append(operands[0])
        elif name == "input":
            known.append(values[operands[1]])
        else:
            with np.errstate(invalid="ignore"):  # of a root that does not exist
                known.append(getattr(np, name)(*(known[k] for k in operands)))
    return known
