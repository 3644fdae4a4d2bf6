"""The prior predictive moments: where a network is first linearised, and units of its variables.

The *place* of a component is its index in the vector of all hidden components, (size,). A *group*
is made of copies of one CPD, whose linearisations are the rows of a `Family`. V is the number of
covariances: 1 if all runs share them, else the number of runs.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from pgm.beliefs.gaussian.layout import Layout
from pgm.kernels import moments
from pgm.kernels.arrays import Array, Integers, Mask, apply, transpose
from pgm.linearisation.family import Family

# Components from which on units are those of the CPDs' own noise, and of hidden noise variables.
LARGE = 1000
# The unit of a variable is at least this share of its value: small parts of it are still digits.
SHARE = 1e-6


@dataclass(frozen=True, eq=False)
class Frame:
    """The coordinates ξ in which factors are kept: x = mean + scale ξ, with x (size,).

    x is the vector of all hidden components. `mean` (runs, size) are the prior's predictive means,
    or the means of a start. `scale` (size,) are the prior's predictive standard deviations, the
    largest of all runs, with a floor where they are tiny; a flat prior counts as one of variance 1.
    So neither the user's units nor large coordinates cost digits. The mask `certain` (size,) marks
    components without variance in the
    prior, in all runs: their ξ is zero. With a start none is marked. `by_noise` says that units
    are of hidden noise, in which rounding cannot be told from relations without noise.
    """

    mean: Array
    scale: Array
    certain: Mask
    by_noise: bool = False


# A function with the signature of `prior_predictive`.
Predictive = Callable[..., Frame]


def prior_predictive(
    layout: Layout,
    families: list[Family],
    runs: int,
    *,
    shared: bool,
    start: Array | None,
    hidden_noise: bool = False,
) -> Frame:
    """The frame of the prior predictive moments, pushed through the CPDs, parents before children.

    `families` has a `Family` for each group of CPDs; `shared` says whether all runs have the same
    covariances, which are then computed once. Without a `start` nonlinear CPDs are linearised here,
    at the moments of their parents. With a start, (runs, size), they have to be linearised already,
    and the start is the frame's mean; where it is NaN the mean follows from the parents. In large
    networks the scale is that of the CPDs' own noise where all have some, or, if `hidden_noise`
    will be integrated out, that of their noise variables. The scale of a component is at least a
    millionth of the numbers that its mean is a sum of.
    """
    mean = np.empty((runs, layout.size)) if start is None else start.copy()
    variance = np.zeros((1 if shared else runs, layout.size))
    size = np.abs(mean).max(axis=0, initial=0.0) if start is not None else np.zeros(layout.size)
    last = 1 if shared else runs
    # Units need not be the prior's, which cost most in large networks, where CPDs have some noise.
    own, by_noise = None, False
    linear = start is not None or all(family.exact for family in families)
    if linear and layout.size > LARGE:
        own, by_noise = _own_variances(layout, families, last)
    if by_noise and not hidden_noise:
        own, by_noise = None, False
    own_units = own is not None
    frontier = _Frontier(0 if own_units else variance.shape[0])
    # What was measured has no moments of its own, and asks for its parents' to be linearised alone.
    asking = [
        not group.observed or (start is None and not family.exact)
        for group, family in zip(layout.groups, families, strict=True)
    ]
    left = Counter(
        place
        for group, asks in zip(layout.groups, asking, strict=True)
        if asks
        for place in group.parents.ravel().tolist()
    )
    # Priors need no moments of others; those that nobody asks for are told all at once.
    alone = [
        group.parents.shape[1] == 0 and not group.observed and family.exact
        for group, family in zip(layout.groups, families, strict=True)
    ]
    for group, family, free in zip(layout.groups, families, alone, strict=True):
        if free:
            noise = np.diagonal(family.noise[:, :last], axis1=-2, axis2=-1).swapaxes(0, 1)
            variance[:, group.child] = np.where(np.isinf(noise), 1.0, noise)
            offset, given = family.offset.swapaxes(0, 1), mean[:, group.child]
            value = offset if start is None else np.where(np.isnan(given), offset, given)
            mean[:, group.child] = value
            size[group.child] = np.abs(value).max(axis=0, initial=0.0)
    rest = any(asks and not free for asks, free in zip(asking, alone, strict=True))
    for g, row in layout.order if rest else ():
        if not asking[g] or (alone[g] and not left[int(layout.groups[g].child[row, 0])]):
            continue
        group, family = layout.groups[g], families[g]
        parents = group.parents[row]
        if not own_units:
            inside, across = frontier.covariance(parents)
        if start is None and not family.exact:
            wide = np.broadcast_to(inside, (runs, *inside.shape[1:]))
            family.linearise(row, mean[:, parents], wide)
        if not group.observed:
            child = group.child[row]
            matrix = family.matrix[row, :last]
            noise = family.noise[row, :last]
            if own is None:
                noise = moments.predict(inside, matrix, np.where(np.isinf(noise), 1.0, noise))
                variance[:, child] = np.diagonal(noise, axis1=-2, axis2=-1)
            else:
                variance[:, child] = own[g][row]
            if start is None or np.isnan(mean[0, child[0]]):
                at = mean[:, parents]
                mean[:, child] = apply(family.matrix[row], at) + family.offset[row]
                summands = apply(np.abs(family.matrix[row]), np.abs(at))
                size[child] = (summands + np.abs(family.offset[row])).max(axis=0)
            if left[int(child[0])] and not own_units:
                frontier.add(child, matrix @ across, noise)
        if own_units:
            continue
        left.subtract(parents.tolist())
        frontier.drop([int(place) for place in parents if not left[int(place)]])
    scale = np.sqrt(np.maximum(variance.max(axis=0, initial=0.0), 0.0))
    # No unit is smaller than the rounding of the numbers that a mean is the sum of.
    scale = np.maximum(scale, SHARE * size)
    certain = (variance == 0.0).all(axis=0) & (start is None)
    return Frame(mean, np.where(scale > 0.0, scale, 1.0), certain, by_noise)


def _own_variances(
    layout: Layout, families: list[Family], last: int
) -> tuple[list[Array] | None, bool]:
    """The variances (CPDs, V, d) of each group's children by their CPDs' own noise.

    Where that is zero it is the noise that parents make which have no other child, and no hidden
    parents themselves.
    The second result tells whether it is so anywhere. The first is None where some hidden component
    has neither; CPDs have to be linearised.
    """
    found, groups = [], layout.groups
    parents = np.concatenate([group.parents.ravel() for group in groups])
    shared = np.bincount(parents, minlength=layout.size) > 1
    above = np.zeros((last, layout.size))
    for group, family in zip(groups, families, strict=True):
        own = np.diagonal(family.noise[:, :last], axis1=-2, axis2=-1)
        found.append(np.where(np.isinf(own), 1.0, own))
        if not group.observed and not group.parents.shape[1]:
            above[:, group.child] = found[-1].swapaxes(0, 1)
    above[:, shared] = 0.0
    by_noise = False
    for g, (group, family) in enumerate(zip(groups, families, strict=True)):
        if group.observed or (found[g] > 0.0).all():
            continue
        by_noise = True
        made = above[:, group.parents].swapaxes(0, 1)
        found[g] = np.where(found[g] > 0.0, found[g], apply(family.matrix[:, :last] ** 2, made))
        if not (found[g] > 0.0).all():
            return None, False
    return found, by_noise


class _Frontier:
    """The joint covariance of the components that later CPDs need.

    `cov` is (V, slots, slots), V being the argument `stacked`. A component in use has a slot, its
    row and column of `cov`: `slots` maps its place to it, and `free` lists the slots without a
    component.
    """

    def __init__(self, stacked: int) -> None:
        self.cov = np.zeros((stacked, 8, 8))
        self.slots: dict[int, int] = {}
        self.free = list(range(8))

    def covariance(self, places: Integers) -> tuple[Array, Array]:
        """The covariance of the components at `places` (m,), and their covariance with all slots.

        The two are (V, m, m) and (V, m, slots).
        """
        rows = [self.slots[int(place)] for place in places]
        across = self.cov[:, rows]
        return across[:, :, rows], across

    def add(self, places: Integers, across: Array, own: Array) -> None:
        """Give slots to the new components at `places` (d,).

        `own` (V, d, d) is their covariance, and `across` (V, d, slots) their covariance with the
        components in all slots so far.
        """
        while len(self.free) < len(places):
            size = self.cov.shape[-1]
            self.free.extend(range(size, 2 * size))
            self.cov = np.pad(self.cov, [(0, 0), (0, size), (0, size)])
            across = np.pad(across, [(0, 0), (0, 0), (0, size)])
        rows = [self.free.pop() for _ in places]
        self.slots.update(zip((int(place) for place in places), rows, strict=True))
        self.cov[:, rows, :] = across
        self.cov[:, :, rows] = transpose(across)
        self.cov[:, np.array(rows)[:, None], rows] = own

    def drop(self, places: list[int]) -> None:
        """Forget components that no later CPD needs; their slots become free."""
        rows = [self.slots.pop(place) for place in dict.fromkeys(places)]
        self.cov[:, rows, :] = 0.0
        self.cov[:, :, rows] = 0.0
        self.free.extend(rows)
