"""The CPDs of a chain in twice the digits: the prior, and affine conditionals of each slice."""

from __future__ import annotations

import numpy as np

from pgm.beliefs.moments.digits.careful_belief import ROUNDING, Belief, Move
from pgm.beliefs.moments.digits.certificate import is_flat
from pgm.beliefs.moments.passes.likelihoods import shortened
from pgm.beliefs.moments.steps.chain import MomentChain
from pgm.beliefs.moments.steps.plan import ChainPlan, Link
from pgm.beliefs.moments.steps.readings import Moments
from pgm.errors import LinearisationError
from pgm.kernels import extended
from pgm.kernels.arrays import Array, Mask, variances
from pgm.kernels.extended import Twofold
from pgm.kernels.roots import NEGLIGIBLE
from pgm.linearisation.family import Family
from pgm.schedules.schedule import ONCE


def prior_mean(plan: ChainPlan) -> Array:
    """The prior means of the states' m components, (runs, m).

    A component of infinite variance has the mean that the prior declares. Nonlinear CPDs of the
    prior are linearised in the plan; beside a flat prior a LinearisationError refuses them.
    """
    states = plan.layout.state_places
    if not is_flat(plan):
        return MomentChain(plan, ONCE).start().by_run[0][:, states]
    return start(plan, linearise=True).columns.hi[:, states, 0]


def start(plan: ChainPlan, *, linearise: bool) -> Belief:
    """The belief over the slice at step 0 before its measurements; controls there are zero.

    With `linearise` the nonlinear CPDs of the prior are linearised in the plan; beside a flat prior
    they are refused with a LinearisationError. Without it the plan's linearisations are used.
    """
    nonlinear = next((link.family for link in plan.prior if not link.family.exact), None)
    if linearise and nonlinear is not None:
        if is_flat(plan):
            raise LinearisationError(
                f"{nonlinear.cpd!r}: beside a prior of infinite variance only linear CPDs can "
                "stand at step 0; make it linear, or give the prior a finite variance",
                variable=nonlinear.cpd.child,
                cpd=nonlinear.cpd,
                step=0,
            )
        MomentChain(plan, ONCE).start()
    first = _conditional(plan.prior, slice(None), 0, plan.layout.state_size).at(0)
    size, states = plan.layout.slice_size, plan.layout.state_places
    where = np.arange(size)[states]
    columns = Twofold.zeros((plan.runs, size, 1 + first.columns.shape[-1]))
    cov = Twofold.zeros((plan.runs, size, size))
    columns[:, states, 0] = first.offset
    columns[:, states, 1:] = first.columns
    cov[:, where[:, None], where] = first.cov
    return Belief.first(columns, cov, ROUNDING, ROUNDING)


def transition(plan: ChainPlan, rows: slice) -> Move:
    """The transition of a plan, linearised: affine conditionals of slices given the slices before.

    `rows` picks steps, row t − 1 being of step t. The result's arrays are (rows or 1, runs or 1,
    ...); its columns of the earlier slice's controls, which do not act on the next, are zero.
    """
    layout = plan.layout
    found = _conditional(plan.transition, rows, layout.state_size, layout.slice_size)
    matrix = Twofold.zeros((*found.matrix.shape[:-1], layout.slice_size))
    matrix[..., layout.state_places] = found.matrix
    return found._replace(matrix=matrix)


