"""Mixtures of Gaussians merged into fewer, and what is learnt of a merged Gaussian split again.

*Members* are the Gaussians of a mixture, and *components* those into which they are merged. The
first axis of arrays is that of members or components; the *batch* comes last where arrays have
their n components first, (n, members, *batch), as on the way forward, and second where these come
last, (members, *batch, n), as on the way back. `owner` (members, *batch) is the component that each
member belongs to, None where all are members of one. A member or component of log-weight −∞ is
*dead*: it stands for a hypothesis that is impossible, and its moments are any finite numbers.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pgm.kernels import roots
from pgm.kernels.arrays import (
    Array,
    Integers,
    Mask,
    apply,
    components_last,
    deviation,
    holds,
    inner,
    sandwich,
    symmetric,
    transpose,
    variances,
)
from pgm.kernels.semirings import log_sum, subtrahend
from pgm.kernels.step import nearest

# Covariances are widened by this share of the mixture's for the losses of merging, which invert
# them: a component may be certain.
_WIDENED = 1e-9


def normalised(logs: Array) -> tuple[Array, Array]:
    """Log-weights (members, *batch) of sum one, and the logarithm of the sum that they had."""
    total = log_sum(logs, 0)
    return logs - subtrahend(total), total


class Merged(NamedTuple):
    """Components, and their members as they were merged.

    logs: The log-weights of the components, (components, *batch).
    mean, cov: Their moments, (n, components, *batch) and (n, n, components, *batch).
    members: The means of the members, (n, members, *batch), their angles moved by whole turns to
        the branch of the component's likeliest member.
    """

    logs: Array
    mean: Array
    cov: Array
    members: Array


def merged(
    logs: Array, owner: Integers | None, count: int, mean: Array, cov: Array, angles: Integers
) -> Merged:
    r"""The Gaussians of the moments of each component's members.

    .. math:: \mu = \sum_a v_a \mu_a, \quad
              P = \sum_a v_a \big(P_a + (\mu_a - \mu)(\mu_a - \mu)^\top\big)

    `logs` (members, *batch) are log-weights, and v_a the weights within a component; `mean`
    (n, members, *batch) and `cov` (n, n, members, *batch), whose batch may be of length one;
    `angles` are the numbers of the n components that are angles. A dead component has the mean of
    the likeliest member of all, and a covariance no narrower.
    """
    if owner is None and len(logs) == 1 and mean.shape[1:] == logs.shape:
        return Merged(logs, mean, cov, mean)
    parts = logs[None] if owner is None else np.where(_own(owner, count), logs, -np.inf)
    top = np.maximum.reduce(parts, 1)
    if holds(top != -np.inf):
        shares = np.exp(parts - top[:, None])
        total = np.add.reduce(shares, 1)
        shares /= total[:, None]
        found = top + np.log(total)
    else:
        shares, found = _with_dead(parts, top, logs)
    if angles.size:
        best = shares.argmax(axis=1)
        mean = np.broadcast_to(mean, (len(mean), *logs.shape)).copy()
        middle = np.take_along_axis(mean[angles], best[None], axis=1)
        mean[angles] = nearest(mean[angles], _of_owner(middle, owner))
    centre = np.einsum("kh...,ih...->ik...", shares, mean)
    away = mean - _of_owner(centre, owner)
    spread = away[:, None] * away
    spread += cov
    # A weighted sum of symmetric matrices, whose entries (i, j) and (j, i) are the same sums.
    return Merged(found, centre, np.einsum("kh...,ijh...->ijk...", shares, spread), mean)


def _own(owner: Integers, count: int) -> Mask:
    """Whether a member is of a component, (components, members, *batch)."""
    found: Mask = owner == np.arange(count).reshape(count, *(1,) * owner.ndim)
    return found


def _of_owner(parts: Array, owner: Integers | None) -> Array:
    """The entries of each member's component, (..., members, *batch), by those of components."""
    return parts if owner is None else np.take_along_axis(parts, owner[None], axis=1)


def _with_dead(parts: Array, top: Array, logs: Array) -> tuple[Array, Array]:
    """The weights of members within components, some of which are dead, and the components' logs.

    `parts` (components, members, *batch) are the log-weights of each component's own members, and
    `top` the largest; a dead one is given the likeliest of all members, of log-weights `logs`.
    """
    some = top > -np.inf
    shares = np.exp(parts - np.where(some, top, 0.0)[:, None])
    total = shares.sum(axis=1)
    with np.errstate(divide="ignore"):
        found = top + np.log(total)
    alone = logs.argmax(axis=0) == np.arange(len(logs)).reshape(-1, *(1,) * (logs.ndim - 1))
    return np.where(some[:, None], shares / np.where(some, total, 1.0)[:, None], alone), found


