"""The linearised CPDs of a network in decimals, y = F p + b + v, with nothing rounded.

y is a CPD's child, (d,), p are its hidden parents, (n,), and v is Gaussian noise of covariance Q. V
is the number of matrices F that are kept of a CPD, and N the number of offsets b that go with each:
V = 1 and N = runs where all runs share their matrices, else V = runs and N = 1. A *group* is made
of copies of one CPD, as at the steps of an unrolled chain; a *row* is the index of a copy in its
group. The linearisations of a group's copies in float64 are the rows of a `Family`.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from decimal import Decimal

import numpy as np

from pgm.beliefs.gaussian.beliefs import runs_first
from pgm.beliefs.gaussian.layout import Group, Layout
from pgm.beliefs.gaussian.refusals import indefinite_noise
from pgm.cpds import AffineCPD, ConditionalGaussian
from pgm.kernels import decimals, roots
from pgm.kernels.arrays import Array
from pgm.kernels.decimals import Decimals
from pgm.linearisation.family import Family


@dataclass(frozen=True, eq=False)
class Conditional:
    """A linearised CPD: copy number `row` of `group`, which is group number `g` of the layout.

    `matrix` is F (V, d, n), `offset` b (V, d, N) and `noise` Q (V, d, d).
    """

    g: int
    group: Group
    row: int
    matrix: Decimals
    offset: Decimals
    noise: Decimals


@dataclass(eq=False)
class Conditionals:
    """The linearised CPDs of a network, in decimals; iteration gives parents before children.

    `families` has a `Family` for each group of the layout; `shared` says whether V is 1. `_roots`
    is the cache of `root`.
    """

    layout: Layout
    families: list[Family]
    runs: int
    shared: bool
    _roots: dict[bytes, Root] = field(default_factory=dict)

    @property
    def stacked(self) -> int:
        """The number V of runs that have matrices of their own; 1 where all share them."""
        return 1 if self.shared else self.runs

    def __iter__(self) -> Iterator[Conditional]:
        for g, row in self.layout.order:
            yield self.conditional(g, row)

    def conditional(self, g: int, row: int) -> Conditional:
        """The linearised CPD at one row of group g; a NumericalError if its noise is indefinite."""
        group, family = self.layout.groups[g], self.families[g]
        noise = family.noise[row, : self.stacked]
        return Conditional(
            g,
            group,
            row,
            decimals.exact(family.matrix[row, : self.stacked]),
            self.by_run(_offset(family, row, self.runs)),
            np.stack([self.root(one, family.cpd_at(row)).matrix for one in noise]),
        )

    def by_run(self, values: Decimals) -> Decimals:
        """Vectors (runs, d) as (V, d, N)."""
        if self.shared:
            return np.asarray(values.T[None])
        return np.asarray(values[..., None])

    def by_float(self, values: Decimals) -> Array:
        """Decimals (V, ..., N) rounded to float64, as (runs, ...)."""
        return runs_first(decimals.floats(values))

    def root(self, noise: Array, cpd: ConditionalGaussian) -> Root:
        """The factors L and D of a noise covariance L D Lᵀ, (d, d), in decimals, kept in a cache.

        If it is indefinite, that is a NumericalError, which names the CPD.
        """
        key = noise.tobytes()
        if key not in self._roots:
            made = Root.of(decimals.exact(noise))
            if made is None:
                raise indefinite_noise(cpd)
            self._roots[key] = made
        return self._roots[key]

    def span(self) -> int:
        """How many powers of ten the numbers of a solution may span, at least one.

        It is a sum of two: the powers of ten between the smallest and the largest standard
        deviation, of noises and of the prior, and those between the smallest and the largest slope
        |F_ij|. Both ranges include the number 1, and leave zeros out. The prior's standard
        deviations are upper bounds: the summands of F p count as positive, so that none cancel.
        """
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
    """The offset b of one copy of a CPD, row `row` of its family, (runs, d), in decimals.

    The offset of an affine CPD includes the terms F_k z_k of its observed parents z_k. In the
    family the sum of these terms is rounded to float64; here it is formed anew, without rounding.
    """
    cpd, own = family.cpd_at(row), family.parents_at(row)
    known = [p for p in family.cpd.given if p not in family.hidden]
    if not isinstance(cpd, AffineCPD) or not known:
        return decimals.exact(np.broadcast_to(family.offset[row], (runs, cpd.child.dimension)))
    total = decimals.exact(np.broadcast_to(cpd.offset, (runs, cpd.child.dimension)))
    for parent in known:
        values = decimals.exact(
            np.broadcast_to(family.inputs[parent][row], (runs, parent.dimension))
        )
        slope = decimals.exact(cpd.matrices[own[parent]])
        total = total + decimals.product(slope, values[..., None])[..., 0]
    return total


@dataclass(frozen=True, eq=False)
class Root:
    """A covariance (d, d) as L D Lᵀ: `lower` is L (d, d), and `pivots` (d,) the diagonal of D.

    Column k of L is of component order[k]. With its rows in this order L is unit lower triangular.
    """

    lower: Decimals
    pivots: Decimals
    order: list[int]

    @classmethod
    def of(cls, noise: Decimals) -> Root | None:
        """Factorise a covariance (d, d) with the largest pivots first; None if it is indefinite.

        A pivot is measured by its share of its component's variance: of at most 10⁻¹³ it counts as
        zero, and of less than −10⁻⁹ it makes the covariance indefinite.
        """
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
        """The covariance L D Lᵀ, (d, d): as it was given, but for pivots that counted as zero."""
        return decimals.product(self.lower * self.pivots, self.lower.T)

    def whitened(self, right: Decimals) -> Decimals:
        """The product L⁻¹ B, (d, m), for B = `right` (d, m); its row k is that of pivot k."""
        left, found = right.copy(), decimals.zeros(*right.shape)
        for k, row in enumerate(self.order):
            found[k] = left[row]
            left = left - self.lower[:, k, None] * found[k]
        return found
