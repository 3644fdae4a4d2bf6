"""The log-density of each CPD at draws, a term of the log-weights of an audit, or of modes.

Arrays are of S draws for each run. The child of a CPD is f(parents) + L s, with white noise s and
the lower triangular root L of the CPD's noise covariance. A child component is *free* where the
diagonal of L is not zero; any other component follows from the parents and from s of the free ones.
A draw is *lost* if f is NaN or infinite at it. A *relative* density is that of the CPD divided by
that of the linearised CPD, whose mean is affine, F x + b, in the parents x. Values of an angle on
different *branches* differ by whole turns.

A CPD has *rows*: the steps of a transition, the measurements of a sensor, or, in a network without
time, the CPD's copies. d is the number of the child's components, n that of the hidden parents'. In
an array (..., S, d) the leading axes are (runs,) if an argument `row` or `rows` is a number, and
(k, runs) if it is a slice of k rows.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple, TypeVar

import numpy as np

from pgm.beliefs.moments.steps.plan import Link
from pgm.beliefs.moments.trajectories.student import log_ratio, stretch
from pgm.cpds import RobustNoise
from pgm.errors import LinearisationError, NumericalError, PgmError
from pgm.factors.scope import names
from pgm.kernels import normal_density, roots, solving
from pgm.kernels.angles import difference, nearest_branch
from pgm.kernels.arrays import LOG_2PI, Array, Integers, Mask, independent, inner, transpose
from pgm.linearisation.family import Family

Stack = TypeVar("Stack", Array, Mask)


class Afresh(NamedTuple):
    """The draws at which CPDs draw their children anew, instead of taking the proposed ones.

    where: The mask of these draws, (runs, S).
    rng: The generator of the CPDs' noise.
    """

    where: Mask
    rng: np.random.Generator


class Drawn(NamedTuple):
    """The children of draws by one CPD, with their log-densities.

    values: The children, (..., S, d).
    log_density: The CPD's log-density, (..., S); a relative one if the `Term` is relative.
    log_tails: The log-density, never relative, with Student's t in place of the CPD's Gaussian
        noise, (..., S).
    lost: The mask of draws at which f is not finite, (..., S).
    """

    values: Array
    log_density: Array
    log_tails: Array
    lost: Mask


class Peak(NamedTuple):
    """The log-density at residuals of zero, and the number of components that have noise, (runs,).

    Of draws of the posterior, with Gaussian noise, twice as much as their log-density is below is
    χ² with so many degrees of freedom, if the measurements are of the model.
    """

    log_density: Array
    size: Integers

    @classmethod
    def of(cls, runs: int, parts: Iterable[Peak]) -> Peak:
        """The peak of a product."""
        total, size = np.zeros(runs), np.zeros(runs, dtype=np.intp)
        for part in parts:
            total, size = total + part.log_density, size + part.size
        return cls(total, size)


@dataclass(frozen=True, eq=False)
class Term:
    """The density of a CPD at draws of its parents and child.

    family: The CPD at its rows, with the values of its observed parents and its linearisation.
    own: The root L of the CPD's noise, (rows or 1, runs or 1, d, d).
    relative: Whether densities are divided by those of the linearised CPD.
    near: Whether all draws are near the linearisation, so that an angle has its branch. Draws of
        several modes are not: then a child's angle is drawn on the branch of the function's own
        value, and residuals of angles that are read are wrapped.
    linearised: The root of the linearised CPD's noise, (rows, runs, d, d). None if densities are
        not relative, and for an affine CPD, whose relative density is one.
    taken: The mask of the components of a sensor's readings that were measured, or of a prior those
        of finite variance, (rows, runs or 1, d); None if all are. The other components are given
        unit variance, and count for nothing.
    """

    family: Family
    own: Array
    relative: bool
    near: bool = True
    linearised: Array | None = None
    taken: Mask | None = None

    @classmethod
    def make(
        cls, family: Family, *, relative: bool, near: bool = True, taken: Mask | None = None
    ) -> Term:
        """The density of the CPD `family`; the arguments are the fields of the class.

        A NumericalError is raised if densities are relative and the CPD has robust noise, or is
        nonlinear with singular noise.
        """
        own, noise = family.own_noise, family.noise
        if taken is not None:
            own, noise = independent(own, taken), independent(noise, taken)
        own = roots.root(own)
        if relative and family.cpd.noise is not None:
            cpd = family.cpd
            raise NumericalError(
                f"{cpd!r} has robust noise, {cpd.noise!r}, which is not audited beside a sensor "
                "without noise or a covariance too near to singular; give the exact sensor, or the "
                "motion, some noise",
                variable=cpd.child,
                cpd=cpd,
            )
        if not relative or family.exact:
            return cls(family, own, relative, near, taken=taken)
        linearised = roots.root(noise)
        pivots = np.diagonal(linearised, axis1=-2, axis2=-1)
        bad = np.isnan(pivots) | (pivots == 0.0) | roots.determined(own)
        if bad.any():
            cpd = family.cpd_at(_first(bad))
            raise NumericalError(
                f"{cpd!r} is nonlinear and its noise is singular or that of its linearisation is "
                "no covariance, beside a sensor without noise or a covariance too near to "
                "singular: a Gaussian draw then misses where the model lives; give the CPD noise "
                "in all components, or the exact sensor some",
                variable=cpd.child,
                cpd=cpd,
            )
        return cls(family, own, relative, near, linearised, taken)

    def free(self) -> Mask:
        """The mask of child components that have noise, (rows or 1, runs or 1, d)."""
        return ~roots.determined(self.own)

    @cached_property
    def _all_free(self) -> bool:
        return bool(self.free().all())

    @cached_property
    def _turns(self) -> bool:
        return bool(self.family.cpd.child.angle_mask.any())

    def child(
        self,
        row: int,
        parents: Array,
        proposed: Array,
        afresh: Afresh | None = None,
        *,
        strict: bool = True,
    ) -> Drawn:
        """The children, with their log-densities, of draws of the parents (runs, S, n) at one row.

        Free components are taken from `proposed`, (runs, S, d). The other components follow from
        the parents and the noise that the free ones imply.

        afresh: Marks draws at which the free components are drawn from the CPD instead, with
            Student's t for its noise; None marks none.
        strict: Whether a lost draw raises a LinearisationError.
        """
        value, lost = self._value(row, parents, on_chart=self.near, strict=strict)
        return self._weighed(row, parents, value, lost, self._made(row, value, proposed, afresh))

    def made(self, row: int, parents: Array, proposed: Array, afresh: Afresh | None) -> Array:
        """The children of draws at one row, as of `child`, (runs, S, d), without densities.

        The CPD's function is called only where the children depend on it.
        """
        turning = not (self.near or self.family.exact) and self._turns
        if self._all_free and not turning and (afresh is None or not afresh.where.any()):
            return proposed
        value, _ = self._value(row, parents, on_chart=self.near, strict=False)
        return self._made(row, value, proposed, afresh)

    def weighed(self, rows: slice, parents: Array, child: Array, *, strict: bool = True) -> Drawn:
        """The log-densities of children, as of `child`, of draws at k rows, (k, runs, S)."""
        value, lost = self._value(rows, parents, on_chart=self.near, strict=strict)
        return self._weighed(rows, parents, value, lost, child)

    def _made(self, row: int, value: Array, proposed: Array, afresh: Afresh | None) -> Array:
        """The children of draws whose function values are `value`, both (runs, S, d)."""
        if not (self.near or self.family.exact):
            proposed = nearest_branch(proposed, value, self.family.cpd.child.angle_mask)
        if afresh is not None:
            proposed = self._redrawn(value, _at(self.own, row), proposed, afresh)
        if self._all_free:
            return proposed
        white = self._white(row, self._read(row, proposed - value))
        implied = value + white @ transpose(_at(self.own, row))
        return np.where(_at(self.free(), row)[..., None, :], proposed, implied)

    def _weighed(
        self, rows: int | slice, parents: Array, value: Array, lost: Mask, child: Array
    ) -> Drawn:
        """The log-densities of children, beside the values (..., S, d) of the function."""
        own = _at(self.own, rows)
        # A component of infinite variance has the density (2π)^(−1/2) wherever it is.
        white = self._white(rows, self._read(rows, child - value))
        log_density = normal_density.log_density(own, white)
        size = (~roots.determined(own)).sum(axis=-1)[..., None]
        return Drawn(
            child,
            self._relative(rows, parents, child, log_density),
            log_density + log_ratio(size, inner(white, white)),
            lost,
        )

    def sampled(self, row: int, parents: Array, white: Array) -> Array:
        """The children f(parents) + L s (runs, S, d) of parents (runs, S, n), at one row.

        The white noise s, `white` (S, d), is the same in all runs. Where f is not finite, the mean
        of the linearised CPD stands for it.
        """
        value, _ = self._value(row, parents, on_chart=True, strict=False)
        child: Array = value + white @ transpose(_at(self.own, row))
        return child

    def _redrawn(self, value: Array, own: Array, proposed: Array, afresh: Afresh) -> Array:
        """The `proposed` children (runs, S, d), replaced by f(parents) + L s where `afresh` marks.

        s is noise of Student's t. `value` is f(parents), (runs, S, d), and `own` the root L,
        (runs or 1, d, d).
        """
        places = afresh.where
        white: Array = np.zeros(proposed.shape)
        white[places] = afresh.rng.standard_normal((int(places.sum()), self.family.shape[2]))
        stretch(white, places, afresh.rng)
        return np.where(places[..., None], value + white @ transpose(own), proposed)

    def readings(
        self, rows: slice, parents: Array, values: Array, moved: Array, *, strict: bool = True
    ) -> Array:
        """The log-density of a sensor's k measurements in `rows`, summed, (runs, S).

        parents: The draws of the parents, (k, runs, S, n).
        values: The measurements, (k, runs or 1, d).
        moved: The measurements with angles on the branch of the linearised mean, (k, runs, d), at
            which the densities of affine and of linearised CPDs are taken.
        strict: Whether a lost draw raises a LinearisationError; otherwise its log-density is NaN.
        """
        if self.relative and self.family.exact:
            return np.zeros(parents.shape[1:3])
        value, lost = self._value(rows, parents, strict=strict)
        reading = moved if self.family.exact else values
        angles = self.family.cpd.child.angle_mask & (not (self.family.exact and self.near))
        residual = self._read(rows, difference(reading[..., None, :], value, angles))
        log_density = self._of_reading(rows, residual)
        if self.family.cpd.noise is None:
            log_density = self._relative(rows, parents, moved[..., None, :], log_density)
        log_density = np.where(lost, np.nan, log_density) if lost.any() else log_density
        total: Array = log_density.sum(axis=0)
        return total

    def peak(self, rows: slice) -> Peak:
        """The peak of the CPD's density in rows; for a sensor's that of its readings."""
        count = rows.stop - rows.start
        log_density = self._of_reading(rows, np.zeros((count, 1, 1, self.family.shape[2])))
        size = (_at(self.free(), rows) & self._entering(rows)).sum(axis=-1)
        size = np.broadcast_to(size, (count, size.shape[1]))
        return Peak(log_density[..., 0].sum(axis=0), size.sum(axis=0))

    def _of_reading(self, rows: slice, residual: Array) -> Array:
        """The log-density (..., S) of residuals (..., S, d) of readings."""
        if self.family.cpd.noise is not None:
            return self._robust(self.family.cpd.noise, rows, residual)
        log_density = normal_density.log_density(_at(self.own, rows), self._white(rows, residual))
        if self.taken is not None and not self.relative:
            # One of infinite variance has the density (2π)^(−1/2), as beliefs of networks have it.
            proper: Mask = np.isfinite(np.diagonal(self.family.own_noise, axis1=-2, axis2=-1))
            missing = (_at(proper, rows) & ~self.taken[rows]).sum(axis=-1)
            log_density = log_density + 0.5 * LOG_2PI * missing[..., None]
        return log_density

    def _robust(self, noise: RobustNoise, rows: slice, residual: Array) -> Array:
        """The log-density (..., S) of residuals (..., S, d) under robust noise.

        Improper noise, whose density has no finite integral, is given the Gaussian's constant,
        −½ ln |2π R|, R being the covariance of the noise.
        """
        count: Integers = np.asarray(self.family.shape[2])
        if self.taken is not None:
            count = self.taken[rows].sum(axis=-1)[..., None]
        white = self._white(rows, residual)
        found: Array = noise.log_scale(count) - noise.loss(inner(white, white), count)
        return found - 0.5 * solving.log_determinant(_at(self.own, rows))[..., None]

    def _white(self, rows: int | slice, residual: Array) -> Array:
        """The white noise s, (..., S, d), with L s = `residual`; zero where not free."""
        if self._inverse is None:
            return normal_density.whitened(_at(self.own, rows), residual)[0]
        white: Array = residual @ transpose(_at(self._inverse, rows))
        return white

    @cached_property
    def _inverse(self) -> Array | None:
        """L⁻¹ of all rows, (rows or 1, runs or 1, d, d); None where some component is not free."""
        return normal_density.whitener(self.own)

    def _read(self, rows: int | slice, residual: Array) -> Array:
        """The residuals (..., S, d), set to zero in components that do not enter."""
        return residual if self.taken is None else np.where(self._seen(rows), residual, 0.0)

    def _entering(self, rows: int | slice) -> Mask | np.bool_:
        """The mask of the components that enter in `rows`, (..., d); True if all do."""
        return np.True_ if self.taken is None else self.taken[rows]

    def _seen(self, rows: int | slice) -> Mask | np.bool_:
        """The mask of the components that enter in `rows`, (..., 1, d); True if all do."""
        return np.True_ if self.taken is None else self.taken[rows][..., None, :]

    def _relative(self, rows: int | slice, parents: Array, child: Array, own: Array) -> Array:
        """The CPD's log-density `own` (..., S), less the linearised CPD's if `self.relative`.

        `parents` (..., S, n) and `child` (..., S, d) are the values at which both log-densities are
        taken. The relative log-density of an affine CPD is zero.
        """
        if not self.relative:
            return own
        if self.linearised is None:
            return np.zeros(parents.shape[:-1])
        residual = self._read(rows, child - self._affine(rows, parents))
        return own - _log_density(self.linearised[rows], residual)

    def _affine(self, rows: int | slice, parents: Array) -> Array:
        """The means F x + b of the linearised CPD, (..., S, d), at parents x (..., S, n)."""
        matrix, offset = self.family.matrix[rows], self.family.offset[rows]
        value: Array = parents @ transpose(matrix) + offset[..., None, :]
        return value

    def _value(
        self,
        rows: int | slice,
        parents: Array,
        *,
        on_chart: bool = False,
        strict: bool = True,
    ) -> tuple[Array, Mask]:
        """The values f(parents) at draws of the parents (..., S, n), and which draws are lost.

        The values are (..., S, d), the mask of lost draws is (..., S). A lost draw has the mean of
        the linearised CPD for its value.

        on_chart: Whether angles are put on the branch of the linearised mean. This depends on the
            parents alone, so that the child's density, of angles not wrapped, integrates to one.
        strict: Whether a lost draw raises a LinearisationError.
        """
        family = self.family
        if family.exact:
            return self._affine(rows, parents), np.zeros(parents.shape[:-1], dtype=bool)
        function = family.bound(rows, parents.ndim - 2, parents.shape[:-2])
        with np.errstate(all="ignore"):  # non-finite values are refused below
            try:
                value = function(parents)
            except PgmError:
                if family.plate:  # whose error names its first CPD
                    row, place = (rows, 0) if isinstance(rows, int) else (rows.start, slice(1))
                    alone = family.alone(row)
                    alone.bound(place, parents.ndim - 2, parents.shape[:-2])(parents)
                raise
        lost = np.zeros(value.shape[:-1], dtype=bool)
        if not np.isfinite(value).all():
            lost = np.asarray((~np.isfinite(value) & self._seen(rows)).any(axis=-1))
        if lost.any():
            if strict:
                self._refuse(rows, parents, lost)
            value = np.where(lost[..., None], self._affine(rows, parents), value)
        if on_chart and function.angles.any():
            value = nearest_branch(value, self._affine(rows, parents), function.angles)
        return value, lost

    def _refuse(self, rows: int | slice, parents: Array, lost: Mask) -> None:
        """Raise a LinearisationError that names the first lost draw.

        `lost` (..., S) is the mask of lost draws, `parents` (..., S, n) the parents' values.
        """
        where = tuple(int(axis[0]) for axis in np.nonzero(lost))
        family = self.family
        first = rows if isinstance(rows, int) else rows.start + where[0]
        step = int(family.step[first]) if family.timed else None
        at = "" if step is None else f" at step {step}"
        cpd, own = family.cpd_at(first), family.parents_at(first)
        raise LinearisationError(
            f"{cpd!r}: its function{at}, run {where[-2]}, is NaN or infinite at a draw from the "
            f"posterior, {names([own[parent] for parent in family.hidden])} = {parents[where]}; an "
            "audit needs the model wherever the Gaussian answer puts weight",
            variable=cpd.child,
            cpd=cpd,
            step=step,
            run=where[-2],
        )


# The CPDs of a prior or transition in their places, with their densities.
Links = list[tuple[Link, Term]]


def has_exact(read: Iterable[Family]) -> bool:
    """Whether some sensor that has measurements, one of the families `read`, has singular noise.

    A nonlinear sensor with singular noise raises a NumericalError.
    """
    found = [(f, fixed) for f in read if (fixed := roots.determined(roots.root(f.own_noise))).any()]
    for family, fixed in found:
        if not family.exact:
            cpd = family.cpd_at(_first(fixed))
            raise NumericalError(
                f"{cpd!r} is nonlinear, its noise is singular, and it has measurements: they leave "
                "a curved set of states, which no Gaussian draw meets; give it noise in all "
                "components",
                variable=cpd.child,
                cpd=cpd,
            )
    return bool(found)


def _first(mask: Mask) -> int:
    """The first row of which anything is marked, of a mask (rows or 1, ...)."""
    return int(np.nonzero(mask)[0][0])


def _at(stacked: Stack, rows: int | slice) -> Stack:
    """Some rows of an array (rows or 1, ...); a single row serves for all."""
    if stacked.shape[0] == 1:
        rows = 0 if isinstance(rows, int) else slice(None)
    part: Stack = stacked[rows]
    return part


def _log_density(lower: Array, residual: Array) -> Array:
    """The log-density ln N(residual; 0, L Lᵀ), (..., S), of residuals (..., S, d).

    `lower`, (..., d, d), is the root L.
    """
    return normal_density.log_density(lower, normal_density.whitened(lower, residual)[0])