def seeded(
    logs: Array,
    kind: Integers,
    mean: Array,
    cov: Array,
    count: int,
    apart: float,
    angles: Integers,
) -> tuple[Integers, Integers]:
    """The component of each member, (members, *batch), and the kind of each, (count, *batch).

    Members of a component are of one kind, of which there are no more than `count`; `kind`
    (members, *batch) numbers them. Where no more members than `count` are alive, each is a
    component. Elsewhere components begin with a seed: the likeliest member of each kind, then the
    likeliest whose KL divergence from all seeds is more than `apart`; and every other member joins
    the seed of its kind from which its divergence is least. `logs`, `mean` and `cov` are as of
    `merged`.

    Source: after Salmond (1990), who joins members to seeds by a distance of means.
    """
    members = len(logs)
    alive = logs > -np.inf
    many = alive.sum(axis=0) > count
    order = np.argsort(-logs, axis=0, kind="stable")
    if not many.any():
        owner = np.empty_like(order)
        places = np.minimum(np.arange(members), count - 1).reshape(-1, *(1,) * (logs.ndim - 1))
        np.put_along_axis(owner, order, np.broadcast_to(places, order.shape), axis=0)
        first = order[np.minimum(np.arange(count), members - 1)]
        return owner, np.take_along_axis(kind, first, axis=0)
    loss = _losses(logs, mean, cov, angles)  # (*batch, seed, member)
    same, weights = np.moveaxis(kind, 0, -1), np.moveaxis(logs, 0, -1)
    loss[same[..., :, None] != same[..., None, :]] = np.inf
    free, limit = weights.copy(), np.where(many, apart, -np.inf)[..., None]
    due = weights.copy()  # of kinds that have no seed yet
    seeds = np.empty((*logs.shape[1:], count), dtype=np.intp)
    taken = np.empty(seeds.shape, dtype=bool)
    for place in range(count):
        unlike = (due > -np.inf).any(axis=-1, keepdims=True)
        candidates = np.where(unlike, due, free)
        seed = candidates.argmax(axis=-1)[..., None]
        seeds[..., place] = seed[..., 0]
        found = np.take_along_axis(candidates, seed, axis=-1) > -np.inf
        taken[..., place] = found[..., 0]
        near = np.take_along_axis(loss, seed[..., None], axis=-2)[..., 0, :] <= limit
        free[near & found] = -np.inf
        np.put_along_axis(free, seed, -np.inf, axis=-1)
        due[same == np.take_along_axis(same, seed, axis=-1)] = -np.inf
    chosen = np.take_along_axis(loss, seeds[..., None], axis=-2)
    chosen[~taken] = np.inf
    owner = np.moveaxis(chosen.argmin(axis=-2), -1, 0)
    own = np.where(
        taken, np.arange(count), np.take_along_axis(np.moveaxis(owner, 0, -1), seeds, -1)
    )
    np.put_along_axis(owner, np.moveaxis(seeds, -1, 0), np.moveaxis(own, -1, 0), axis=0)
    return owner, np.moveaxis(np.take_along_axis(same, seeds, axis=-1), -1, 0)


def _losses(logs: Array, mean: Array, cov: Array, angles: Integers) -> Array:
    """The KL divergences of each member from each as a seed, (*batch, seeds, members).

    KL(N_h ‖ N_s) = ½ (tr S_s⁻¹ (P_h + (m_h − m_s)(m_h − m_s)ᵀ) − n + ln |S_s| − ln |P_h|)

    Components are scaled by the mixture's deviations, and covariances widened by a share of that
    and of their own, as a belief may be certain of some.
    """
    if angles.size:
        best = logs.argmax(axis=0)[None, None]
        mean = mean.copy()
        mean[angles] = nearest(mean[angles], np.take_along_axis(mean[angles], best, axis=1))
    whole = merged(logs, None, 1, mean, cov, angles[:0])
    centre, spread = whole.mean, np.sqrt(np.einsum("ii...->i...", whole.cov))
    unit = np.where(spread > 0.0, spread, 1.0)
    m = np.moveaxis(components_last((mean - centre) / unit, 1), 0, -2)  # (*batch, members, n)
    size = m.shape[-1]
    p = np.moveaxis(components_last(cov / unit / unit[:, None], 2), 0, -3)
    p = p + _WIDENED * (1.0 + variances(p))[..., None] * np.eye(size)
    values, vectors = np.linalg.eigh(p)
    values = np.maximum(values, _WIDENED * values[..., -1:])
    information = symmetric(vectors / values[..., None, :] @ transpose(vectors))
    volume = np.log(values).sum(axis=-1)
    pull = apply(information, m)
    flat = (*m.shape[:-1], size * size)
    second = (p + m[..., :, None] * m[..., None, :]).reshape(flat)
    # All pairs as one product, with what depends on the seed, or on the member, alone beside it.
    found = information.reshape(flat) @ transpose(second)
    found -= 2.0 * pull @ transpose(m)
    found += (inner(pull, m) + volume - size)[..., :, None]
    found -= volume[..., None, :]
    return 0.5 * found


