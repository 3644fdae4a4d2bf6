"""The potentials of clusters as rows: their linearised CPDs, in the units of a frame.

A CPD is y = F p + b + v: y is its child, (d,), p are its hidden parents, and v is Gaussian noise of
covariance Σ. It is a factor over w hidden components x: those of p, and those of y if y is hidden.
A *frame* has coordinates ξ for them, x = m + s ξ, of means m and units s; a subscript y or p tells
the part of s or ξ that is the child's or the parents'. The residual e is y − (F p + b) at the means
m, or at the measured y. The noise is then

    v = e + s_y ξ_y − F s_p ξ_p,

without the term s_y ξ_y where y is observed. Both sides are divided by a root of Σ, which makes d
*rows* A ξ − r. The CPD's factor is exp(−½ ‖A ξ − r‖²), times a scale. An *exact* row is one without
noise: a relation that holds exactly. A *group* is made of copies of one CPD, which are linearised
together.

V is the number of matrices A that are kept of a CPD, and N the number of right sides r that go with
each: V = 1 and N = runs where all runs share matrices and noises, else V = runs and N = 1.

A residual is a sum of numbers, whose rounding costs digits. The number `coarse` measures them, for
the worst row: it is a tenth of the residual's largest summand, in standard deviations of the noise;
for an exact row, in units of the row's length. It is infinite where rounding may decide whether a
component has any variance, or a row any noise.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from pgm.beliefs.gaussian.anchors import anchor_rows
from pgm.beliefs.gaussian.assembly import Assembly
from pgm.beliefs.gaussian.beliefs import Flat, by_run
from pgm.beliefs.gaussian.model import Model
from pgm.beliefs.gaussian.refusals import indefinite_noise
from pgm.kernels import roots, solving
from pgm.kernels.arrays import LOG_2PI, Array, Integers, Mask, apply, independent
from pgm.kernels.rows import pivoted
from pgm.schedules.iteration import Anchor

# A residual with summands of size s costs as many digits as an entry of this times s.
COARSE = 1e-1


@dataclass(frozen=True, eq=False)
class Potentials:
    """The rows of factors, one after another as `assembly` has them: of CPDs, then of an anchor.

    Rows are kept flat: A (V, entries), with the entries of all matrices, and r (V, rows, N).
    `proper` has the rows with noise, and zeros in place of the exact rows; `exact` has the exact
    rows, and zeros in place of the rows with noise. It is None if no row is exact. `log_scale` (V,
    factors, N) are the logarithms of the factors' scales. `coarse` measures the digits
    that rounding of residuals costs, in the worst row, and `coarse_exact` in the worst of the CPDs
    that have exact rows.
    """

    assembly: Assembly
    proper: Flat
    exact: Flat | None
    log_scale: Array
    coarse: float
    coarse_exact: float = 0.0

    def column_squares(self) -> Array:
        """The squares of the columns of all rows with noise, (V, size), by components' places."""
        found = np.zeros((len(self.proper.matrix), self.assembly.size))
        for k, factors in enumerate(self.assembly.factors):
            rows = self.assembly.matrices(k, self.proper.matrix)
            squares = np.einsum("vchw,vchw->vcw", rows, rows)
            for one, own in zip(found, squares, strict=True):
                one += np.bincount(factors.places.ravel(), own.ravel(), self.assembly.size)
        return found

    def largest_residual(self, mean: Array) -> float:
        """The largest |A ξ − r| of a row with noise, in its deviations, at means ξ (V, size, N)."""
        worst = 0.0
        for k, factors in enumerate(self.assembly.factors):
            rows = self.assembly.matrices(k, self.proper.matrix)
            right = self.assembly.sides(k, self.proper.right)
            away = np.abs(rows @ mean[:, factors.places] - right)
            worst = float(np.maximum(worst, away.max(initial=0.0)))  # NaN stays
        return worst


def make_potentials(model: Model, anchor: Anchor | None = None) -> Potentials:
    """Turn the linearised CPDs of a model into rows, and those of an anchored layout's anchor.

    With Σ = L Lᵀ the rows are L⁻¹ [s_y, −F s_p], and the right sides −L⁻¹ e. Where a pivot of L is
    zero, that component of the noise is determined by the components before it, and the row is
    exact. An indefinite Σ is a NumericalError.
    """
    if not model.layout.shapes:
        stacked, sides = (1, model.runs) if model.shared else (model.runs, 1)
        empty = np.zeros((stacked, 0, sides))
        none = Flat(np.zeros((stacked, 0)), empty)
        return Potentials(model.layout.assembly, none, None, empty, 0.0)
    parts = [_part(model, groups) for groups in model.layout.shapes]
    proper = Flat.of([part.matrix for part in parts], [part.right for part in parts])
    exact = None
    if any(part.fixed for part in parts):
        exact = Flat.of([part.exact for part in parts], [part.exact_right for part in parts])
    scales = [part.log_scale for part in parts]
    if model.layout.anchored:
        stacked, _, sides = scales[0].shape
        scales.append(np.zeros((stacked, model.layout.size, sides)))
        proper = proper.before(anchor_rows(model, anchor))
        exact = None if exact is None else exact.before(anchor_rows(model, None))
    return Potentials(
        model.layout.assembly,
        proper,
        exact,
        np.concatenate(scales, axis=1),
        max(part.coarse for part in parts),
        max((part.coarse for part in parts if part.fixed), default=0.0),
    )


