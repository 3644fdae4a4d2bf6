"""Mixtures of Gaussians merged into fewer, and messages to a merged Gaussian split again.

*Members* are the Gaussians of a mixture, and *components* those into which they are merged. The
first axis of arrays is that of members or components; the *batch* comes last where arrays have
their n components first, (n, members, *batch), as on the way forward, and second where these come
last, (members, *batch, n), as on the way back. `owner` (members, *batch) is the component that each
member belongs to. A member or component of log-weight −∞ is *dead*: it stands for a hypothesis that
is impossible, and its moments are any finite numbers.
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
    inner,
    sandwich,
    symmetric,
    transpose,
)
from pgm.kernels.semirings import log_sum
from pgm.kernels.solving import regression
from pgm.kernels.step import nearest

# Covariances are widened by this share of the mixture's for the losses of merging, which invert
# them: a component may be certain.
_WIDENED = 1e-9
# The share of its information that a ratio of densities may leave a member: one that widens a
# variance more than twice is far from where the ratio was found, and may carry it away altogether.
_LEAST = 0.5


def normalised(logs: Array) -> tuple[Array, Array]:
    """Log-weights (members, *batch) of sum one, and the logarithm of the sum that they had."""
    total = log_sum(logs, 0)
    return logs - np.where(total > -np.inf, total, 0.0), total


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
    logs: Array, owner: Integers, count: int, mean: Array, cov: Array, angles: Integers
) -> Merged:
    r"""The Gaussians of the moments of each component's members.

    .. math:: \mu = \sum_a v_a \mu_a, \quad
              P = \sum_a v_a \big(P_a + (\mu_a - \mu)(\mu_a - \mu)^\top\big)

    `logs` (members, *batch) are log-weights, and v_a the weights within a component; `mean`
    (n, members, *batch) and `cov` (n, n, members, *batch); `angles` are the numbers of the n
    components that are angles. Of a dead component the moments are those of the likeliest member
    of all.
    """
    own = owner == np.arange(count).reshape(count, *(1,) * owner.ndim)
    parts = np.where(own, logs, -np.inf)
    best = parts.argmax(axis=1)
    top = parts.max(axis=1)
    some = top > -np.inf
    if not some.all():
        best = np.where(some, best, logs.argmax(axis=0))
    shares = np.exp(parts - np.where(some, top, 0.0)[:, None])
    total = shares.sum(axis=1)
    with np.errstate(divide="ignore"):
        found = top + np.log(total)
    if some.all():
        shares = shares / total[:, None]
    else:
        alone = best[:, None] == np.arange(len(logs)).reshape(-1, *(1,) * (logs.ndim - 1))
        shares = np.where(some[:, None], shares / np.where(some, total, 1.0)[:, None], alone)
    if angles.size:
        mean = mean.copy()
        middle = np.take_along_axis(mean[angles], best[None], axis=1)
        at = np.take_along_axis(middle, owner[None], axis=1)
        mean[angles] = nearest(mean[angles], at)
    centre = np.einsum("kh...,ih...->ik...", shares, mean)
    away = mean - np.take_along_axis(centre, owner[None], axis=1)
    spread = cov + away[:, None] * away[None]
    whole = np.einsum("kh...,ijh...->ijk...", shares, spread)
    return Merged(found, centre, 0.5 * (whole + whole.swapaxes(0, 1)), mean)


def seeded(
    logs: Array,
    kind: Integers,
    kinds: int,
    mean: Array,
    cov: Array,
    count: int,
    apart: float,
    angles: Integers,
) -> tuple[Integers, Integers]:
    """The component of each member, (members, *batch), and the kind of each, (count, *batch).

    Members of a component are of one kind; `kind` (members, *batch) numbers them, and `count` is
    at least the number of `kinds`. Where no more members than `count` are alive, each is a
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
    same = np.moveaxis(kind, 0, -1)
    loss[same[..., :, None] != same[..., None, :]] = np.inf
    weights = np.moveaxis(np.exp(logs), 0, -1)
    free, limit = weights.copy(), np.where(many, apart, 0.0)[..., None]
    seeds = np.empty((*logs.shape[1:], count), dtype=np.intp)
    taken = np.empty(seeds.shape, dtype=bool)
    for place in range(count):
        candidates = np.where(same == place, free, 0.0) if place < kinds else free
        seed = candidates.argmax(axis=-1)[..., None]
        seeds[..., place] = seed[..., 0]
        taken[..., place] = np.take_along_axis(candidates, seed, axis=-1)[..., 0] > 0.0
        near = np.take_along_axis(loss, seed[..., None], axis=-2)[..., 0, :] <= limit
        free[near & taken[..., place][..., None]] = 0.0
        np.put_along_axis(free, seed, 0.0, axis=-1)
    chosen = np.take_along_axis(loss, seeds[..., None], axis=-2)
    chosen[~taken] = np.inf
    owner = np.moveaxis(chosen.argmin(axis=-2), -1, 0)
    return owner, np.moveaxis(np.take_along_axis(same, seeds, axis=-1), -1, 0)