def joined(shares: Array, mean: Array, cov: Array) -> tuple[Array, Array]:
    """The moments of Gaussians that are mixtures of copies each, with their copies' shares.

    `shares` (members, copies, *batch) are of sum one for each Gaussian; `mean` is
    (members, copies, *batch, n) and `cov` (members, copies, *batch, n, n).
    """
    whole = np.einsum("kc...,kc...i->k...i", shares, mean)
    away = mean - whole[:, None]
    inside = np.einsum("kc...,kc...ij->k...ij", shares, cov)
    between = np.einsum("kc...,kc...i,kc...j->k...ij", shares, away, away)
    return whole, symmetric(inside + between)


class Split(NamedTuple):
    """The smoothed belief of components, divided among their members.

    logs: The log-weights of the members given all evidence, within their component.
    mean, cov: Their smoothed moments, (members, *batch, n) and (members, *batch, n, n).
    """

    logs: Array
    mean: Array
    cov: Array


def split(
    later: tuple[Array, Array],
    known: tuple[Array, Array],
    owner: Integers,
    logs: Array,
    members: tuple[Array, Array],
) -> Split:
    r"""Smoothed beliefs of merged Gaussians as such of their members.

    Of a component N(a, V) the smoothed belief is N(b, W). Their ratio is what later evidence says,
    and is multiplied into each member: the product is the member's smoothed belief, and its
    integral a factor of the member's weight. In coordinates y in which N(a, V) is N(0, I), along
    the principal axes u of W, with the variances w and the means μ, the ratio is

    .. math:: \prod_u N(y_u; \mu, w) / N(y_u; 0, 1),

    and is taken in axis by axis, in these coordinates: of a member N(m, P), with m and p its mean
    and variance along u and D = p (1 − w) + w,

    .. math:: m \mathrel{+}= P u \, (\mu - m (1 - w)) / D, \quad
              P \mathrel{-}= P u u^\top P \, (1 - w) / D, \\
              \ln \int = -\tfrac12 \ln D + (\mu^2 (p - 1) + 2 \mu m - m^2 (1 - w)) / (2 D).

    Nothing is divided by but D, so that evidence may make a component certain, w = 0, or say
    nothing of it, w = 1.

    The component may come back wider, w > 1, as what comes later may have several modes. Means and
    weights are then those of w = 1, whose ratio is exp(μ y − μ² / 2): by the densities' ratio, a
    member far from the component's mean would soon outweigh all others. The covariance grows by

    .. math:: P \mathrel{+}= P u u^\top P \, (w - 1) / D,

    so that a member with the component's own moments takes its belief. A member that is wider than
    the component, p > 1, for which D may be zero, is moved, weighed and widened as far as the
    component is: P u and p are then divided by p. A component's only member takes its belief as
    it is.

    `later` are b (components, *batch, n) and W, `known` a and V; `owner`, `logs` (members, *batch)
    and `members`, m and P, are of the members, their angles on the component's branch.
    """
    mean, cov = known
    out, into = _whitening(cov)
    spread, axes, middle = _principal(into, later[0] - mean, later[1])
    batch: tuple[Integers, ...] = np.indices(owner.shape[1:], sparse=True)
    at = (owner, *(axis[None] for axis in batch))
    alive = _own(owner, len(mean)) & (logs > -np.inf)
    alone = alive.sum(axis=1) <= 1
    if alone.all():
        return Split(within(logs, owner, len(mean)), later[0][at], later[1][at])
    turned = (transpose(axes) @ into)[at]
    m = apply(turned, members[0] - mean[at])
    p = symmetric(sandwich(turned, members[1]))
    gained, m, p = _multiplied(spread[at], middle[at], m, p)
    back = (out @ axes)[at]
    found = mean[at] + apply(back, m), symmetric(sandwich(back, p))
    only = alone[at]
    smoothed = [
        np.where(only.reshape(*only.shape, *(1,) * (part.ndim - only.ndim)), kept[at], part)
        for part, kept in zip(found, later, strict=True)
    ]
    return Split(within(logs + np.where(only, 0.0, gained), owner, len(known[0])), *smoothed)