class _Linearised(NamedTuple):
    """Linearised CPDs of one shape, in the coordinates ξ: v = e + s_y ξ_y − F s_p ξ_p.

    The first axis runs over CPDs. `matrix` is [s_y, −F s_p], (CPDs, V, d, w), without s_y where
    children are observed. `residual` is e, (CPDs, runs, d), and `size`, of the same shape, bounds
    the numbers that e is a sum of. `noise` is Σ, (CPDs, V, d, d). `known` (CPDs, w) marks the
    columns of parents without variance in the prior. `missing` (CPDs, V) counts the components of
    an observed child that were not measured: their rows are zero, and their noise is independent,
    of variance one. `doubtful` (CPDs,) marks a hidden child with a component that has no variance
    in the prior although it depends on a parent with variance: it is open whether the terms of F p
    cancel exactly, or by rounding. `surplus` (CPDs, V) is what the log-density of robust noise has
    beside that of the noise N(0, Σ) in its place; zero of Gaussian noise.
    """

    matrix: Array
    residual: Array
    noise: Array
    known: Mask
    size: Array
    missing: Integers
    doubtful: Mask
    surplus: Array

    @classmethod
    def of(cls, model: Model, g: int) -> _Linearised:
        """The CPDs of group g, in the coordinates of the model's frame.

        Where the child y is observed, e is taken at the measured y.
        """
        frame, runs = model.frame, 1 if model.shared else model.runs
        group, family, reading = model.layout.groups[g], model.families[g], model.moved[g]
        at = frame.mean[:, group.parents].swapaxes(0, 1)
        value = family.value(slice(None), at)
        child = frame.mean[:, group.child].swapaxes(0, 1) if reading is None else reading
        certain, doubtful = frame.certain[group.parents], np.zeros(len(group.cpds), dtype=bool)
        matrix = family.matrix[:, :runs] * -frame.scale[group.parents][:, None, None, :]
        if reading is None:
            varying = (family.matrix[:, :runs] != 0.0) & ~certain[:, None, None]
            fixed = frame.certain[group.child][:, None, :, None]
            doubtful = (varying & fixed).any(axis=(1, 2, 3))
            diagonal = frame.scale[group.child][:, None, :, None] * np.eye(group.height)
            wide = np.broadcast_to(diagonal, (*matrix.shape[:3], group.height))
            matrix = np.concatenate([wide, matrix], axis=-1)
        terms = apply(np.abs(family.matrix), np.abs(at)) + np.abs(family.offset)
        size, noise = np.maximum(terms, np.abs(child)), family.noise[:, :runs]
        residual, missing = child - value, np.zeros((len(group.cpds), runs), dtype=np.intp)
        taken = model.taken[g]
        if taken is not None:
            matrix = np.where(taken[..., None], matrix, 0.0)
            residual, size = np.where(taken, residual, 0.0), np.where(taken, size, 0.0)
            # A flat component counts as one of variance one would: the chain's convention.
            flat = np.isinf(np.diagonal(family.own_noise, axis1=-2, axis2=-1))
            noise, missing = independent(noise, taken), missing + (~(taken | flat)).sum(axis=-1)
        known = np.pad(certain, [(0, 0), (matrix.shape[-1] - certain.shape[1], 0)])
        weights = model.weights[g]
        surplus = np.zeros(missing.shape) if weights is None else weights.surplus()
        return cls(matrix, residual, noise, known, size, missing, doubtful, surplus)


@dataclass(frozen=True, eq=False)
class _Factor:
    """The rows of CPDs of one shape, (V, CPDs, d, w), with right sides (V, CPDs, d, N).

    `matrix` and `right` have the rows with noise, and zeros in place of the exact rows; `exact` and
    `exact_right` have the exact rows, and zeros in place of the rows with noise. `fixed` says
    whether some row is exact. `log_scale` (V, CPDs, N) are the logarithms of the factors' scales.
    `coarse` measures the digits that rounding of residuals costs, in the worst row.
    """

    matrix: Array
    right: Array
    exact: Array
    exact_right: Array
    fixed: bool
    log_scale: Array
    coarse: float


