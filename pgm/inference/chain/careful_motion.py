"""The prior and the transitions of a chain in twice the digits."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pgm.errors import LinearisationError
from pgm.inference.chain.careful_update import ROUNDING, Belief, cancelled, rounded, through
from pgm.inference.chain.certificate import is_flat
from pgm.inference.chain.likelihoods import distinct
from pgm.inference.chain.moments import MomentChain
from pgm.inference.chain.plan import ChainPlan, Link
from pgm.inference.chain.readings import Moments
from pgm.inference.family import Family
from pgm.inference.schedule import ONCE
from pgm.kernels import twofold
from pgm.kernels.arrays import Array, Mask, quiet
from pgm.kernels.roots import NEGLIGIBLE
from pgm.kernels.twofold import Twofold


class Move(NamedTuple):
    """An affine conditional A x + b + n: (..., n, n), (..., n) and the covariance (..., n, n).

    `columns` are how it depends on δ, (..., n, q): not at all, but for a prior.
    """

    matrix: Twofold
    offset: Twofold
    cov: Twofold
    columns: Twofold

    def at(self, row: int) -> Move:
        """One row of many."""
        return Move(*(part[row] for part in self))


def prior_mean(plan: ChainPlan) -> Array:
    """The means of the states at step 0, (runs, n); those of flat components are as declared."""
    states = plan.layout.state_places
    if not is_flat(plan):
        return MomentChain(plan, ONCE).start().by_run[0][:, states]
    return start(plan, linearise=True).columns.hi[:, states, 0]


def start(plan: ChainPlan, *, linearise: bool) -> Belief:
    """The slice at step 0 before its readings; there are no controls."""
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
    first = _conditional(plan.prior, slice(None), 0, plan.layout.state_size, plan.runs).at(0)
    size, states = plan.layout.slice_size, plan.layout.state_places
    columns = Twofold.zeros((plan.runs, size, 1 + first.columns.shape[-1]))
    columns[:, states, 0] = first.offset
    columns[:, states, 1:] = first.columns
    cov = Twofold.zeros((plan.runs, size, size))
    where = np.arange(size)[states]
    for whole, part in ((cov.hi, first.cov.hi), (cov.lo, first.cov.lo)):
        whole[:, where[:, None], where] = part
    eye = np.eye(size)
    drift = (ROUNDING * columns.hi[..., 0]) ** 2
    rounding = rounded(eye, cov.hi, np.zeros_like(cov.hi))
    return Belief(columns, cov, rounding, drift[..., None] * eye)


def transition(plan: ChainPlan, rows: slice) -> Move:
    """The slices of some steps given the slices before them, whose controls play no part."""
    layout = plan.layout
    found = _conditional(plan.transition, rows, layout.state_size, layout.slice_size, plan.runs)
    matrix = Twofold.zeros((*found.matrix.shape[:-1], layout.slice_size))
    matrix[..., layout.state_places] = found.matrix
    return found._replace(matrix=matrix)


def _conditional(links: list[Link], rows: slice, front: int, size: int, runs: int) -> Move:
    """The links' children given the first `front` components of the vector that all stand in."""
    families = [link.family for link in links]
    parts = [[distinct(part[rows]) for part in (f.matrix, f.offset, f.noise)] for f in families]
    flat = [_flat(noise) for *_, noise in parts]
    lead = np.broadcast_shapes(*(part.shape[:2] for each in parts for part in each))
    whole, q = front + size, int(sum(each.sum() for each in flat))
    matrix = Twofold.zeros((*lead, whole, front))
    matrix.hi[..., :front, :] = np.eye(front)
    offset, cov = Twofold.zeros((*lead, whole)), Twofold.zeros((*lead, whole, whole))
    columns = Twofold.zeros((*lead, whole, q))
    done = 0
    for link, (own, shift, noise), open_ in zip(links, parts, flat, strict=True):
        child, parents, slope = link.child, link.parents, Twofold(own)
        matrix[..., child, :] = slope @ matrix[..., parents, :]
        offset[..., child] = (slope @ offset[..., parents][..., None])[..., 0] + shift
        columns[..., child, :] = slope @ columns[..., parents, :]
        for place in np.flatnonzero(open_):
            columns.hi[..., child.start + int(place), done] = 1.0
            done += 1
        cross = slope @ cov[..., parents, :]
        cov[..., child, :] = cross
        cov[..., :, child] = cross.mT
        cov[..., child, child] = cross[..., parents] @ slope.mT + _regular(noise, open_)
    rest = slice(front, None)
    return Move(
        matrix[..., rest, :], offset[..., rest], cov[..., rest, rest], columns[..., rest, :]
    )


def _flat(noise: Array) -> Mask:
    """The components of infinite variance, (d,)."""
    found: Mask = np.isinf(np.einsum("...ii->...i", noise)).any(axis=(0, 1))
    return found


def _regular(noise: Array, flat: Mask) -> Twofold:
    """A noise of exactly the rank it was meant to have; of unit variance where it is infinite."""
    if flat.any():
        noise = np.where(flat[:, None] | flat, np.eye(flat.size) * flat, noise)
    unit, pivots = twofold.eliminated(noise, NEGLIGIBLE)
    if not (pivots.hi == 0.0).any():
        return Twofold(noise)
    return unit * pivots[..., None, :] @ unit.mT


@quiet()
def predict(belief: Belief, move: Move) -> Belief:
    """The belief over the next slice, before its readings."""
    summed = np.abs(move.matrix.hi) @ np.abs(belief.columns.hi)
    columns = cancelled(move.matrix @ belief.columns, summed)
    columns[..., 0] = columns[..., 0] + move.offset
    cov = move.matrix @ belief.cov @ move.matrix.mT + move.cov
    rounding = through(move.matrix.hi, belief.rounding)
    rounding = rounding + rounded(move.matrix.hi, belief.cov.hi, move.cov.hi)
    own = ROUNDING * (summed[..., 0] + np.abs(move.offset.hi))
    drift = through(move.matrix.hi, belief.drift) + own[..., None] ** 2 * np.eye(own.shape[-1])
    return Belief(columns, cov, rounding, drift).certain()


def moving(plan: ChainPlan, step: int, mean: Array, cov: Array) -> Move:
    """The transition to a step, linearised at the belief before it."""
    if not all(link.family.exact for link in plan.transition):
        for link in plan.transition:
            cov = proper(link.family, step, cov)
        MomentChain(plan, ONCE, check=True).predict(step, Moments.of(plan, mean, cov))
    return transition(plan, slice(step - 1, step)).at(0)


def proper(family: Family, step: int, cov: Array) -> Array:
    """A covariance to linearise at; Taylor's formula, which does not look at it, needs none."""
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
