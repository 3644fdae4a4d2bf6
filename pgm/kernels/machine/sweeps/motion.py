"""The slice of a step predicted from the one before."""

from __future__ import annotations

from collections.abc import Sequence
from math import pi
from operator import add
from typing import Any, NamedTuple

from pgm.kernels import step
from pgm.kernels.machine.emitter.numbers import Number
from pgm.kernels.machine.emitter.variables import held
from pgm.kernels.machine.emitter.wholes import Whole
from pgm.kernels.machine.sweeps.cpd import Line, keep, linearised, value_at
from pgm.kernels.machine.sweeps.told import Forward, Motion
from pgm.kernels.machine.sweeps.writer import Writer
from pgm.kernels.numbers import Matrix, inner, most, sqrt, where
from pgm.kernels.step import AnyMatrix

# As of `gaussian` and `moments`.
_ROUNDING, _NEGLIGIBLE = 1e-14, 1e-13


class Predicted(NamedTuple):
    """The moments of a slice, and whether they are right, so far as can be told."""

    mean: AnyMatrix
    cov: AnyMatrix
    sure: Number


def predicted(w: Writer, chain: Forward, at: Whole, mean: AnyMatrix, cov: AnyMatrix) -> Predicted:
    """The slice at a row of the transition, from the moments of the slice before."""
    if chain.single:
        motion = chain.motions[0]
        line = line_of(w, motion, at, mean, mean, cov)
        after = step.predict(cov, line.matrix, line.noise)
        return Predicted(line.value, after, line.sure & _is_certain(w, motion, line, cov, after))
    front = chain.states
    pair, joint = mean.part(front, (0,)), cov.part(front, front)
    sure = w.true
    for motion in chain.motions:
        x, block = pair.part(motion.parents, (0,)), joint.part(motion.parents, motion.parents)
        line = line_of(w, motion, at, pair, x, block)
        joint = step.extend(joint, motion.parents, line.matrix, line.noise)
        own = joint.part(*([range(pair.shape[0], joint.shape[0])] * 2))
        sure = sure & line.sure & _is_certain(w, motion, line, block, own)
        pair = w.matrices.above(pair, line.value)
    own = range(len(front), pair.shape[0])
    return Predicted(pair.part(own, (0,)), joint.part(own, own), sure)


def transition(w: Writer, chain: Forward, at: Whole) -> tuple[Matrix, Matrix]:
    """The matrix and the noise of p(slice | states before) at a row, of affine CPDs together."""
    if chain.single:
        motion = chain.motions[0]
        assert motion.matrix is not None
        return w.matrix(motion.matrix, at), w.symmetric(motion.noise, at)
    front = range(len(chain.states))
    # Each component as a map of the states before; the noise is what is left without theirs.
    rows: list[Sequence[Any]] = [[1.0 if i == j else 0.0 for j in front] for i in front]
    spread = Matrix([[0.0] * len(front) for _ in front])
    for motion in chain.motions:
        assert motion.matrix is not None
        matrix = w.matrix(motion.matrix, at)
        rows += (matrix @ Matrix([rows[i] for i in motion.parents], len(front))).rows
        spread = step.extend(spread, motion.parents, matrix, w.symmetric(motion.noise, at))
    own = range(len(front), len(rows))
    return Matrix([rows[i] for i in own]), spread.part(own, own)


def line_of(
    w: Writer, motion: Motion, at: Whole, before: AnyMatrix, mean: AnyMatrix, cov: AnyMatrix
) -> Line:
    """A CPD linearised, with its angles on the chart of those `before`, and kept."""
    line = linearised(w, motion, at, mean, cov)
    if motion.turning:
        line = line._replace(value=_on_chart(w, motion, at, before, mean, line.value))
    keep(w, motion, at, mean, line)
    w.keep(motion.kept, line.noise, at)
    return line


def _on_chart(
    w: Writer, motion: Motion, at: Whole, before: AnyMatrix, mean: AnyMatrix, value: AnyMatrix
) -> AnyMatrix:
    """A value without the whole turns by which a function wraps its angles.

    They are counted from the step before. A function that wraps gives the same for angles a whole
    turn on; another turns too.
    """
    m = w.matrices
    found = {new: value[new, 0] for new, _, _ in motion.turning}
    near = w.true
    for new, old, _ in motion.turning:
        near = near & (abs(found[new] - before[old, 0]) <= pi)
    charted = {new: held(w.code, x) for new, x in found.items()}
    with w.code.when(~w.code.every(near)):
        turned = {own: mean[own, 0] + step.TURN for _, _, own in motion.turning}
        here = value_at(w, motion, at, mean)
        further = value_at(w, motion, at, m.replaced(mean, turned))
        for new, old, _ in motion.turning:
            nearer = found[new] - step.turns(found[new] - before[old, 0])
            wraps = abs(further[new, 0] - here[new, 0]) < pi
            charted[new].set(where(wraps, nearer, found[new]))
    return m.replaced(value, {new: variable.get() for new, variable in charted.items()})


def _is_certain(w: Writer, motion: Motion, line: Line, cov: AnyMatrix, own: AnyMatrix) -> Number:
    """Whether zeros of components without noise need not be told from rounding."""
    sure = line.sure
    if line.matrix.shape[1]:
        deviations = [sqrt(most(v, 0.0)) for v in w.matrices.diagonal(cov)] if motion.bare else []
        for i in motion.bare:
            terms = [abs(f) for f in w.matrices.row(line.matrix, i)]
            size = w.together(add, [inner(terms, deviations)])
            sure = sure & (own[i, i] > _ROUNDING * size * size)
    if motion.unsure:
        sure = sure & (own.root().share > _NEGLIGIBLE)
    return sure