def _conditional(links: list[Link], rows: slice, front: int, size: int) -> Move:
    """All CPDs of the links as one affine conditional, of a vector's end given its beginning.

    A link is a CPD at all its steps, with the places of its parents and its child in a vector of
    `front` + `size` components. Each child stands after its parents; the first `front` components
    are given, the rest are the children's. `rows` picks steps; the result's arrays are (rows or 1,
    runs or 1, ...). Each component of infinite noise variance becomes one of δ, with noise of unit
    variance.
    """
    families = [link.family for link in links]
    parts = [[shortened(part[rows]) for part in (f.matrix, f.offset, f.noise)] for f in families]
    flat = [np.asarray(np.isinf(variances(each[2])).any(axis=(0, 1))) for each in parts]
    lead = np.broadcast_shapes(*(part.shape[:2] for each in parts for part in each))
    whole, q = front + size, int(sum(each.sum() for each in flat))
    matrix = Twofold.zeros((*lead, whole, front))
    matrix.hi[..., :front, :] = np.eye(front)
    offset, cov = Twofold.zeros((*lead, whole)), Twofold.zeros((*lead, whole, whole))
    columns = Twofold.zeros((*lead, whole, q))
    done = 0
    for link, (own, shift, noise), open_ in zip(links, parts, flat, strict=True):
        child, parents, slope = link.child, link.parents, Twofold(own)
        spread = regular(noise, open_)
        if link is links[0]:  # whose parents are given: products would be with ones and zeros
            matrix.hi[..., child, parents], offset.hi[..., child] = own, shift
        else:
            matrix[..., child, :] = slope @ matrix[..., parents, :]
            offset[..., child] = (slope @ offset[..., parents][..., None])[..., 0] + shift
            columns[..., child, :] = slope @ columns[..., parents, :]
            cross = slope @ cov[..., parents, :]
            cov[..., child, :] = cross
            cov[..., :, child] = cross.T
            spread = cross[..., parents].times(slope) + spread
        cov[..., child, child] = spread
        for place in np.flatnonzero(open_):
            columns.hi[..., child.start + int(place), done] = 1.0
            done += 1
    rest = slice(front, None)
    return Move(
        matrix[..., rest, :], offset[..., rest], cov[..., rest, rest], columns[..., rest, :]
    )


def regular(noise: Array, flat: Mask) -> Twofold:
    """A noise covariance (..., d, d) in twice the digits, made exactly singular where it should be.

    That is where it is singular but for its rounding in float64: pivots of its elimination that are
    no more than this rounding become zero. The components that the mask `flat` (d,) marks, of
    infinite variance, get unit variance and no correlation.
    """
    if flat.any():
        noise = np.where(flat[:, None] | flat, np.eye(flat.size) * flat, noise)
    unit, pivots = extended.eliminated(noise, NEGLIGIBLE)
    if not (pivots.hi == 0.0).any():
        return Twofold(noise)
    return (unit * pivots[..., None, :]).times(unit)


def moving(plan: ChainPlan, step: int, mean: Array, cov: Array) -> Move:
    """The transition to a step, linearised at the belief over the slice before.

    The plan keeps the linearisation. `step` counts from the plan's first, which is 0. The belief
    has the moments `mean` (runs, n) and `cov` (runs, n, n). If entries of `cov` are infinite, a
    LinearisationError refuses nonlinear CPDs, except with `Taylor`, whose formula does not use the
    covariance.
    """
    if not all(link.family.exact for link in plan.transition):
        for link in plan.transition:
            proper(link.family, plan.first + step, cov)
        cov = np.where(np.isfinite(cov), cov, 0.0)
        MomentChain(plan, ONCE, check=True).predict(step, Moments.of(plan, mean, cov))
    return transition(plan, slice(step - 1, step)).at(0)


def proper(family: Family, step: int, cov: Array) -> Array:
    """The covariance at which a CPD is linearised, from `cov`, which may have infinite entries.

    `cov` is over the slice or the CPD's parents. It is returned as it is for a linear CPD, and if
    all entries are finite. For `Taylor`, whose formula does not use the covariance, infinite
    entries become zero. Any other lineariser is refused with a LinearisationError, whose text names
    the `step`.
    """
    improper = ~np.isfinite(cov)
    if family.exact or not improper.any():
        return cov
    if not family.taylor:
        raise LinearisationError(
            f"{family.cpd!r}: at step {step} the belief over its parents still has an infinite "
            f"variance, at which {family.lineariser!r} cannot linearise; use pgm.Taylor(), read a "
            "linear sensor before, or give the prior a finite variance",
            variable=family.cpd.child,
            cpd=family.cpd,
            step=step,
        )
    return np.where(improper, 0.0, cov)