class _Noise(NamedTuple):
    """The noise of CPDs of one shape: correlations with a root L, and deviations.

    `deviation` (V, CPDs, d, 1) and `order` (V, CPDs, d, 1) are those of the components, each of
    which has the largest variance given those before it; `lower` is L (V, CPDs, d, d) in this
    order, `fixed` (V, CPDs, d) marks its zero pivots. `open` says that a pivot lies between what
    may be rounding and what may not.
    """

    deviation: Array
    order: Integers
    lower: Array
    fixed: Mask
    open: bool

    @classmethod
    def of(cls, model: Model, groups: list[int], noise: Array) -> _Noise:
        """The noise (CPDs, V, d, d) of the CPDs in some groups; if it is their own, it is kept."""
        # Of a linearisation's error the noise is made anew, in memory that may be written.
        kept = not any(model.families[g].noise.flags.writeable for g in groups)
        key = tuple(groups)
        if not kept or key not in model.noises:
            model.noises[key] = cls._of(model, groups, noise.swapaxes(0, 1))
        found: _Noise = model.noises[key]
        return found

    @classmethod
    def _of(cls, model: Model, groups: list[int], noise: Array) -> _Noise:
        deviation, order, correlation, lower = pivoted(noise)
        if not roots.is_proper(lower):
            bad = np.isnan(lower).any(axis=(0, 2, 3))
            cpds = [cpd for g in groups for cpd in model.layout.groups[g].cpds]
            raise indefinite_noise(cpds[int(np.flatnonzero(bad)[0])])
        fixed = roots.determined(lower)
        doubt = fixed.any() and (roots.determined(roots.root(correlation)) != fixed).any()
        return cls(deviation, order, lower, fixed, bool(doubt))


def _part(model: Model, groups: list[int]) -> _Factor:
    """The rows of the CPDs in some groups, made once where they do not change from step to step."""
    if not all(_is_constant(model, g) for g in groups):
        return _factor(model, groups)
    if tuple(groups) not in model.rows:
        model.rows[tuple(groups)] = _factor(model, groups)
    found: _Factor = model.rows[tuple(groups)]
    return found


def _is_constant(model: Model, g: int) -> bool:
    # Angles that are read are moved by whole turns.
    turns = model.readings[g] is not None and model.families[g].cpd.child.angle_mask.any()
    return model.families[g].settled and not turns


def _factor(model: Model, groups: list[int]) -> _Factor:
    """The rows of the CPDs in some groups, given by number, whose CPDs all have one shape.

    The covariance Σ is turned into correlations. Its components are ordered so that each has the
    largest variance given those before it, and its root is taken in that order. Exact rows are
    scaled to unit length, so that relations in different units can be compared. An exact row
    without variables only says whether the evidence agrees with the model: its right side is
    divided by the size of its summands.
    """
    each = zip(*(_Linearised.of(model, g) for g in groups), strict=True)
    given = _Linearised(*map(np.concatenate, each))
    matrix = given.matrix.swapaxes(0, 1)
    residual, size = (by_run(part, shared=model.shared) for part in (given.residual, given.size))
    noise = _Noise.of(model, groups, given.noise)
    deviation, order, lower = noise.deviation, noise.order, noise.lower
    own, residual, size = (
        np.take_along_axis(part / deviation, order, axis=-2) for part in (matrix, residual, size)
    )
    matrix = solving.solve_lower(lower, own)
    right = -solving.solve_lower(lower, residual)
    fixed = noise.fixed
    height = lower.shape[-1]
    dimension = height - fixed.sum(axis=-1) - given.missing.T
    log_scale = -0.5 * (dimension * LOG_2PI + solving.log_determinant(lower))
    log_scale = log_scale - np.log(deviation).sum(axis=(-2, -1)) + given.surplus.T
    log_scale = np.broadcast_to(log_scale[..., None], (*log_scale.shape, right.shape[-1]))
    if not fixed.any():
        none = np.zeros_like(matrix), np.zeros_like(right)
        coarse = COARSE * float(size.max(initial=0.0))
        return _Factor(matrix, right, *none, False, log_scale, coarse)
    exact = np.where(given.known[:, None], 0.0, matrix)
    length = np.sqrt(np.einsum("...ij,...ij->...i", exact, exact))
    # A row without variables left is evidence that is met or not, in units of its own size.
    weights = np.abs(solving.solve_lower(lower, np.broadcast_to(np.eye(height), lower.shape)))
    summands = np.sqrt(np.einsum("...ij,...ij->...i", own, own))
    nothing = fixed & (length <= roots.NEGLIGIBLE * apply(weights, summands))
    numbers = weights @ size
    size = np.maximum(numbers, 1.0)
    length = np.where(fixed & ~nothing, length, 1.0)
    share = (fixed & ~nothing)[..., None] / length[..., None]
    coarse = COARSE * float((numbers / length[..., None]).max(initial=0.0))
    # A pivot of a noise between what may be rounding and what may not leaves it open.
    if given.doubtful.any() or noise.open:
        coarse = np.inf
    return _Factor(
        np.where(fixed[..., None], 0.0, matrix),
        np.where(fixed[..., None], 0.0, right),
        exact * share,
        right * np.where(nothing[..., None], 1.0 / size, share),
        True,
        log_scale - np.log(length).sum(axis=-1)[..., None],
        coarse,
    )
