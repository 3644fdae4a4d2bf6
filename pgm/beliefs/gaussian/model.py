"""A Gaussian network with its evidence, whose CPDs can be linearised again at each new belief.

A *group* is made of copies of one CPD, whose linearisations are the rows of a `Family`. A *place*
is the index of a component in the vector of all hidden components, (size,). A *frame* has the means
of all hidden components, and their standard deviations as units. In the shapes of a group's arrays
n counts the components of a CPD's hidden parents, d those of its child, and an axis `runs or 1` has
length 1 where all runs share the values. `bound` is the evidence by variable: values (runs or 1,
d), and masks of the components that were measured.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any, NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt

from pgm.beliefs.gaussian.layout import Group, Layout
from pgm.beliefs.gaussian.prior import Frame, Predictive, prior_predictive
from pgm.cpds import AffineCPD
from pgm.errors import LinearisationError
from pgm.evidence.static import BoundValues
from pgm.kernels.angles import nearest_branch
from pgm.kernels.arrays import Array, Mask, components_first, components_last, deviation
from pgm.kernels.gaussian import lengths
from pgm.linearisation.family import Family
from pgm.linearisation.weights import Weights
from pgm.linearisers import Lineariser
from pgm.tracing import Judge
from pgm.variables import Variable

Kind = TypeVar("Kind", np.float64, np.bool_)


class LinearisedAt(NamedTuple):
    """Moments of the hidden parents of a group's CPDs where these were linearised.

    Attributes
    ----------
    mean, std : ndarray
        Means and standard deviations, (CPDs, runs, n).
    lengths : ndarray
        The lengths over which a function may vary, of the same shape, by which `Taylor` takes
        differences: deviations, or less where components tell much of one another.
    """

    mean: Array
    std: Array
    lengths: Array

    @classmethod
    def prior(cls, frame: Frame, group: Group) -> LinearisedAt:
        """The frame's means of a group's hidden parents, with its units as standard deviations."""
        std = np.broadcast_to(frame.scale, frame.mean.shape)[:, group.parents].swapaxes(0, 1)
        return cls(frame.mean[:, group.parents].swapaxes(0, 1), std, std)

    @classmethod
    def belief(cls, mean: Array, cov: Array) -> LinearisedAt:
        """The moments of the beliefs in the hidden parents of each CPD, as points of linearisation.

        `mean` (CPDs, runs, n) and `cov` (CPDs, runs, n, n) are the beliefs' moments.
        """
        own = components_last(lengths(components_first(cov, 2)), 1)
        return cls(mean, deviation(cov), own)


@dataclass(eq=False)
class Model:
    """The CPDs of a network, linearised, and the evidence of its observed children.

    `lead` are the lengths of the user's axes of runs. The lists have an entry for each group:
    `families` the linearised CPDs; `readings` the measured values of the children, (CPDs, runs or
    1, d), None if the children are hidden; `moved` the same values, (CPDs, runs, d), with angles
    moved by whole turns to within π of the CPD's value where it was linearised, None as `readings`;
    `taken` a mask of the components that enter, (CPDs, runs or 1, d), None if all do: of an
    observed child those measured, of a prior those of finite variance; `points` the moments of
    hidden parents where CPDs were linearised last. `shared` says whether all runs have the same
    matrices, covariances and components measured. `frame` are the coordinates in which factors are
    kept. `weights` are those of a group's readings, None where its noise is Gaussian. `first` is
    True until `relinearise` is called: until then `points` are the prior's moments or the user's
    start, maybe far from the posterior. `noises` is a cache of roots of the CPDs' own noise, `rows`
    one of rows that hang on no linearisation.
    """

    layout: Layout
    lead: tuple[int, ...]
    families: list[Family]
    readings: list[Array | None]
    moved: list[Array | None]
    taken: list[Mask | None]
    shared: bool
    frame: Frame
    points: list[LinearisedAt]
    weights: list[Weights | None]
    first: bool = True
    noises: dict[Any, Any] = field(default_factory=dict, repr=False)
    rows: dict[Any, Any] = field(default_factory=dict, repr=False)

    @classmethod
    def make(
        cls,
        layout: Layout,
        bound: BoundValues,
        lineariser: Lineariser,
        start: Array | None,
        predictive: Predictive = prior_predictive,
        *,
        hidden_noise: bool = False,
        judge: Judge | None = None,
    ) -> Model:
        """The model with its evidence, linearised at the prior predictive moments or at a start.

        `start` has the means of all hidden components, (runs, size). If it is None, the function
        `predictive` finds the prior's moments, and linearises the CPDs on the way. A nonlinear
        function may be traced, that is, recorded as operations, to find its slopes. What a trace
        gives is compared with the function itself: by the `judge`, when the user's whole call is
        done; if it is None, at once. `hidden_noise` says that it will be integrated out, as
        `prior_predictive` asks. Without a start, sigma points below a flat
        prior, of infinite variance, are a LinearisationError.
        """
        families = [_family(group, bound, lineariser) for group in layout.groups]
        readings = [
            _stacked([cpd.child for cpd in group.cpds], bound.values) if group.observed else None
            for group in layout.groups
        ]
        taken = [
            _taken(group, bound, family)
            for group, family in zip(layout.groups, families, strict=True)
        ]
        for family in families:
            family.probe({})
            family.trace({}, judge)
        weights = weights_of(families, taken, bound.runs)
        alike = all(mask is None or mask.shape[1] == 1 for mask in taken)
        shared = alike and all(
            family.settled and family.own_noise.shape[1] == 1 for family in families
        )
        if start is None and any(not np.isfinite(family.own_noise).all() for family in families):
            for family in families:
                _require_points(family)
        if start is not None:
            for group, family in zip(layout.groups, families, strict=True):
                at = start[:, group.parents].swapaxes(0, 1)
                family.linearise(slice(None), at, np.zeros((*at.shape, at.shape[-1])))
        find = prior_predictive if start is not None else predictive
        if find is prior_predictive and hidden_noise:
            find = _without_hidden_noise
        made = partial(find, layout, families, bound.runs, shared=shared, start=start)
        # What hangs on no evidence is found once.
        constant = start is None and all(
            family is group.families.get(())
            for group, family in zip(layout.groups, families, strict=True)
            if not group.observed or not family.exact
        )
        frame = layout.derived(find, made, bound.runs) if constant else made()
        points = [LinearisedAt.prior(frame, group) for group in layout.groups]
        moved = [
            None if rows is None else np.broadcast_to(rows, (len(rows), bound.runs, rows.shape[2]))
            for rows in readings
        ]
        parts = readings, moved, taken, shared, frame, points, weights
        model = cls(layout, bound.lead, families, *parts)
        model._follow(frame.mean, np.ones(bound.runs, dtype=bool))
        return model

    @property
    def runs(self) -> int:
        """How many runs the evidence is of: 1 if the user gave no axes of runs."""
        return math.prod(self.lead)

    @property
    def flat(self) -> bool:
        """Whether a prior has an infinite variance."""
        return any(not np.isfinite(family.own_noise).all() for family in self.families)

    @property
    def exact(self) -> bool:
        """Whether every CPD is affine."""
        return all(family.exact for family in self.families)

    @property
    def settled(self) -> bool:
        """Whether every CPD is affine and its noise Gaussian: there is nothing to iterate."""
        return all(family.settled for family in self.families)

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
        """Linearise every nonlinear CPD at a belief, in the runs that `active` (runs,) marks.

        `parents` are the means (CPDs, runs, n) and covariances (CPDs, runs, n, n) of the hidden
        parents, for each group; None for affine CPDs. `mean` (runs, size) are the means of all
        components: readings of angles are moved by whole turns, to be nearest the CPDs' values
        there.
        """
        for g, (family, at) in enumerate(zip(self.families, parents, strict=True)):
            if at is not None:
                family.linearise(slice(None), *at, active)
                pairs = zip(LinearisedAt.belief(*at), self.points[g], strict=True)
                self.points[g] = LinearisedAt(
                    *(np.where(active[:, None], new, before) for new, before in pairs)
                )
        self._follow(mean, active)
        self.first = False

    def _follow(self, mean: Array, active: Mask) -> None:
        """Move angles by whole turns to the branch nearest the means (runs, size), in active runs.

        `active` (runs,) marks these runs. Readings of an observed child move to within π of its
        CPD's value at these means. If the child is hidden, the offset of its linearised CPD moves,
        so that this value is within π of the child's mean.
        """
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


_without_hidden_noise = partial(prior_predictive, hidden_noise=True)


def _family(group: Group, bound: BoundValues, lineariser: Lineariser) -> Family:
    """The CPDs of a group as one family, a row each, with the observed parents' values in `bound`.

    Nonlinear CPDs are not linearised yet. Affine ones of hidden parents alone are the same in all
    calls, and kept with the group.
    """
    first = group.cpds[0]
    plain = isinstance(first, AffineCPD) and first.noise is None
    constant = plain and len(group.hidden) == len(first.parents)
    if constant and bound.lead in group.families:
        return group.families[bound.lead]
    inputs = {
        first.parents[k]: _stacked([cpd.parents[k] for cpd in group.cpds], bound.values)
        for k, parent in enumerate(first.parents)
        if parent in bound.values
    }
    step = np.array([cpd.child.step or 0 for cpd in group.cpds], dtype=np.intp)
    timed = first.child.step is not None
    parts = first, group.hidden, step, inputs, lineariser, bound.lead
    made = Family.make(*parts, timed=timed, plate=group.cpds)
    if constant and not bound.lead:
        group.families[bound.lead] = made
    return made


def _taken(group: Group, bound: BoundValues, family: Family) -> Mask | None:
    """The mask of the components of a group's children that enter, (CPDs, runs or 1, d).

    They are those that were measured, or all of hidden children, but those of infinite variance.
    The result is None if all components of all children enter.
    """
    proper = np.isfinite(np.diagonal(family.own_noise, axis1=-2, axis2=-1))
    children = [cpd.child for cpd in group.cpds] if bound.taken else []
    if bound.taken.keys().isdisjoint(children):
        shape = len(group.cpds), *proper.shape[1:]
        return None if proper.all() else np.broadcast_to(proper, shape)
    every = np.ones((1, group.height), dtype=bool)
    return _stacked(children, {v: bound.taken.get(v, every) for v in children}) & proper


def _require_points(family: Family) -> None:
    """Refuse a rule that spreads points over what a flat prior leaves open."""
    if family.taylor or not family.hidden:
        return
    raise LinearisationError(
        f"{family.cpd!r} would be linearised by {family.lineariser!r} over a prior of infinite "
        "variance, which has no spread; give start= (means to begin at), lineariser=pgm.Taylor(), "
        "or the priors finite variances",
        variable=family.cpd.child,
        cpd=family.cpd,
    )


def weights_of(
    families: Sequence[Family], taken: Sequence[Mask | None], runs: int
) -> list[Weights | None]:
    """The weights of robust readings, one each, by group; None of groups with Gaussian noise.

    `taken` are the masks of measured components, as of `Model`. A ModelError refuses a robust noise
    of singular covariance.
    """
    return [
        None
        if family.cpd.noise is None
        else Weights.of(family.cpd, family.own_noise, mask, (family.step.size, runs))
        for family, mask in zip(families, taken, strict=True)
    ]


def _stacked(
    variables: Sequence[Variable], rows: Mapping[Variable, npt.NDArray[Kind]]
) -> npt.NDArray[Kind]:
    """The values of some variables of d components each, stacked, (variables, runs or 1, d).

    `rows` maps each of the variables to its values, (runs or 1, d).
    """
    values = [rows[v] for v in variables]
    runs = max(value.shape[0] for value in values)
    if all(value.shape[0] == runs for value in values):
        return np.array(values)
    return np.stack([np.broadcast_to(value, (runs, value.shape[1])) for value in values])