def _losses(logs: Array, mean: Array, cov: Array, angles: Integers) -> Array:
    """The KL divergences of each member from each as a seed, (*batch, seeds, members).

    KL(N_h ‖ N_s) = ½ (tr S_s⁻¹ (P_h + (m_h − m_s)(m_h − m_s)ᵀ) − n + ln |S_s| − ln |P_h|)

    Components are scaled by the mixture's deviations, and covariances widened a little, as a
    belief may be certain of some.
    """
    if angles.size:
        best = logs.argmax(axis=0)[None, None]
        mean = mean.copy()
        mean[angles] = nearest(mean[angles], np.take_along_axis(mean[angles], best, axis=1))
    every = np.zeros(logs.shape, dtype=np.intp)
    whole = merged(logs, every, 1, mean, cov, angles[:0])
    centre, spread = whole.mean, np.sqrt(np.einsum("ii...->i...", whole.cov))
    unit = np.where(spread > 0.0, spread, 1.0)
    m = np.moveaxis(components_last((mean - centre) / unit, 1), 0, -2)  # (*batch, members, n)
    size = m.shape[-1]
    p = np.moveaxis(components_last(cov / unit / unit[:, None], 2), 0, -3)
    p = p + _WIDENED * np.eye(size)
    lower = roots.root(p)
    inverse = np.asarray(np.linalg.inv(lower), dtype=np.float64)
    information = symmetric(transpose(inverse) @ inverse)
    volume = 2.0 * np.log(np.diagonal(lower, axis1=-2, axis2=-1)).sum(axis=-1)
    pull = apply(information, m)
    flat = (*m.shape[:-1], size * size)
    second = (p + m[..., :, None] * m[..., None, :]).reshape(flat)
    # All pairs as one product, with what depends on the seed, or on the member, alone beside it.
    found = information.reshape(flat) @ transpose(second)
    found -= 2.0 * pull @ transpose(m)
    found += (inner(pull, m) + volume - size)[..., :, None]
    found -= volume[..., None, :]
    return 0.5 * found


class Message(NamedTuple):
    """What later evidence says of Gaussians, in the form of Bryson and Frazier.

    Of N(m, P) it makes the mean m + P λ and the covariance P − P Λ P. `vector` is λ,
    (members, *batch, n), and `matrix` Λ, (members, *batch, n, n).

    Source: Bierman, Factorization Methods for Discrete Sequential Estimation (1977), chapter X.
    """

    vector: Array
    matrix: Array

    def before(self, matrix: Array, vector: Array, information: Array) -> Message:
        """The message to a prediction, from that to what it is once measurements are taken in.

        These change the mean m and covariance P of the prediction to m + P u and P − P U P, by
        `vector`, u, and `information`, U; `matrix` is I − P U.
        """
        turned = transpose(matrix)
        return Message(
            apply(turned, self.vector) + vector,
            symmetric(sandwich(turned, self.matrix) + information),
        )

    def through(self, matrix: Array) -> Message:
        """The message to what a prediction F x + b is made of; `matrix` is F."""
        turned = transpose(matrix)
        return Message(apply(turned, self.vector), symmetric(sandwich(turned, self.matrix)))

    def of(self, mean: Array, cov: Array) -> tuple[Array, Array]:
        """The moments of the Gaussians given what the message says."""
        return mean + apply(cov, self.vector), symmetric(cov - sandwich(cov, self.matrix))


def joined(shares: Array, message: Message) -> Message:
    """The message to Gaussians, of one to each of several copies of them.

    `shares` (members, copies, *batch) are the probabilities of the copies given all evidence, of
    sum one for each Gaussian, and the message's arrays have an axis of copies likewise. The mixture
    of the copies' moments is then that of the message.
    """
    vector = np.einsum("kc...,kc...i->k...i", shares, message.vector)
    away = message.vector - vector[:, None]
    inside = np.einsum("kc...,kc...ij->k...ij", shares, message.matrix)
    spread = np.einsum("kc...,kc...i,kc...j->k...ij", shares, away, away)
    return Message(vector, symmetric(inside - spread))


class Split(NamedTuple):
    """A message to components, as messages to their members.

    logs: The log-weights of the members given all evidence, within their component.
    message: To each member.
    divided: Whether it is the component's smoothed belief over its filtered one, multiplied into
        the member; where that is no density, each member takes the component's smoothed moments.
    """

    logs: Array
    message: Message
    divided: Mask


