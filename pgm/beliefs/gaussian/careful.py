"""Inference on a small network in as many decimals as it needs, where float64 loses them.

A linearised CPD is y = F p + b + v: the child y has d components, p are its hidden parents, and v
is Gaussian noise. The numbers F and b and the noise's covariance are taken as exact decimals, and a
dense joint Gaussian of all hidden components is made of the CPDs (`dense`).

Then only one error is left: the linearised value F μ + b, at the parents' mean μ, was calculated in
float64, and is wrong by about the last places of its summands. To first order this error is carried
on to the posterior means and to ln p(evidence), and tells how many of their digits are correct.

V is the number of joint covariances, and N the number of columns of means that go with each: V = 1
and N = runs where all runs share their matrices, else V = runs and N = 1. A component's *place* is
its index in the vector of all hidden components, (size,). A *group* is made of copies of one CPD,
whose linearisations are the rows of a `Family`. A *frame* has a mean and a unit for each hidden
component: the mean of the prior or of a start, and the prior's standard deviation (`Frame`).

The joint's means are (V, components, columns): N columns of means, then an *error column* for each
child component of a nonlinear CPD. An error column begins as the rounding error of that component's
linearised value, with zeros for all others, and goes through the same operations as the means. At
the end it has the shift of each posterior mean by that error.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from decimal import Decimal

import numpy as np

from pgm.beliefs.gaussian.anchors import holds
from pgm.beliefs.gaussian.beliefs import Beliefs, by_run
from pgm.beliefs.gaussian.conditionals import Conditional, Conditionals, Root
from pgm.beliefs.gaussian.dense import Joint
from pgm.beliefs.gaussian.layout import Layout
from pgm.beliefs.gaussian.linearised_rounding import rounding
from pgm.beliefs.gaussian.model import Model
from pgm.beliefs.gaussian.prior import SHARE, Frame
from pgm.beliefs.gaussian.refusals import contradiction
from pgm.beliefs.gaussian.tree import TreePlan
from pgm.kernels import decimals
from pgm.kernels.arrays import Array, Integers, deviation, variances
from pgm.kernels.decimals import ONE, ZERO, Decimals
from pgm.linearisation.family import Family
from pgm.schedules.iteration import Anchor

# How far a measurement may be from the value that a model without noise determines, as a part of
# the summands of that value and of the prior's standard deviation: a user calculates in float64.
CONTRADICTION = Decimal("1e-12")
# The same, in multiples of the largest error that the rounding of linearised values causes.
OF_ROUNDING = 10
# Decimal digits of a mean that float64 holds.
ALL_DIGITS = -np.log10(2.0**-52)
# Element operations of a solution beyond which it would take longer than some ten seconds.
MOST_WORK = 4 * 10**6
# The most decimals that are calculated with; what is too small to show in them is zero.
MOST_DIGITS = 6000
# Decimals for finding how many a solution takes, and for the prior, before that is known.
FEW, MANY = 30, 400


def work(layout: Layout, runs: int, shared: bool) -> int:
    """About how many element operations `solve` takes; `shared` says whether V is 1."""
    size = layout.size
    read = sum(len(g.cpds) * g.height for g in layout.groups if g.observed)
    return (size + read) * size * ((1 if shared else runs) * size + runs)


class DenseBeliefs(Beliefs):
    """The joint moments of all hidden components, in the user's units, not in those of a frame.

    `mean` is (runs, size), `cov` (V, size, size).
    """

    def moments(self, where: Integers, entries: Integers, places: Integers) -> tuple[Array, Array]:
        """Means (runs, ..., n) and covariances (V, ..., n, n) of components at `places` (..., n).

        `where` and `entries`, the flat indices that other `Beliefs` need, are ignored.
        """
        return self.mean[:, places], self.cov[:, places[..., :, None], places[..., None, :]]

    def components(self) -> tuple[Array, Array]:
        """Means (runs, size) and standard deviations (V, size) of all hidden components."""
        return self.mean, deviation(self.cov)

    def with_means(self, mean: Array) -> DenseBeliefs:
        """The beliefs with other means of all hidden components, (runs, size)."""
        return replace(self, mean=mean)


@dataclass(frozen=True, eq=False)
class Solution:
    """The beliefs, ln p(evidence), (V, N), and each run's correct decimal digits, (runs,).

    Digits are correct if rounding does not change them. A mean has k correct digits if rounding
    moves it by about 10⁻ᵏ posterior standard deviations, and ln p if rounding moves it by about
    10⁻ᵏ. The number of a run is the smallest of those of its means and of its ln p.
    """

    beliefs: DenseBeliefs
    log_evidence: Array
    digits: Array


def predictive(
    layout: Layout,
    families: list[Family],
    runs: int,
    *,
    shared: bool,
    start: Array | None = None,
) -> Frame:
    """The frame of the prior predictive moments, calculated in decimals and rounded at the end.

    It has the means of all hidden components, and their standard deviations as units. `families`
    has a `Family` for each group; nonlinear CPDs are linearised on the way, at their parents'
    moments in float64. `shared` says whether V is 1. `start` is ignored: it is an argument because
    this function stands in for `prior_predictive`, which has it, where float64 loses digits.
    """
    conditionals = Conditionals(layout, families, runs, shared)
    with decimals.precision(MANY):
        joint = Joint.empty(
            conditionals.stacked, layout.size, runs if shared else 1, Decimal(10) ** -(MANY // 2)
        )
        for g, row in layout.order:
            group, family = layout.groups[g], families[g]
            parents = group.parents[row]
            if not family.exact:
                inside = decimals.floats(joint.cov[:, parents[:, None], parents])
                mean = conditionals.by_float(joint.mean[:, parents])
                family.linearise(row, mean, np.broadcast_to(inside, (runs, *inside.shape[1:])))
            if not group.observed:
                conditional = conditionals.conditional(g, row)
                made = conditional.matrix, conditional.offset, conditional.noise
                joint.add(group.child[row], parents, *made)
        mean = conditionals.by_float(joint.mean)
        variance = decimals.floats(variances(joint.cov))
    scale = np.sqrt(variance.max(axis=0, initial=0.0))
    scale = np.maximum(scale, SHARE * np.abs(mean).max(axis=0, initial=0.0))
    return Frame(mean, np.where(scale > 0.0, scale, 1.0), (variance == 0.0).all(axis=0))


def solve(plan: TreePlan, model: Model, anchor: Anchor | None = None) -> Solution:
    """The exact beliefs of the linearised network, in as many decimals as it needs.

    An anchor's measurement of each component is added to the CPDs, if there is one.

    If its standard deviations and slopes together span k powers of ten (`Conditionals.span`), it
    takes 4k + 60 decimals, at most 6000. Measurements that contradict CPDs without noise are a
    NumericalError, which names the cluster and the run, and so is an indefinite noise, which names
    the CPD.
    """
    conditionals = Conditionals(plan.layout, model.families, model.runs, model.shared)
    with decimals.precision(FEW):
        count = min(2 * (2 * conditionals.span() + FEW), MOST_DIGITS)
    with decimals.precision(count):
        return _solve(plan, model, conditionals, Decimal(10) ** -(count // 2), anchor)


def _solve(
    plan: TreePlan,
    model: Model,
    conditionals: Conditionals,
    nothing: Decimal,
    anchor: Anchor | None,
) -> Solution:
    """The beliefs and ln p(evidence), in as many decimals as the present context of `decimal` has.

    The CPDs of `conditionals` are taken in turn, parents first. Each child joins a dense joint; for
    an observed child the joint is conditioned on its reading, and the child leaves again. The
    covariance of two components counts as zero, being mere rounding, if it is below `nothing` times
    the product of their standard deviations (upper bounds of the prior's).
    """
    layout = plan.layout
    sides = model.runs if model.shared else 1
    roundings = [None if f.exact else rounding(model, g) for g, f in enumerate(model.families)]
    columns = sum(
        len(group.cpds) * group.height
        for group, lost in zip(layout.groups, roundings, strict=True)
        if lost is not None
    )
    height = max((group.height for group in layout.groups if group.observed), default=1)
    joint = Joint.empty(conditionals.stacked, layout.size + height, sides + columns, nothing)
    log_density, moved = np.zeros((conditionals.stacked, sides)), np.zeros(conditionals.stacked)
    done = sides
    for conditional in conditionals:
        group, row, lost = conditional.group, conditional.row, roundings[conditional.g]
        offset = np.concatenate(
            [conditional.offset, decimals.zeros(conditionals.stacked, group.height, columns)],
            axis=-1,
        )
        if lost is not None:
            own = np.arange(group.height)
            offset[:, own, done + own] = decimals.exact(lost[row])
            done += group.height
        parents = group.parents[row]
        if not group.observed:
            joint.add(group.child[row], parents, conditional.matrix, offset, conditional.noise)
        else:
            said, lost_of_it = _read(model, conditionals, conditional, joint, offset)
            log_density += said
            moved = np.maximum(moved, lost_of_it)
            weights = model.weights[conditional.g]
            if weights is not None:
                log_density += by_run(
                    weights.surplus()[conditional.row][:, None], shared=model.shared
                )[:, 0]
    size = layout.size
    if anchor is not None:
        _hold(model, joint, anchor)
    mean, cov = joint.mean[:, :size, :sides], decimals.floats(joint.cov[:, :size, :size])
    found = DenseBeliefs(plan.places, model.frame, conditionals.by_float(mean), cov)
    return Solution(found, log_density, _digits(model, joint, sides, moved))


def _read(
    model: Model,
    conditionals: Conditionals,
    conditional: Conditional,
    joint: Joint,
    offset: Decimals,
) -> tuple[Array, Array]:
    """Condition the joint on the measurement z of an observed child, component after component.

    `conditional` is the child's CPD, whose noise has the covariance Σ = L D Lᵀ. L⁻¹ z is read in
    place of z, since its components have independent noise, of variances D. `offset` (V, d,
    columns) has b in the columns of means, and the rounding errors of F μ + b in error columns.

    Returns ln p(z) given the measurements read before, (V, N), and the largest shift that rounding
    makes in ln p of a component, (V,). If the model determines a component, and z has another value
    there, that is a NumericalError.
    """
    group, row, g = conditional.group, conditional.row, conditional.g
    reading, taken = model.moved[g], model.taken[g]
    assert reading is not None
    value = conditionals.by_run(decimals.exact(reading[row]))
    matrix, noise = conditional.matrix, conditional.noise
    open_ = np.ones((conditionals.stacked, group.height), dtype=bool)
    if taken is not None:
        # What is missing is read as a number of unit variance that nothing depends on.
        open_ = np.broadcast_to(taken[row], open_.shape)
        matrix, offset, value = (
            np.where(open_[..., None], part, ZERO) for part in (matrix, offset, value)
        )
        alone = np.where(open_, ZERO, ONE)[..., None] * decimals.exact(np.eye(group.height))
        noise = np.where(open_[..., None] & open_[..., None, :], noise, alone)
    each = [root for root in map(Root.of, noise) if root is not None]
    matrix, offset, value = (
        np.stack([root.whitened(part) for root, part in zip(each, parts, strict=True)])
        for parts in (matrix, offset, value)
    )
    open_ = np.stack([mask[root.order] for mask, root in zip(open_, each, strict=True)])
    pivots = np.stack([root.pivots for root in each])
    parents = group.parents[row]
    places = np.arange(model.layout.size, model.layout.size + group.height)
    diagonal = pivots[..., None] * decimals.exact(np.eye(group.height))
    joint.add(places, parents, matrix, offset, diagonal)
    sides = value.shape[-1]
    total, moved = np.zeros((conditionals.stacked, sides)), np.zeros(conditionals.stacked)
    for k, place in enumerate(places.tolist()):
        at = np.abs(joint.mean[:, parents, :sides])
        numbers = decimals.product(np.abs(matrix[:, k : k + 1]), at)[:, 0]
        numbers = numbers + np.abs(offset[:, k, :sides]) + np.abs(value[:, k])
        allowed = CONTRADICTION * (numbers + joint.edge[:, place, None])
        rounded = decimals.total(np.abs(joint.mean[:, place, sides:]))
        allowed = allowed + OF_ROUNDING * rounded[:, None]
        read = joint.read(place, value[:, k], allowed)
        if read.contradiction.any():
            raise contradiction(model, int(group.clusters[row]), np.nonzero(read.contradiction))
        total += np.where(open_[:, k, None], read.log_density, 0.0)
        moved = np.maximum(moved, read.moved)
    joint.forget(places)
    return total, moved


def _hold(model: Model, joint: Joint, anchor: Anchor) -> None:
    """Condition the joint on an anchor's measurement of each component that it holds."""
    size = model.layout.size
    stacked, _, columns = joint.mean.shape
    held, root = holds(model, anchor)
    scratch, nothing = np.array([size]), decimals.zeros(stacked, 1, columns)
    for place in range(size):
        # In a run that is not held a number of unit variance is read that nothing depends on.
        open_ = held[:, place, None]
        slope = decimals.exact(np.where(open_, root[:, place, None], 0.0))
        value = slope * decimals.exact(anchor.mean[0][:, place, None])
        unit = decimals.exact(np.ones((stacked, 1, 1)))
        joint.add(scratch, np.array([place]), slope[..., None], nothing, unit)
        joint.read(size, value, value)
        joint.forget(scratch)


def _digits(model: Model, joint: Joint, sides: int, moved: Array) -> Array:
    """The correct decimal digits of each run's means and ln p, (runs,).

    They are −log₁₀ of the run's largest shift by rounding, at most the digits of float64. The
    largest shift is the larger of two numbers: the largest shift of a component's mean, in
    posterior standard deviations, and that of ln p, `moved` (V,). The shift of a mean is the sum of
    the sizes in its error columns, which follow the first `sides` columns of `joint.mean`. Without
    error columns all digits of float64 are correct.

    Before the CPDs are linearised for a second time (`model.first`), the rounding of slopes counts
    the more, the further the posterior means are from the frame's means, where the CPDs were
    linearised. The shift is then multiplied by the largest of these distances, in standard
    deviations of the prior, if it is more than one.
    """
    size = model.layout.size
    lost = decimals.floats(np.abs(joint.mean[:, :size, sides:]).sum(axis=-1))
    if joint.mean.shape[-1] == sides:
        return np.full(model.runs, ALL_DIGITS)
    variance = variances(joint.cov[:, :size, :size])
    std = decimals.floats(decimals.sqrt(np.maximum(variance, ZERO)))
    # Where the posterior has no variance, the unit is a part of the prior's standard deviation, or
    # a millionth of the number.
    number = decimals.floats(np.abs(joint.mean[:, :size, :sides]).max(axis=-1))
    unit = np.where(std > 0.0, std, np.maximum(1e-3 * model.frame.scale, 1e-6 * number))
    share = np.maximum((lost / unit).max(axis=-1, initial=0.0), moved)
    if model.first:
        # Far from where it was linearised a slope's rounding counts the more.
        mean, frame = decimals.floats(joint.mean[:, :size, 0]), model.frame
        share = share * (np.abs(mean - frame.mean) / frame.scale).max(axis=-1, initial=1.0)
    digits = np.minimum(-np.log10(np.maximum(share, 1e-300)), ALL_DIGITS)
    return np.broadcast_to(digits, (model.runs,)).copy()
