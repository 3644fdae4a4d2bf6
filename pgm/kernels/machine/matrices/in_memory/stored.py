"""Matrices in the memory of machine code, with the operations of `numbers.Matrix`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from pgm.kernels.machine.emitter.code import Code
from pgm.kernels.machine.emitter.kinds import ADDRESS, FLOAT, WHOLE, Kind
from pgm.kernels.machine.emitter.numbers import Number, Operand, constant
from pgm.kernels.machine.emitter.wholes import Address, Whole
from pgm.kernels.machine.matrices.in_memory import moves, products, roots
from pgm.kernels.machine.matrices.in_memory.frame import Frame
from pgm.kernels.machine.matrices.in_memory.layout import Layout
from pgm.kernels.machine.matrices.in_memory.views import View

# Rows or columns from which on matrices are transposed by packs.
_FEW = 4
_KINDS: dict[type, Kind] = {Address: ADDRESS, Whole: WHOLE, Number: FLOAT}


class Space:
    """Memory for matrices of a function that is being written: its room, and how they lie there."""

    def __init__(self, code: Code, frame: Frame, layout: Layout) -> None:
        self.code, self.frame, self.layout = code, frame, layout

    def inside(self, code: Code) -> Space:
        """The memory as another function of the module sees it."""
        return Space(code, self.frame, self.layout)

    def new(self, height: int, width: int) -> Stored:
        """Room for a matrix."""
        floats = self.layout.floats(height, width)
        return Stored(self, self.frame.take(floats), height, width)

    def constant(self, rows: Sequence[Sequence[float]], width: int) -> Stored:
        """A matrix that is known as the code is written."""
        wide, entry = self.layout.packs(width) * self.layout.across, self.layout.entry
        floats = [x for row in rows for y in (*row, *(0.0,) * (wide - width)) for x in (y,) * entry]
        floats += [0.0] * self.layout.lanes
        text = ", ".join(f"double {constant(self.code, float(x)).text}" for x in floats)
        module, kind = self.code.module, f"[{len(floats)} x double]"
        name = f'@"constant {module.number("constant", text)}"'
        module.declare(f"{name} = private constant {kind} [{text}], align 64")
        return Stored(self, Address(self.code, name), len(rows), width)

    def numbers(self, *numbers: Operand) -> Stored:
        """Numbers as a row of entries; what lies between them is of no meaning."""
        found = self.new(1, len(numbers))
        for j, number in enumerate(numbers):
            found.view.put_entry(0, j, number)
        return found

    def call(
        self,
        name: str,
        write: Callable[..., None],
        *matrices: Stored,
        given: Sequence[Any] | None = None,
    ) -> None:
        """Call the function of a name and of these shapes, written when it is called first.

        With more that is `given`, a function serves all shapes, and its name tells of what it
        depends on. No other matrix may share memory with one that it writes.
        """
        shapes = " ".join(matrix.told for matrix in matrices) if given is None else ""
        given = [self.code.whole(x) if isinstance(x, int) else x for x in given or ()]
        kinds = [ADDRESS] * len(matrices) + [_KINDS[type(each)] for each in given]
        helper = self.code.module.helper(
            f"{name} {shapes}".rstrip(), kinds, self.layout.lanes, None, disjoint=True
        )
        if helper.fresh:
            code, count = helper.code, len(matrices)
            views = [m.seen(code, at) for m, at in zip(matrices, code.arguments, strict=False)]
            write(code, *views, *code.arguments[count:])
        self.code.call(helper.code, *(matrix.address for matrix in matrices), *given)


class Stored:
    """A matrix (height × width) in memory; turned, it stands for its transpose."""

    __slots__ = ("address", "height", "space", "turned", "width")

    def __init__(
        self, space: Space, address: Address, height: int, width: int, turned: bool = False
    ) -> None:
        self.space, self.address = space, address
        self.height, self.width, self.turned = height, width, turned

    def seen(self, code: Code, address: Address) -> View:
        """The matrix, as a function sees it."""
        layout = self.space.layout
        return View(code, layout, address, self.height, self.width, self.turned)

    @property
    def view(self) -> View:
        """The matrix, as the function at hand sees it."""
        return self.seen(self.space.code, self.address)

    @property
    def packs(self) -> int:
        """The packs of all rows."""
        return self.height * self.space.layout.packs(self.width)

    @property
    def steps(self) -> tuple[int, int]:
        """How far apart entries are, of one row and the next, and in a row."""
        layout = self.space.layout
        down = layout.packs(self.width) * layout.across
        return (1, down) if self.turned else (down, 1)

    @property
    def told(self) -> str:
        """The shape in words, in names of functions."""
        return f"{self.height}x{self.width}{'t' if self.turned else ''}"

    @property
    def shape(self) -> tuple[int, int]:
        """The numbers of rows and columns."""
        return (self.width, self.height) if self.turned else (self.height, self.width)

    def __getitem__(self, place: tuple[int, int]) -> Number:
        return self.view.entry(*place)

    @property
    def T(self) -> Stored:
        """The matrix transposed, in the same memory."""
        return Stored(self.space, self.address, self.height, self.width, not self.turned)

    def plain(self) -> Stored:
        """The matrix row by row."""
        if not self.turned:
            return self
        found = self.space.new(*self.shape)
        self._turn(self.T, found)
        return found

    def _turn(self, source: Stored, out: Stored) -> None:
        """Write the transpose of a matrix that is not turned, the small ones entry by entry."""
        if min(source.height, source.width) >= _FEW:
            self.space.call("turned", products.turned, source, out)
        else:
            out.clear()
            source.T.put(out, 0, 0)

    def clear(self) -> None:
        """Write zeros."""
        self.space.call("cleared", moves.cleared, self._straight, given=[self.packs])

    def put(self, out: Stored, i: int, j: int) -> None:
        """Write the entries to a block of another matrix, from a row and a column on."""
        self._block((0, 0), self.shape, out, (i, j))

    def _block(
        self, at: tuple[int, int], shape: tuple[int, int], out: Stored, to: tuple[int, int]
    ) -> None:
        first = Stored(self.space, self.view.at(*at), *shape)
        second = Stored(self.space, out.view.at(*to), *shape)
        given = [*shape, *self.steps, *out.steps]
        self.space.call("block", moves.block, first, second, given=given)

    def copied_to(self, other: Stored) -> None:
        """Write the entries to another matrix of the same shape."""
        assert self.shape == other.shape
        if self.turned != other.turned:
            source = self.T if other.turned else self
            other = other.T if other.turned else other
            self._turn(source.T, other)
        else:
            one, copy = self._straight, other._straight
            self.space.call("copy", moves.copied, one, copy, given=[self.packs])

    def copy(self) -> Stored:
        """The matrix in memory of its own."""
        return self._each("copy", moves.copied)

    def __matmul__(self, other: Stored) -> Stored:
        if other.shape[1] == 1 != self.shape[0]:  # columns are rows that are turned
            return (other.T @ self.T).T
        other = other.plain()
        found = self.space.new(self.shape[0], other.shape[1])
        self._product(other, found)
        return found

    def _product(self, other: Stored, found: Stored, *, half: bool = False) -> None:
        """Write the product A B, of a B that is not turned."""
        plan = products.Plan.of(self.view, found.view, half)

        def write(code: Code, a: View, b: View, out: View, inside: Whole, full: Whole) -> None:
            products.product(code, a, b, out, plan, inside, full)

        given = [self.shape[1], plan.full]
        self.space.call(f"product {plan.told}", write, self, other, found, given=given)

    def times(self, other: Stored) -> Stored:
        """The product A Bᵀ, of which it is known that it is symmetric."""
        other = other.T.plain()
        found = self.space.new(self.shape[0], other.shape[1])
        self._product(other, found, half=True)
        self.space.call("mirrored", products.mirrored, found)
        return found

    def __add__(self, other: Stored) -> Stored:
        return self._each("sum", moves.summed, other)

    def __sub__(self, other: Stored) -> Stored:
        return self._each("difference", moves.subtracted, other)

    def scaled(self, number: Operand) -> Stored:
        """The matrix times a number."""
        return self._each("scaled", moves.scaled, numbers=[number])

    def one_minus(self) -> Stored:
        """The matrix I − A."""
        found = self._each("negative", moves.negative)
        ones = self.space.constant([[1.0] * self.height], self.height)
        return found.raised(ones)

    def part(self, rows: Sequence[int], columns: Sequence[int]) -> Stored:
        """The entries in some rows and columns."""
        every = tuple(map(tuple, map(range, self.shape)))
        rows, columns = tuple(rows), tuple(columns)
        if every == (rows, columns):
            return self
        if self.turned:
            return self.T.part(columns, rows).T
        found, at = self.space.new(len(rows), len(columns)), 0
        found.clear()
        for i, height in moves.stretches(rows):
            to = 0
            for j, width in moves.stretches(columns):
                self._block((i, j), (height, width), found, (at, to))
                to += width
            at += height
        return found

    def widened(self, places: Sequence[int], width: int) -> Stored:
        """The matrix whose columns stand at some places among `width`, with zeros elsewhere."""
        places = tuple(places)
        if places == tuple(range(width)):
            return self
        found, at = self.space.new(self.shape[0], width), 0
        found.clear()
        for j, count in moves.stretches(places):
            self._block((0, at), (self.shape[0], count), found, (0, j))
            at += count
        return found

    def bordered(self, across: Stored, own: Stored) -> Stored:
        """The symmetric matrix [[A, Bᵀ], [B, C]] of A, this one, B = `across` and C = `own`."""
        first, size = self.shape[0], self.shape[0] + own.shape[0]
        found = self.space.new(size, size)
        found.clear()
        self.put(found, 0, 0)
        across.put(found, first, 0)
        across.T.put(found, 0, first)
        own.put(found, first, first)
        return found

    def above(self, other: Stored) -> Stored:
        """The entries of the matrix, and below them those of another."""
        height, width = self.shape[0] + other.shape[0], self.shape[1]
        row_by_row = not self.turned and width != 1  # columns are rows that are turned
        found = self.space.new(height, width) if row_by_row else self.space.new(width, height).T
        found.clear()
        self.put(found, 0, 0)
        other.put(found, self.shape[0], 0)
        return found

    def beside(self, other: Stored) -> Stored:
        """The matrix [A B] of A, this one, and another."""
        return self.T.above(other.T).T

    def kept(self, known: Stored) -> Stored:
        """The matrix with zeros in rows that are not `known`, a row with a truth for each."""
        plain = self.plain()
        found = self.space.new(*self.shape)
        given = [plain.height, self.space.layout.packs(plain.width)]
        self.space.call("kept", moves.kept, plain, known, found, given=given)
        return found

    def independent(self, known: Stored) -> Stored:
        """The symmetric matrix with the rows and columns of I where a component is not `known`."""
        ones = self.space.constant([[1.0] * self.height], self.height)
        return self.kept(known).T.kept(known).raised(ones - known)

    def chosen(self, truth: Number, other: Stored) -> Stored:
        """The matrix where a truth holds, and another elsewhere."""
        return self._each("chosen", moves.chosen, other, numbers=[truth])

    def raised(self, numbers: Stored) -> Stored:
        """The matrix with numbers, a row of entries, added to its diagonal; it is changed."""
        given = [self.height, sum(self.steps)]
        self.space.call("raised", moves.raised, self, numbers, given=given)
        return self

    def largest(self) -> Stored:
        """The largest magnitude in each column, as a row."""
        plain = self.plain()
        found = self.space.new(1, plain.width)
        given = [plain.height, self.space.layout.packs(plain.width)]
        self.space.call("largest", moves.largest, plain, found, given=given)
        return found

    def diagonal_row(self) -> Stored:
        """The diagonal, as a row."""
        found = self.space.new(1, self.height)
        found.clear()
        own = Stored(self.space, self.address, 1, self.height)
        given = [1, self.height, 0, sum(self.steps), *found.steps]
        self.space.call("block", moves.block, own, found, given=given)
        return found

    @property
    def diagonal(self) -> list[Number]:
        """The entries on the diagonal."""
        view = self.view
        return [view.entry(i, i) for i in range(self.height)]

    def row(self, i: int) -> list[Number]:
        """The packs of a row."""
        view = self.plain().view
        return [view.pack(i, q) for q in range(view.packs)]

    def root(self) -> StoredRoot:
        """The lower triangular root L of a symmetric matrix A = L Lᵀ."""
        return StoredRoot(self.plain())

    @property
    def _straight(self) -> Stored:
        return self.T if self.turned else self

    def _each(
        self,
        name: str,
        write: Callable[..., None],
        *others: Stored,
        numbers: Sequence[Operand] = (),
    ) -> Stored:
        """A matrix of numbers of this one and others, entry by entry; it is turned as this is."""
        space, own = self.space, self._straight
        given = [(other.T if self.turned else other).plain() for other in others]
        found = space.new(self.height, self.width)
        more = [space.numbers(*numbers)] if numbers else []
        space.call(name, write, own, *given, *more, found, given=[self.packs])
        return found.T if self.turned else found


class StoredRoot:
    """The lower triangular root L of a symmetric positive definite matrix; see `numbers.Root`."""

    def __init__(self, matrix: Stored) -> None:
        space, size = matrix.space, matrix.height
        self._space, self._upper = space, space.new(size, size)
        self._over, self._pivots, share = (space.new(1, k) for k in (size, size, 1))
        space.call("root", roots.root, matrix, self._upper, self._over, self._pivots, share)
        self.share = share[0, 0]

    @property
    def volume(self) -> Number:
        """The logarithm of |L|, half of that of |A|."""
        found = self._space.new(1, 1)
        self._space.call("volume", roots.volume, self._pivots, found)
        return found[0, 0]

    @property
    def matrix(self) -> Stored:
        """The root as a matrix."""
        found = self._space.new(*self._upper.shape)
        self._space.call("triangle", roots.triangle, self._upper, found)
        return found.T

    @property
    def inverse(self) -> Stored:
        """The matrix A⁻¹."""
        white = self.solve(self._eye).T
        return white.times(white)

    @property
    def precisions(self) -> list[Number]:
        """The diagonal of A⁻¹: one over each component's variance given all others."""
        size = self._upper.height
        low, found = self._space.new(size, size), self._space.new(1, size)
        parts = self._upper, self._over, self._eye, low, found
        self._space.call("precisions", roots.precisions, *parts)
        return [found[0, k] for k in range(size)]

    @property
    def _eye(self) -> Stored:
        size = range(self._upper.height)
        eye = [[1.0 if i == j else 0.0 for j in size] for i in size]
        return self._space.constant(eye, len(size))

    def solve(self, right: Stored) -> Stored:
        """The X with L X = B."""
        return self._solved("solved", roots.solved, right.plain())

    def solve_transposed(self, right: Stored) -> Stored:
        """The X with Lᵀ X = B."""
        return self._solved("solved back", roots.solved_transposed, right.plain())

    def _solved(self, name: str, write: Callable[..., None], right: Stored) -> Stored:
        found = self._space.new(*right.shape)
        self._space.call(name, write, self._upper, self._over, right, found)
        return found
