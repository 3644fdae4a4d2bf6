"""Relations that hold exactly: CPDs of singular noise, and how points are moved to obey them.

A CPD is y = f(p) + e, and the noise e of covariance L Lᵀ obeys M e = 0, M = I − L L⁺: a row for
each component that is *determined* by those before it. Solutions of a linearised network obey its
linear relations; of nonlinear ones they obey the lines. A point is *retracted* to obey the
functions themselves. In two ways, CPD by CPD:

- Where a parent u of y is a parent of no other CPD, has noise of its own, and y is a function of it
  that can be inverted, such as x ⊕ u of a motion u, u is solved for, by Newton's method, and y
  stays: then no variable but u moves.
- Else y is carried: it is set to f(p) in its determined components, parents before children.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pgm.beliefs.gaussian.layout import Group
from pgm.beliefs.gaussian.model import Model
from pgm.cpds import ConditionalGaussian
from pgm.errors import ModelError
from pgm.kernels.angles import difference
from pgm.kernels.arrays import Array, Mask, apply, components_last, independent
from pgm.kernels.solving import left_open
from pgm.linearisation import costs
from pgm.linearisation.family import Family
from pgm.variables import Variable

# A relation that is missed by no more than this part of the numbers in it is obeyed: a linear one
# by a start, and a nonlinear one where points were retracted.
_OBEYED, _RETRACTED = 1e-10, 1e-9
# Steps of Newton's method at the most, and the condition number of a slope that can be inverted.
_STEPS, _INVERTIBLE = 20, 1e8


@dataclass(frozen=True, eq=False)
class Relations:
    """The exact relations of a network: those of linear CPDs, and of nonlinear ones.

    `linear` and `nonlinear` have pairs of a group's number and M, (CPDs or 1, runs or 1, d, d).
    `solved` has the groups of nonlinear CPDs in which a parent is solved for: their numbers, and
    the columns of that parent. `carried` are the CPDs whose children are carried, parents before
    children: the numbers of group and row, and M (runs or 1, d, d).
    """

    model: Model
    linear: Sequence[tuple[int, Array]]
    nonlinear: Sequence[tuple[int, Array]]
    solved: Sequence[tuple[int, slice]]
    carried: Sequence[tuple[int, int, Array]]

    @classmethod
    def of(cls, model: Model) -> Relations:
        """The relations of a network, whose points are retracted by the present linearisation.

        A ModelError refuses nonlinear relations that no retraction keeps: of readings, beside
        readings without noise whose values a retraction would move, and of linearisers that expect
        another value than the function's.
        """
        groups, families = model.layout.groups, model.families
        open_: dict[int, Array] = {}
        for g, family in enumerate(families):
            taken, own = model.taken[g], family.own_noise
            found = left_open(own if taken is None else independent(own, taken))
            if found is not None:
                open_[g] = found
        nonlinear = [(g, free) for g, free in open_.items() if not families[g].exact]
        for g, free in nonlinear:
            if groups[g].observed or not families[g].taylor:
                raise _uncontrolled(groups[g], free, "it is nonlinear and its noise is singular")
        private = _private(groups, frozenset(open_))
        solved = [
            (g, columns)
            for g, free in nonlinear
            if (columns := _invertible(groups[g], families[g], free, private)) is not None
        ]
        rest = {g for g, _ in nonlinear} - {g for g, _ in solved}
        carried = []
        if rest:
            for g, free in open_.items():
                if groups[g].observed:
                    raise _uncontrolled(
                        groups[g], free, "it is measured without noise beside nonlinear CPDs"
                    )
            moving = rest | {g for g in open_ if families[g].exact}
            for g, row in model.layout.order:
                if g in moving:
                    carried.append((g, row, open_[g][row if len(open_[g]) > 1 else 0]))
        linear = [(g, free) for g, free in open_.items() if families[g].exact]
        return cls(model, linear, nonlinear, solved, carried)

    def retracted(self, mean: Array) -> Array:
        """The means (runs, size), moved to where nonlinear CPDs of singular noise hold exactly."""
        if not self.nonlinear:
            return mean
        mean = mean.copy()
        for g, row, free in self.carried:
            group, family = self.model.layout.groups[g], self.model.families[g]
            child, at = group.child[row], mean[:, group.parents[row]]
            alone = slice(row, row + 1)
            value = costs.expected(family, alone, at[None], np.zeros((1, *at.shape, at.shape[-1])))
            left = difference(mean[:, child], value[0], family.cpd.child.angle_mask)
            mean[:, child] -= apply(free, left)
        for g, columns in self.solved:
            group = self.model.layout.groups[g]
            at = mean[:, group.parents].swapaxes(0, 1)
            child = mean[:, group.child].swapaxes(0, 1)
            found = _solved_for(self.model.families[g], at, columns, child)
            mean[:, group.parents[:, columns]] = found.swapaxes(0, 1)
        return mean

    def kept(self, mean: Array) -> Mask:
        """Whether means (runs, size) obey the nonlinear relations, as retracted ones, (runs,)."""
        return self._fits(self.nonlinear, mean, _RETRACTED)

    def obeyed(self, mean: Array) -> Mask:
        """Whether means (runs, size) obey all relations, (runs,)."""
        return self.kept(mean) & self._fits(self.linear, mean, _OBEYED)

    def _fits(self, relations: Sequence[tuple[int, Array]], mean: Array, least: float) -> Mask:
        """Whether means miss no relation by more than this part of the numbers in it, (runs,)."""
        model = self.model
        fits = np.ones(model.runs, dtype=bool)
        for g, free in relations:
            group, family, reading = model.layout.groups[g], model.families[g], model.moved[g]
            at = mean[:, group.parents].swapaxes(0, 1)
            child = mean[:, group.child].swapaxes(0, 1) if reading is None else reading
            if family.exact:
                value = family.value(slice(None), at)
                size = apply(np.abs(family.matrix), np.abs(at)) + np.abs(family.offset)
            else:
                none = np.zeros((*at.shape, at.shape[-1]))
                value = costs.expected(family, slice(None), at, none)
                size = np.abs(value)
                if reading is None:
                    size = size + model.frame.scale[group.child][:, None]
            left = difference(child, value, family.cpd.child.angle_mask)
            size = size + np.abs(child)
            taken = model.taken[g]
            if taken is not None:
                left, size = np.where(taken, left, 0.0), np.where(taken, size, 0.0)
            missed = np.abs(apply(free, left))
            fits &= (missed <= least * apply(np.abs(free), size)).all(axis=(0, -1))
        return fits


def _private(groups: Sequence[Group], singular: frozenset[int]) -> frozenset[Variable]:
    """Hidden variables with noise in all components that are parents of one CPD alone.

    `singular` are the numbers of the groups some of whose noise is singular.
    """
    uses = Counter(v for group in groups for cpd in group.cpds for v in cpd.given)
    return frozenset(
        cpd.child
        for g, group in enumerate(groups)
        if g not in singular and not group.observed
        for cpd in group.cpds
        if uses[cpd.child] == 1
    )


def _invertible(
    group: Group, family: Family, free: Array, private: frozenset[Variable]
) -> slice | None:
    """The columns of a parent, at one place in all CPDs, by which their children can be obeyed.

    None if there is none: the parent is a `private` one, of as many components as the child, whose
    noise is zero in all components, and the slopes have an inverse.
    """
    if not (free == np.eye(group.height)).all():
        return None
    found, stop = None, 0
    for k, first in enumerate(group.hidden):
        columns = slice(stop, stop + first.dimension)
        stop = columns.stop
        if first.dimension != group.height:
            continue
        if not all(_hidden(cpd, group, k) in private for cpd in group.cpds):
            continue
        slopes = family.matrix[..., columns]
        if np.isfinite(slopes).all() and (np.linalg.cond(slopes) < _INVERTIBLE).all():
            found = columns
    return found


def _hidden(cpd: ConditionalGaussian, group: Group, k: int) -> Variable:
    """The parent of a group's CPD in the place of the first's hidden parent number k."""
    return cpd.given[group.cpds[0].given.index(group.hidden[k])]


def _solved_for(family: Family, at: Array, columns: slice, child: Array) -> Array:
    """The values (CPDs, runs, d) of the parent in some columns at which children are f(parents).

    `at` (CPDs, runs, n) are the parents, from whose values Newton's method begins, and `child`
    (CPDs, runs, d) the children. Where it fails, the values miss, as `Relations.kept` then says.
    """
    at, angles = at.copy(), family.cpd.child.angle_mask
    none = np.zeros((*at.shape, at.shape[-1]))
    function = family.bound(slice(None), at.ndim - 1, at.shape[:-1])
    last = np.full(at.shape[1], np.inf)
    for _ in range(_STEPS):
        line = family.checked(function, at, none, finite=False)
        left = difference(child, components_last(line.value, 1), angles)
        size = np.abs(left).max(axis=(0, -1), initial=0.0)
        going = (size > 0.0) & (size < last)  # neither rounding nor NaN
        if not going.any():
            break
        last = np.where(going, size, 0.0)
        try:
            slope = components_last(line.matrix, 2)[..., columns]
            step = np.linalg.solve(slope, left[..., None])[..., 0]
        except np.linalg.LinAlgError:
            break
        at[..., columns] += np.where(going[:, None], step, 0.0)
    return at[..., columns]


def _uncontrolled(group: Group, free: Array, why: str) -> ModelError:
    """The error that steps cannot be controlled, since a CPD of a group has singular noise."""
    some = np.broadcast_to((free != 0.0).any(axis=(-3, -2, -1)), len(group.cpds))
    cpd = group.cpds[int(some.argmax())]
    return ModelError(
        f"{cpd!r}: {why}, so that nearly all points have an infinite cost: "
        "pgm.LevenbergMarquardt() cannot control the steps; use damping=0.5, or give it noise in "
        "all components",
        variable=cpd.child,
        cpd=cpd,
    )