def split(
    message: Message,
    mean: Array,
    cov: Array,
    owner: Integers,
    logs: Array,
    members: tuple[Array, Array],
) -> Split:
    r"""A message to merged Gaussians as messages to their members.

    The component N(a, V) has the message λ, Λ, which is the ratio of its smoothed to its filtered
    density, a Gaussian function of the information K and the pull κ at a,

    .. math:: K = (I - \Lambda V)^{-1} \Lambda, \quad \kappa = (I - \Lambda V)^{-1} \lambda.

    A member N(m, P) times the ratio has, with δ = a − m,

    .. math:: \Lambda_m = K (I + P K)^{-1}, \quad \lambda_m = (I + K P)^{-1} (\kappa + K \delta),

    and its weight is multiplied by the ratio's mean under it. Where I + P K has an eigenvalue below
    one half for some member, each member of the component takes its smoothed moments, as Kim (1994)
    has it, and keeps its weight: below zero the ratio has no mean.

    `mean` (components, *batch, n) and `cov` are a and V; `owner`, `logs` (members, *batch) and
    `members`, m and P, are of the members, their angles on the component's branch.
    """
    ratio, pull = _ratio(message, cov)
    batch: tuple[Integers, ...] = np.indices(owner.shape[1:], sparse=True)
    at = (owner, *(axis[None] for axis in batch))
    k, kappa, a = ratio[at], pull[at], mean[at]
    m, p = members
    lower = roots.root(p)
    inside = symmetric(np.eye(m.shape[-1]) + transpose(lower) @ k @ lower)
    values, vectors = np.linalg.eigh(inside)
    own = owner == np.arange(len(mean)).reshape(-1, *(1,) * owner.ndim)
    alive = own & (logs > -np.inf)
    proper = (values[..., 0] > _LEAST) | ~(logs > -np.inf)
    whole = (proper | ~alive).all(axis=1)
    alone = alive.sum(axis=1) <= 1
    values = np.maximum(values, _LEAST)
    delta = a - m
    gradient = kappa + apply(k, delta)
    # With M = I + LᵀKL, P = L Lᵀ: K (I + P K)⁻¹ = K − K L M⁻¹ Lᵀ K, and so on.
    turned = transpose(vectors) @ transpose(lower)
    seen = turned @ k
    matrix = symmetric(k - transpose(seen) @ (seen / values[..., None]))
    pulled = apply(turned, gradient)
    vector = gradient - apply(transpose(seen), pulled / values)
    gained = 0.5 * (
        (pulled * pulled / values).sum(axis=-1)
        - np.log(values).sum(axis=-1)
        - inner(delta, apply(k, delta))
    ) - inner(kappa, delta)
    found = Message(vector, matrix)
    plain = (alone | ~whole)[at]
    if plain.any():
        kept = Message(message.vector[at], message.matrix[at])
        if not whole.all():
            kept = _where(whole[at], kept, _of_moments(kept, a, cov[at], m, p))
        found = _where(~plain, found, kept)
        gained = np.where(plain, 0.0, gained)
    total = logs + gained
    sums = log_sum(np.where(own, total[None], -np.inf), 1)
    return Split(total - np.where(sums > -np.inf, sums, 0.0)[at], found, whole | alone)


def _ratio(message: Message, cov: Array) -> tuple[Array, Array]:
    """The information K and pull κ of smoothed over filtered densities; see `split`."""
    lower = roots.root(cov)
    seen = transpose(lower) @ message.matrix
    left = symmetric(np.eye(cov.shape[-1]) - seen @ lower)
    values, vectors = np.linalg.eigh(left)
    values = np.maximum(values, np.finfo(float).eps)
    seen = transpose(vectors) @ seen
    pulled = apply(transpose(vectors), apply(transpose(lower), message.vector))
    information = message.matrix + transpose(seen) @ (seen / values[..., None])
    return symmetric(information), message.vector + apply(transpose(seen), pulled / values)


def _of_moments(message: Message, mean: Array, cov: Array, m: Array, p: Array) -> Message:
    """The messages that give members N(m, P) the smoothed moments of their component N(a, V)."""
    after, left = message.of(mean, cov)
    inverse = regression(np.broadcast_to(np.eye(p.shape[-1]), p.shape), p)
    return Message(apply(inverse, after - m), symmetric(inverse - inverse @ left @ inverse))


def _where(mask: Mask, one: Message, other: Message) -> Message:
    return Message(
        np.where(mask[..., None], one.vector, other.vector),
        np.where(mask[..., None, None], one.matrix, other.matrix),
    )
