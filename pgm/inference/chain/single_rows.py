"""A CPD of a single run at all its rows: what it is linearised to is kept, row by row."""

from __future__ import annotations

import numpy as np

from pgm.inference.chain.forward import keep_chart
from pgm.inference.chain.plan import Link
from pgm.inference.chain.single_motion import Affinity, Move
from pgm.inference.family import Family
from pgm.kernels.arrays import Array
from pgm.linearisers.single import Line
from pgm.linearisers.single_rules import prepare


class Rows:
    """A family with its arrays for one run, and the lean form of its lineariser."""

    def __init__(self, family: Family, *, joint: bool = False) -> None:
        self.family, self.exact = family, family.exact
        self.given = [_rows(values) for values in family.inputs.values()]
        self.lineariser, template = None, family.template
        if template is not None:
            inputs = {parent: k for k, parent in enumerate(family.inputs)}
            given = [inputs.get(parent) for parent in template.given]
            self.lineariser = prepare(template, family.lineariser, given, joint=joint)
            if not family.taylor:
                family.keep_errors()
        self.steps = family.step.tolist()
        own = family.own_noise[:, 0]
        # Where noise leaves a component out, zeros have to be told from their rounding.
        self.full = bool((np.diagonal(own, axis1=-2, axis2=-1) > 0.0).all())
        self.own = np.broadcast_to(own, (len(self.steps), *own.shape[1:]))
        self.see()

    def line(self, first: int, last: int, mean: Array, cov: Array) -> Line | None:
        """Linearise some rows as one at a belief over the hidden parents; None where it cannot."""
        if self.lineariser is None:
            return None
        count = last - first
        row = first if count == 1 else slice(first, last)
        try:
            rows = [values[row] for values in self.given]
            return self.lineariser.linearise(rows, count, self.steps[first], mean, cov)
        except Exception:
            return None  # the general way tells what is wrong, if anything is

    def see(self) -> None:
        """See the family's arrays, which the general way replaces where it makes room."""
        family = self.family
        self.matrix, self.offset = family.matrix[:, 0], family.offset[:, 0]
        self.noise = family.noise[:, 0]


def _rows(values: Array) -> Array:
    """The rows of a single run, contiguous and read-only, since functions of users see them."""
    rows = np.ascontiguousarray(values[:, 0])
    rows.flags.writeable = False
    return rows


class MoveRows(Rows, Move[int]):
    """A link of the transition, at each step a row."""

    def __init__(self, link: Link) -> None:
        Rows.__init__(self, link.family)
        Move.__init__(self, link)
        self.link = link

    def conditional(self, at: int, mean: Array, cov: Array) -> Affinity:
        """F, F μ + b and the noise of a row at a belief over the hidden parents."""
        line = self.line(at, at + 1, mean, cov)
        if line is None:
            if not self.exact:
                self.family.linearise(at, mean[None], cov[None])
                self.see()
            matrix = self.matrix[at]
            return matrix, matrix.dot(mean) + self.offset[at], self.noise[at]
        matrix, value, error = line
        self.matrix[at], self.offset[at] = matrix, value - matrix.dot(mean)
        noise: Array = self.own[at]
        if error is not None:
            error += noise
            self.noise[at] = noise = error
        return matrix, value, noise

    def unwrap(self, at: int, before: Array, child: Array) -> None:
        """Undo whole turns of a function that wraps its angles, in place."""
        keep_chart(self.link, at, before[None], child[None])
