"""The dense joint of components, made of linearised CPDs in decimals, with nothing rounded.

A child joins its parents, y = F p + b + n, with the covariance F P Fᵀ + Σ, and F P with all before.
One that is observed joins, is conditioned on component by component,

    G = P eₖ / s,   m ← m + G (z − mₖ),   P ← P − G eₖᵀ P,   s = eₖᵀ P eₖ,

and leaves again. A component with s = 0 is determined by what was read before: its measurement
agrees, or contradicts the model.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from decimal import Decimal
from typing import NamedTuple

import numpy as np

from pgm.cpds import AffineCPD
from pgm.inference.family import Family
from pgm.inference.gaussian.beliefs import runs_first
from pgm.inference.gaussian.layout import Group, Layout
from pgm.inference.gaussian.model import indefinite_noise
from pgm.kernels import decimals, roots
from pgm.kernels.arrays import LOG_2PI, Array, Integers, Mask, transpose, variances
from pgm.kernels.decimals import ONE, ZERO, Decimals

# What cancels to less than this share of its summands' deviations is rounding of F, which is known
# to half a unit in its last place: with no noise, y is determined.
ROUNDED = Decimal(2) ** -51


class Read(NamedTuple):
    """Conditioning on a component: ln p of its values and where they contradict the model, (V, N').

    `moved` (V,) is by how much the columns beyond N' together may move ln p.
    """

    log_density: Array
    contradiction: Mask
    moved: Array


@dataclass(eq=False)
class Joint:
    """The joint of components so far: V runs with a covariance each, or V = 1 for all runs.

    Columns of `mean` (V, size, N) go through everything as a mean does; `edge` (V, size) are the
    prior's deviations, all summands taken as positive; a number below the share `nothing` of a
    variance of such a deviation is rounding of the digits.
    """

    mean: Decimals
    cov: Decimals
    edge: Decimals
    nothing: Decimal

    @classmethod
    def empty(cls, stacked: int, size: int, columns: int, nothing: Decimal) -> Joint:
        """Without components yet: all of their rows are zero."""
        zeros = decimals.zeros
        return cls(
            zeros(stacked, size, columns),
            zeros(stacked, size, size),
            zeros(stacked, size),
            nothing,
        )

    def add(
        self,
        places: Integers,
        parents: Integers,
        matrix: Decimals,
        offset: Decimals,
        noise: Decimals,
    ) -> None:
        """A child with F (V, d, n), b (V, d, N) and noise (V, d, d)."""
        self.mean[:, places] = decimals.product(matrix, self.mean[:, parents]) + offset
        cross = decimals.product(matrix, self.cov[:, parents])
        own = decimals.product(cross[:, :, parents], transpose(matrix))
        size = np.abs(matrix)
        prior = decimals.product(size, self.edge[:, parents][..., None])[..., 0]
        deviation = decimals.sqrt(np.maximum(variances(self.cov), ZERO)[:, parents])
        now = decimals.product(size, deviation[..., None])[..., 0]
        variance = variances(noise)
        rounding = np.where(variance == ZERO, ROUNDED * ROUNDED * now * now, ZERO)
        least = np.maximum(rounding, self.nothing * prior * prior)
        nothing = np.asarray(variances(own) <= least, dtype=bool)
        cross[nothing] = ZERO
        own = np.where(nothing[..., :, None] | nothing[..., None, :], ZERO, own)
        self.cov[:, places] = cross
        self.cov[:, :, places] = transpose(cross)
        self.cov[:, places[:, None], places] = own + noise
        self.edge[:, places] = decimals.sqrt(prior * prior + variance)

    def read(self, place: int, value: Decimals, allowed: Decimals) -> Read:
        """Condition on a component's values (V, N'), of the first columns, allowed to be off."""
        count = value.shape[1]
        variance, edge = self.cov[:, place, place], self.edge[:, place]
        open_ = np.asarray(variance > self.nothing * edge * edge, dtype=bool)
        innovation = -self.mean[:, place]
        innovation[:, :count] += value
        left = innovation[:, :count]
        far = ~open_[:, None] & np.asarray(np.abs(left) > allowed, dtype=bool)
        divisor = np.where(open_, variance, ONE)[:, None]
        gain = np.where(open_[:, None], self.cov[:, :, place] / divisor, ZERO)
        self.mean = self.mean + gain[..., None] * innovation[:, None]
        cov = self.cov - gain[..., None] * self.cov[:, place][:, None]
        outer = self.edge[..., :, None] * self.edge[..., None, :]
        self.cov = np.where(np.abs(cov) <= self.nothing * outer, ZERO, cov)
        constant = np.array([decimals.log(s) for s in divisor[:, 0].tolist()]) + LOG_2PI
        density = -0.5 * (decimals.floats(left * left / divisor) + constant[:, None])
        deviation = decimals.sqrt(divisor)
        moved = decimals.total(np.abs(innovation[:, count:]))[:, None] / deviation
        lost = decimals.floats(moved * (1 + np.abs(left) / deviation))
        return Read(
            np.where(open_[:, None], density, 0.0),
            far,
            np.where(open_, lost.max(axis=-1, initial=0.0), 0.0),
        )

    def forget(self, places: Integers) -> None:
        """Leave out components, whose places are free again."""
        self.mean[:, places] = ZERO
        self.cov[:, places] = ZERO
        self.cov[:, :, places] = ZERO


@dataclass(frozen=True, eq=False)
class Conditional:
    """A CPD of a network: y = F p + b + n, in (V, d, n), (V, d, N) and (V, d, d)."""

    g: int
    group: Group
    row: int
    matrix: Decimals
    offset: Decimals
    noise: Decimals


@dataclass(eq=False)
class Conditionals:
    """The linearised CPDs of a network, in decimals."""

    layout: Layout
    families: list[Family]
    runs: int
    shared: bool
    _roots: dict[bytes, Root] = field(default_factory=dict)

    @property
    def stacked(self) -> int:
        """V, how many runs have matrices of their own."""
        return 1 if self.shared else self.runs

    def __iter__(self) -> Iterator[Conditional]:
        for g, row in self.layout.order:
            yield self.conditional(g, row)

    def conditional(self, g: int, row: int) -> Conditional:
        """One of them."""
        group, family = self.layout.groups[g], self.families[g]
        noise = family.noise[row, : self.stacked]
        return Conditional(
            g,
            group,
            row,
            decimals.exact(family.matrix[row, : self.stacked]),
            self.by_run(_offset(family, row, self.runs)),
            np.stack([self.root(one, family).matrix for one in noise]),
        )

    def by_run(self, values: Decimals) -> Decimals:
        """(runs, d) as (V, d, N)."""
        if self.shared:
            return np.asarray(values.T[None])
        return np.asarray(values[..., None])

    def by_float(self, values: Decimals) -> Array:
        """(V, ..., N) as (runs, ...), rounded."""
        return runs_first(decimals.floats(values))

    def root(self, noise: Array, family: Family) -> Root:
        """The factors of a noise."""
        key = noise.tobytes()
        if key not in self._roots:
            made = Root.of(decimals.exact(noise))
            if made is None:
                raise indefinite_noise(family.cpd)
            self._roots[key] = made
        return self._roots[key]

    def span(self) -> int:
        """Decades between the numbers that matter: deviations, and slopes."""
        edge = decimals.zeros(self.stacked, self.layout.size)
        least, most = Decimal(1), Decimal(1)
        slopes = [Decimal(1)]
        for conditional in self:
            size = np.abs(conditional.matrix)
            parents = conditional.group.parents[conditional.row]
            reach = decimals.product(size, edge[:, parents][..., None])[..., 0]
            variance = np.diagonal(conditional.noise, axis1=-2, axis2=-1)
            own = decimals.sqrt(reach * reach + variance)
            if not conditional.group.observed:
                edge[:, conditional.group.child[conditional.row]] = own
            found = [x for x in (*own.flat, *decimals.sqrt(variance).flat) if x]
            least, most = min([least, *found]), max([most, *found])
            slopes += [x for x in size.flat if x]
        decades = most.log10() - least.log10() + max(slopes).log10() - min(slopes).log10()
        return int(decades) + 1


def _offset(family: Family, row: int, runs: int) -> Decimals:
    """The offset b of one row, (runs, d), of an affine CPD not rounded."""
    cpd = family.cpd
    known = [p for p in cpd.given if p not in family.hidden]
    if not isinstance(cpd, AffineCPD) or not known:
        return decimals.exact(np.broadcast_to(family.offset[row], (runs, cpd.child.dimension)))
    total = decimals.exact(np.broadcast_to(cpd.offset, (runs, cpd.child.dimension)))
    for parent in known:
        values = decimals.exact(
            np.broadcast_to(family.inputs[parent][row], (runs, parent.dimension))
        )
        slope = decimals.exact(cpd.matrices[parent])
        total = total + decimals.product(slope, values[..., None])[..., 0]
    return total


@dataclass(frozen=True, eq=False)
class Root:
    """A covariance as L diag(d) Lᵀ, where L is unit lower triangular with its rows in an order."""

    lower: Decimals
    pivots: Decimals
    order: list[int]

    @classmethod
    def of(cls, noise: Decimals) -> Root | None:
        """Of a covariance, largest pivots first; None where it is indefinite."""
        size = len(noise)
        variance = np.diagonal(noise).copy()
        least = variance * Decimal(roots.NEGLIGIBLE)
        lower, pivots, left = decimals.zeros(size, size), decimals.zeros(size), noise.copy()
        waiting, order = list(range(size)), []
        for k in range(size):
            first = max(waiting, key=lambda i: left[i, i] / least[i] if least[i] else 0)
            waiting.remove(first)
            order.append(first)
            lower[first, k] = Decimal(1)
            pivot = left[first, first]
            if pivot < -variance[first] * Decimal(roots.INDEFINITE) or variance[first] < 0:
                return None
            if pivot > least[first]:
                pivots[k] = pivot
                lower[waiting, k] = left[waiting, first] / pivot
                left = left - lower[:, k, None] * left[first]
        return cls(lower, pivots, order)

    @property
    def matrix(self) -> Decimals:
        """The covariance, of which what was rounding is gone."""
        return decimals.product(self.lower * self.pivots, self.lower.T)

    def whitened(self, right: Decimals) -> Decimals:
        """L⁻¹ B, (d, m)."""
        left, found = right.copy(), decimals.zeros(*right.shape)
        for k, row in enumerate(self.order):
            found[k] = left[row]
            left = left - self.lower[:, k, None] * found[k]
        return found