class Ratio(NamedTuple):
    """The ratio of a Gaussian given more evidence, N(b, W), to what it was, N(a, V).

    It is what the evidence says, and a product of ratios along axes u, with the variances w and the
    means μ of N(b, W) in coordinates in which N(a, V) is N(0, I); see `split`. Directions in which
    V is but rounding are left as they are.

    centre: a, (..., n).
    axes: The axes u as rows, (..., n, n).
    spread, middle: The w and the μ, (..., n) both.
    """

    centre: Array
    axes: Array
    spread: Array
    middle: Array

    @classmethod
    def of(cls, later: tuple[Array, Array], known: tuple[Array, Array]) -> Ratio:
        """The ratio by the moments of both, (..., n) and (..., n, n)."""
        _, into = _whitening(known[1])
        spread, axes, middle = _principal(into, later[0] - known[0], later[1])
        return cls(known[0], transpose(axes) @ into, spread, middle)

    def at(self, index: tuple[Integers, ...]) -> Ratio:
        """The ratios at an index of the leading axes."""
        return Ratio(*(part[index] for part in self))

    def taken(self, mean: Array, cov: Array) -> tuple[Array, Array]:
        """The moments of Gaussians (..., n) and (..., n, n) that the ratio is multiplied into."""
        away = mean - self.centre
        _, moved, left = _multiplied(self.spread, self.middle, away, cov, self.axes)
        return moved + self.centre, left


def _multiplied(
    spread: Array, middle: Array, mean: Array, cov: Array, axes: Array | None = None
) -> tuple[Array, Array, Array]:
    """Gaussians with ratios multiplied into them, axis by axis, as of `split`.

    And first the logarithms of the products' integrals (...). `mean` (..., n) counts from the mean
    that the ratios began with; `axes` are those along which they are taken, as rows (..., n, n),
    or those of the coordinates.
    """
    size = mean.shape[-1]
    gained = np.zeros(mean.shape[:-1])
    for k in range(size):
        if axes is None:
            row = np.eye(size)[k]
            column, variance, place = cov[..., :, k], cov[..., k, k], mean[..., k]
        else:
            row = axes[..., k, :]
            column, place = apply(cov, row), inner(row, mean)
            variance = np.maximum(inner(row, column), 0.0)
        whole, mu = spread[..., k], middle[..., k]
        w, excess = np.minimum(whole, 1.0), np.maximum(whole - 1.0, 0.0)
        # Where the component came back wider, a member goes no further than it did.
        reach = np.where(whole < 1.0, 1.0, np.maximum(variance, 1.0))
        column, variance = column / reach[..., None], variance / reach
        scale = variance * (1.0 - w) + w
        scale = np.where(scale > 0.0, scale, 1.0)
        off = mu - place * (1.0 - w)
        gained -= 0.5 * np.log(scale)
        gained += (mu * mu * (variance - 1.0) + 2.0 * mu * place - place * place * (1.0 - w)) / (
            2.0 * scale
        )
        gain = column * ((1.0 - w) / scale)[..., None]
        mean = mean + column * (off / scale)[..., None]
        keep = np.eye(size) - gain[..., :, None] * row[..., None, :]
        noise = (1.0 - w) * w / scale**2 + excess / (1.0 + excess * (1.0 - variance))
        cov = sandwich(keep, cov)
        cov = cov + noise[..., None, None] * column[..., :, None] * column[..., None, :]
        cov = symmetric(cov)
    return gained, mean, cov


def within(logs: Array, owner: Integers, count: int) -> Array:
    """Log-weights of members, of sum one within each of so many components."""
    sums = log_sum(np.where(_own(owner, count), logs, -np.inf), 1)
    found: Array = logs - np.take_along_axis(subtrahend(sums), owner, axis=0)
    return found


def _whitening(cov: Array) -> tuple[Array, Array]:
    """The L and L⁺ with L Lᵀ = P for covariances P (..., n, n), by the axes of correlations.

    Directions in which P is but rounding are left out: L and L⁺ are zero there.
    """
    unit = deviation(cov)
    unit = np.where(unit > 0.0, unit, 1.0)
    values, vectors = np.linalg.eigh(cov / unit[..., :, None] / unit[..., None, :])
    some = values > roots.NEGLIGIBLE * values[..., -1:]
    length = np.sqrt(np.where(some, values, 1.0))
    out = unit[..., :, None] * vectors * np.where(some, length, 0.0)[..., None, :]
    into = transpose(vectors * np.where(some, 1.0 / length, 0.0)[..., None, :]) / unit[..., None, :]
    return out, into


def _principal(into: Array, shift: Array, cov: Array) -> tuple[Array, Array, Array]:
    """The variances, axes and means of N(shift, cov) in whitened coordinates.

    By singular values of L⁺ times a root of the covariance: they keep twice the digits of variances
    that are far smaller than one.
    """
    root, _ = _whitening(cov)
    axes, lengths, _ = np.linalg.svd(into @ root)
    return lengths * lengths, axes, apply(transpose(axes), apply(into, shift))
