"""A network with its evidence: where it is first linearised, and anew at each belief."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from pgm.cpds import CPD
from pgm.errors import NumericalError
from pgm.evidence.static import BoundValues
from pgm.factors.scope import names
from pgm.inference.family import Family
from pgm.inference.gaussian.layout import Group, Layout
from pgm.kernels.angles import nearest_branch
from pgm.kernels.arrays import Array, Integers, Mask, apply, deviation, sandwich, transpose
from pgm.linearisers import Lineariser
from pgm.variables import Variable

# The unit of a variable is at least this share of its value: small parts of it are still digits.
SHARE = 1e-6


@dataclass(frozen=True, eq=False)
class Frame:
    """Coordinates ξ with x = mean + scale ξ, in which factors are kept: (runs, size) and (size,).

    About the prior predictive means, in its standard deviations, large coordinates cost no digits
    and units do not matter. Those `certain`, (size,), have no variance at all: ξ is zero.
    """

    mean: Array
    scale: Array
    certain: Mask


# The plan of the prior's moments; see `prior_predictive`.
Predictive = Callable[..., Frame]


def prior_predictive(
    layout: Layout, families: list[Family], runs: int, *, shared: bool, start: Array | None
) -> Frame:
    """Push moments through the CPDs in topological order, linearising on the way.

    Families are one a group. The joint covariance of just those variables is kept that later CPDs
    need. At a start, (runs, size), CPDs are linearised already; its NaN follow from the parents.
    """
    mean = np.empty((runs, layout.size)) if start is None else start.copy()
    variance = np.zeros((1 if shared else runs, layout.size))
    size = np.abs(mean).max(axis=0, initial=0.0) if start is not None else np.zeros(layout.size)
    frontier = _Frontier(variance.shape[0])
    left = Counter(int(place) for group in layout.groups for row in group.parents for place in row)
    last = 1 if shared else runs
    for g, row in layout.order:
        group, family = layout.groups[g], families[g]
        parents = group.parents[row]
        inside, across = frontier.covariance(parents)
        if start is None and not family.exact:
            wide = np.broadcast_to(inside, (runs, *inside.shape[1:]))
            family.linearise(row, mean[:, parents], wide)
        if not group.observed:
            child = group.child[row]
            matrix = family.matrix[row, :last]
            own = sandwich(matrix, inside) + family.noise[row, :last]
            if start is None or np.isnan(mean[0, child[0]]):
                at = mean[:, parents]
                mean[:, child] = apply(family.matrix[row], at) + family.offset[row]
                summands = apply(np.abs(family.matrix[row]), np.abs(at))
                size[child] = (summands + np.abs(family.offset[row])).max(axis=0)
            variance[:, child] = np.diagonal(own, axis1=-2, axis2=-1)
            if left[int(child[0])]:
                frontier.add(child, matrix @ across, own)
        left.subtract(parents.tolist())
        frontier.drop([int(place) for place in parents if not left[int(place)]])
    scale = np.sqrt(np.maximum(variance.max(axis=0, initial=0.0), 0.0))
    # No unit is smaller than the rounding of the numbers that a mean is the sum of.
    scale = np.maximum(scale, SHARE * size)
    certain = (variance == 0.0).all(axis=0) & (start is None)
    return Frame(mean, np.where(scale > 0.0, scale, 1.0), certain)


class _Frontier:
    """A joint covariance whose components come and go: places share slots in turn."""

    def __init__(self, stacked: int) -> None:
        self.cov = np.zeros((stacked, 8, 8))
        self.slots: dict[int, int] = {}
        self.free = list(range(8))

    def covariance(self, places: Integers) -> tuple[Array, Array]:
        rows = [self.slots[int(place)] for place in places]
        across = self.cov[:, rows]
        return across[:, :, rows], across

    def add(self, places: Integers, across: Array, own: Array) -> None:
        """Take in components, given their covariance with everything and their own."""
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
        rows = [self.slots.pop(place) for place in dict.fromkeys(places)]
        self.cov[:, rows, :] = 0.0
        self.cov[:, :, rows] = 0.0
        self.free.extend(rows)


Kind = TypeVar("Kind", np.float64, np.bool_)


@dataclass(eq=False)
class Model:
    """The CPDs of a network, linearised, and the evidence of its observed children.

    Lists are by group; a row is a CPD. `readings` are values of observed children, (CPDs, runs or
    1, d), `moved` the same with angles on the branch nearest the CPD's value where it was
    linearised, `taken` which components are not missing, None for all. `shared` says whether all
    runs have the same matrices, covariances and components observed. `points` are the means and
    deviations, (CPDs, runs, n), of hidden parents where CPDs were linearised last: if `first`, at
    the prior's moments or a start, which may be far from the posterior.
    """

    layout: Layout
    lead: tuple[int, ...]
    families: list[Family]
    readings: list[Array | None]
    moved: list[Array | None]
    taken: list[Mask | None]
    shared: bool
    frame: Frame
    points: list[tuple[Array, Array]]
    first: bool = True

    @classmethod
    def make(
        cls,
        layout: Layout,
        bound: BoundValues,
        lineariser: Lineariser,
        start: Array | None,
        predictive: Predictive = prior_predictive,
    ) -> Model:
        """Bind evidence, and linearise at the prior predictive moments or a start, (runs, size)."""
        for group in layout.groups:
            for cpd in group.cpds:
                cpd.require_proper("only chains, of pgm.DynamicBayesianNetwork, take flat priors")
        families = [_family(group, bound, lineariser) for group in layout.groups]
        readings = [
            _stacked([cpd.child for cpd in group.cpds], bound.values) if group.observed else None
            for group in layout.groups
        ]
        taken = [_taken(group, bound) for group in layout.groups]
        for family in families:
            family.probe({})
            family.confirm({})
        alike = all(mask is None or mask.shape[1] == 1 for mask in taken)
        shared = alike and all(
            family.exact and family.own_noise.shape[1] == 1 for family in families
        )
        if start is not None:
            for group, family in zip(layout.groups, families, strict=True):
                at = start[:, group.parents].swapaxes(0, 1)
                family.linearise(slice(None), at, np.zeros((*at.shape, at.shape[-1])))
        find = prior_predictive if start is not None else predictive
        frame = find(layout, families, bound.runs, shared=shared, start=start)
        spread = np.broadcast_to(frame.scale, frame.mean.shape)
        points = [
            (frame.mean[:, group.parents].swapaxes(0, 1), spread[:, group.parents].swapaxes(0, 1))
            for group in layout.groups
        ]
        moved = [
            None if rows is None else np.broadcast_to(rows, (len(rows), bound.runs, rows.shape[2]))
            for rows in readings
        ]
        model = cls(layout, bound.lead, families, readings, moved, taken, shared, frame, points)
        model._follow(frame.mean, np.ones(bound.runs, dtype=bool))
        return model

    @property
    def runs(self) -> int:
        """Number of runs."""
        return math.prod(self.lead)

    @property
    def exact(self) -> bool:
        """Whether every CPD is affine."""
        return all(family.exact for family in self.families)

    @property
    def taylor(self) -> bool:
        """Whether every CPD is affine or expanded to first order at a point."""
        return all(family.taylor for family in self.families)

    def relinearise(
        self,
        mean: Array,
        parents: Sequence[tuple[Array, Array] | None],
        active: Mask,
    ) -> None:
        """Linearise every nonlinear CPD at a belief, one call a group, for runs that are active.

        The mean is (runs, size), to whose branches angles of evidence move; parents' moments are
        (CPDs, runs, ...) for each group with nonlinear CPDs.
        """
        for g, (family, at) in enumerate(zip(self.families, parents, strict=True)):
            if at is not None:
                family.linearise(slice(None), *at, active)
                new = at[0], deviation(at[1])
                before, spread = self.points[g]
                one = active[:, None]
                self.points[g] = np.where(one, new[0], before), np.where(one, new[1], spread)
        self._follow(mean, active)
        self.first = False

    def _follow(self, mean: Array, active: Mask) -> None:
        groups = zip(self.layout.groups, self.families, self.readings, self.moved, strict=True)
        for k, (group, family, reading, kept) in enumerate(groups):
            angles = group.cpds[0].child.angle_mask
            if not angles.any():
                continue
            at = mean[:, group.parents].swapaxes(0, 1)
            if reading is not None and kept is not None:
                new = nearest_branch(reading, family.value(slice(None), at), angles)
                self.moved[k] = np.where(active[:, None], new, kept)
            elif not family.exact:
                before = family.offset.copy()
                family.to_chart(at, mean[:, group.child].swapaxes(0, 1))
                family.offset[:, ~active] = before[:, ~active]


def _family(group: Group, bound: BoundValues, lineariser: Lineariser) -> Family:
    first = group.cpds[0]
    inputs = {
        first.parents[k]: _stacked([cpd.parents[k] for cpd in group.cpds], bound.values)
        for k, parent in enumerate(first.parents)
        if parent in bound.values
    }
    step = np.array([cpd.child.step or 0 for cpd in group.cpds], dtype=np.intp)
    timed = first.child.step is not None
    return Family.make(first, group.hidden, step, inputs, lineariser, bound.lead, timed=timed)


def _taken(group: Group, bound: BoundValues) -> Mask | None:
    children = [cpd.child for cpd in group.cpds]
    if bound.taken.keys().isdisjoint(children):
        return None
    every = np.ones((1, group.height), dtype=bool)
    return _stacked(children, {v: bound.taken.get(v, every) for v in children})


def _stacked(
    variables: Sequence[Variable], rows: Mapping[Variable, npt.NDArray[Kind]]
) -> npt.NDArray[Kind]:
    values = [rows[v] for v in variables]
    runs = max(value.shape[0] for value in values)
    return np.stack([np.broadcast_to(value, (runs, value.shape[1])) for value in values])


def contradiction(model: Model, cluster: int, run: int) -> NumericalError:
    """Of measurements that an exact model excludes."""
    scope = model.layout.graph.clusters[cluster].scope
    which = f", run {run}" if model.lead else ""
    return NumericalError(
        f"evidence contradicts an exact model at cluster {cluster}, {names(scope)}{which}: "
        "CPDs without noise determine a value in two ways that differ; give one of them, or "
        "the prior, some noise",
        cluster=cluster,
    )


def indefinite_noise(cpd: CPD) -> NumericalError:
    """Of a noise that is none."""
    return NumericalError(
        f"the noise of {cpd!r} plus the lineariser's approximation error is indefinite; use a "
        "rule with positive weights, or more samples",
        variable=cpd.child,
        cpd=cpd,
    )
