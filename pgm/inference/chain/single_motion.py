"""The transition of a single run: its CPDs prepared for one belief after another."""

from __future__ import annotations

import numpy as np

from pgm.cpds import Noise
from pgm.factors.scope import Scope
from pgm.inference.chain.forward import keep_chart
from pgm.inference.chain.plan import ChainPlan, Link
from pgm.inference.family import Family
from pgm.kernels import moments, single
from pgm.kernels.arrays import Array, block
from pgm.linearisers.single import Known, Line, prepare

_HALF_TURN = np.pi


class Prepared:
    """A family with its arrays for one run, and the lean form of its lineariser.

    Attributes
    ----------
    inputs : tuple of Variable
        The parents with evidence.
    known : list of ndarray or None
        For each argument of the function, its values (M, d); None where it is hidden.
    """

    def __init__(self, family: Family, *, joint: bool = False) -> None:
        self.family, self.exact = family, family.exact
        self.inputs = tuple(family.inputs)
        self.lineariser = None
        given: Scope = ()
        if family.template is not None:
            self.lineariser = prepare(family.template, family.lineariser, joint=joint)
            given = family.template.given
            if not family.taylor:
                family.keep_errors()
        self._arguments = [
            self.inputs.index(parent) if parent in family.inputs else None for parent in given
        ]
        self._late: tuple[int, list[Array]] | None = None
        # What is more than an argument of the function cannot wait until it is asked for.
        self._eager = self.exact or isinstance(family.cpd.cov, Noise)
        self._know([_rows(values) for values in family.inputs.values()])

    def _know(self, rows: list[Array]) -> None:
        """See the family's arrays without the axis of runs."""
        self.steps = self.family.step.tolist()
        self.known: Known = [None if k is None else rows[k] for k in self._arguments]
        own = self.family.own_noise[:, 0]
        # Where noise leaves a component out, zeros have to be told from their rounding.
        self.full = bool((np.diagonal(own, axis1=-2, axis2=-1) > 0.0).all())
        self.own = np.broadcast_to(own, (len(self.steps), *own.shape[1:]))
        self._see()

    def _see(self) -> None:
        family = self.family
        self.matrix, self.offset = family.matrix[:, 0], family.offset[:, 0]
        self.noise = family.noise[:, 0]

    def renew(self, step: int, rows: list[Array]) -> None:
        """Take other values of the parents with evidence, (M, d) each, all of one step."""
        self._late = step, rows
        if self._eager:
            self.settle()
            self._know(rows)
        else:
            self.steps = [step] * len(self.steps)
            self.known = [None if k is None else rows[k] for k in self._arguments]

    def settle(self) -> None:
        """Let the family know what has been renewed, before the general way is gone."""
        if self._late is not None:
            step, rows = self._late
            each = zip(self.inputs, rows, strict=True)
            self.family.renew(step, {parent: values[:, None] for parent, values in each})
            self._late = None

    def line(self, first: int, last: int, mean: Array, cov: Array) -> Line | None:
        """Linearise some rows as one at a belief over the hidden parents; None where it cannot."""
        if self.lineariser is None:
            return None
        count = last - first
        row = first if count == 1 else slice(first, last)
        try:
            return self.lineariser(self.known, row, count, self.steps[first], mean, cov)
        except Exception:
            return None  # the general way tells what is wrong, if anything is


def _rows(values: Array) -> Array:
    """The rows of a single run, contiguous and read-only, since functions of users see them."""
    rows = np.ascontiguousarray(values[:, 0])
    rows.flags.writeable = False
    return rows


class Move(Prepared):
    """A link of the transition."""

    def __init__(self, link: Link) -> None:
        super().__init__(link.family)
        self.link, self.child, self.parents = link, link.child, link.parents
        angles = link.child.start + link.angles
        self.turning = list(zip(angles.tolist(), link.before.tolist(), strict=True))

    def conditional(self, row: int, mean: Array, cov: Array) -> tuple[Array, Array, Array]:
        """F, F μ + b and the noise at a belief over the hidden parents."""
        line = self.line(row, row + 1, mean, cov)
        if line is None:
            if not self.exact:
                self.settle()
                self.family.linearise(row, mean[None], cov[None])
                self._see()
            matrix = self.matrix[row]
            return matrix, matrix.dot(mean) + self.offset[row], self.noise[row]
        matrix, self.offset[row], error, value = line
        self.matrix[row] = matrix
        noise: Array = self.own[row]
        if error is not None:
            error += noise
            self.noise[row] = noise = error
        return matrix, value, noise

    def keep_chart(self, row: int, before: Array, after: Array, front: int) -> None:
        """Undo whole turns of a function that wraps its angles, in place."""
        for angle, earlier in self.turning:
            if abs(after.item(angle - front) - before.item(earlier)) > _HALF_TURN:
                first = self.child.start - front
                child = after[first : first + self.link.family.cpd.child.dimension]
                self.settle()
                keep_chart(self.link, row, before[None], child[None])
                return


class Motion:
    """The transition of a plan of a single run."""

    def __init__(self, plan: ChainPlan) -> None:
        layout = plan.layout
        self.moves = [Move(link) for link in plan.transition]
        self.single = layout.single
        self.front, self.size = layout.state_size, layout.state_size + layout.slice_size
        self.whole = not layout.control_places.size

    def predict(self, row: int, mean: Array, cov: Array) -> tuple[Array, Array]:
        """Moments of the slice from those of the states before it."""
        front = self.front
        if self.single:
            move = self.moves[0]
            matrix, after, noise = move.conditional(row, mean, cov)
            if move.full:
                spread = single.predict(cov, matrix, noise)
            else:
                offset = move.offset[row]
                after, spread = moments.predict(
                    mean, cov, moments.Conditional(matrix, offset, noise)
                )
            move.keep_chart(row, mean, after, front)
            return after, spread
        pair, pair_cov = np.zeros(self.size), np.zeros((self.size, self.size))
        pair[:front] = mean
        pair_cov[:front, :front] = cov
        for move in self.moves:
            parents = move.parents
            matrix, value, noise = move.conditional(
                row, pair[parents], block(pair_cov, parents, parents)
            )
            if move.full:
                single.extend(pair, pair_cov, move.child, parents, matrix, value, noise)
            else:
                offset = move.offset[row]
                moments.extend(pair, pair_cov, move.child, parents, matrix, offset, noise)
            move.keep_chart(row, pair, pair, 0)
        return pair[front:], pair_cov[front:, front:]
