"""CPDs that are a function of the parents plus Gaussian noise, whose covariance may be one too."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from pgm.arguments import public
from pgm.cpds.base import CPD, Known, Moved, Values
from pgm.cpds.robust import RobustNoise
from pgm.display import InCode, Listing, called, named_matrix
from pgm.errors import LinearisationError, ModelError, NumericalError
from pgm.factors.arrays import IMPROPER, as_covariance, covariance_fault, flat, symmetrised, unflat
from pgm.factors.arrays import diagonal as on_diagonal
from pgm.factors.scope import Scope, as_scope, components, listed
from pgm.kernels import normal_density, roots, solving
from pgm.kernels.angles import difference
from pgm.kernels.arrays import (
    LOG_2PI,
    Array,
    Integers,
    Mask,
    deviation,
    frozen,
    independent,
    inner,
    quiet,
    transpose,
)
from pgm.kernels.moments import ROUNDING
from pgm.linearisers.calls import Call
from pgm.linearisers.numbering import COUNTED, Numbering
from pgm.variables import Variable


@dataclass(frozen=True, eq=False, repr=False)
class Noise(InCode):
    """A noise covariance that depends on observed parents; made by `noise`."""

    function: Callable[..., Any]
    given: Scope
    diagonal: bool = False

    def __repr__(self) -> str:
        return f"Noise({called(self.function)}, given=({listed(self.given)}))"

    def scaled(self, factor: float) -> Noise:
        """The noise whose covariances are a multiple of this one's."""
        return replace(self, function=_Multiple(self.function, factor))

    def _values(
        self,
        cpd: ConditionalGaussian,
        known: Mapping[Variable, Array],
        shape: tuple[int, ...],
        step: int | Integers | None,
        numbering: Numbering,
    ) -> Array:
        """The covariances that `evaluate` returns."""
        arguments = [np.broadcast_to(known[v], (*shape, v.dimension)) for v in self.given]
        call = Call(cpd.child, "noise", shape, step, numbering, cpd)
        size = cpd.child.dimension
        if self.diagonal:
            value = on_diagonal(call(self.function, arguments, (*shape, size), _VARIANCES))
        else:
            due = (*shape, size, size)
            value = symmetrised(call(self.function, arguments, due, _MATRICES))
        if covariance_fault(value):
            for index in np.ndindex(shape):
                if fault := covariance_fault(value[index]):
                    raise call.error(fault, index)
        return value


@public
def noise(
    function: Callable[..., Any],
    given: Variable | Iterable[Variable],
    *,
    diagonal: bool = False,
) -> Noise:
    """A noise covariance that is a function of parents with evidence.

    Parameters
    ----------
    function : callable
        ``function(*given)``, from arrays (..., d), leading axes equal or none, to covariances
        (..., n, n), with the same leading axes; checked where they are used.
    given : Variable or sequence of Variable
        The parents, which must have evidence, since a covariance cannot be linearised.
    diagonal : bool
        Whether the function returns the variances of the components, (..., n), instead. It is said
        here since three rows of variances of three components and one matrix have the same shape.

    Examples
    --------
    >>> u = Variable("u", components=("v", "dt"))
    >>> driven = noise(lambda u: 0.01 * u[..., 1, None, None] * np.eye(3), given=(u,))
    >>> slipping = noise(lambda u: 0.1 * u**2, given=(u,), diagonal=True)
    """
    if not callable(function):
        raise ModelError(f"noise takes a function of the parents, not {function!r}")
    if not isinstance(diagonal, bool):
        raise ModelError(f"noise: diagonal is True or False, not {diagonal!r}")
    return Noise(function, as_scope(given, "noise: given"), diagonal)


@dataclass(frozen=True)
class _Multiple:
    """A multiple of a function."""

    function: Callable[..., Any]
    factor: float

    def __call__(self, *given: Array) -> Any:
        return self.factor * np.asarray(self.function(*given))


# What to do about a shape that was not due.
_MATRICES = (
    "it is called with arrays that have leading axes and returns a matrix for each; variances "
    "(..., n) are declared by noise(function, given, diagonal=True)"
)
_VARIANCES = (
    "it is called with arrays that have leading axes and returns the variance of each component, "
    "as diagonal=True says; leave that out for matrices (..., n, n)"
)


def evaluate(
    cpd: ConditionalGaussian,
    known: Mapping[Variable, Array],
    shape: tuple[int, ...],
    step: int | Integers | None,
    numbering: Numbering = COUNTED,
) -> Array:
    """The covariance for given values of the parents, (*shape, n, n), checked.

    Values of the parents broadcast to (*shape, d), steps to the shape, whose last axis is of runs;
    where covariances are a function, step and its `numbering` are for messages.
    """
    assert isinstance(cpd.cov, Noise)
    return cpd.cov._values(cpd, known, shape, step, numbering)


class ConditionalGaussian(CPD):
    """A CPD of a function of the parents plus Gaussian noise, or robust, `cov` being its scale."""

    cov: Array | Noise
    noise: RobustNoise | None = None
    partial = True

    def _set_family(
        self,
        child: Variable,
        given: Variable | Iterable[Variable],
        cov: npt.ArrayLike | Noise,
        *,
        runs: bool = False,
        flat: bool = False,
    ) -> None:
        self._set_scope(child, given, cov.given if isinstance(cov, Noise) else ())
        if not isinstance(cov, Noise):
            what = f"the covariance of {child!r}"
            cov = as_covariance((child,), cov, what, runs=runs, flat=flat, variable=child)
            cov = frozen(cov)
        self._set(cov=cov)

    def _with_cov(self, cov: npt.ArrayLike | Noise) -> Self:
        found = object.__new__(type(self))
        found.__dict__.update(self._bare())
        found._set_family(self.child, self.given, cov)
        return found

    def _scaled(self, factor: float) -> Self:
        """The CPD of Gaussian noise whose covariance is a multiple of this one's `cov`."""
        cov = self.cov
        found = self._with_cov(cov.scaled(factor) if isinstance(cov, Noise) else factor * cov)
        found._set(noise=None)
        return found

    def _with_noise(self, noise: RobustNoise) -> Self:
        """The CPD with robust noise of the same scale."""
        found = object.__new__(type(self))
        found.__dict__.update(self._bare())
        found._set_noise(noise)
        return found

    def _set_noise(self, noise: RobustNoise | None) -> None:
        if noise is None:
            return
        if not isinstance(noise, RobustNoise):
            raise ModelError(
                f"{self!r}: noise is robust noise, like pgm.StudentT(4.0), or None for Gaussian "
                f"noise; found {noise!r}; a covariance is given as cov=",
                variable=self.child,
                cpd=self,
            )
        noise.require_sound(self.child.dimension)
        self._set(noise=noise)
        if not isinstance(self.cov, Noise):
            self.require_proper("a robust noise weighs residuals by it")
            self.require_regular(roots.root(self.cov))

    def require_regular(self, lower: Array) -> None:
        """Refuse, for robust noise, the roots of covariances of which one is singular."""
        if not (np.diagonal(lower, axis1=-2, axis2=-1) > 0.0).all():
            raise ModelError(
                f"{self!r}: {self.noise!r} weighs a residual by its Mahalanobis square, which a "
                "singular covariance has not; give each component a variance, and no two that are "
                "one",
                variable=self.child,
                cpd=self,
            )

    @property
    def _deviations(self) -> Array:
        if isinstance(self.cov, Noise):
            return np.full(self.child.dimension, np.nan)
        return deviation(self.cov[(0,) * (self.cov.ndim - 2)])

    def _noise_shown(self) -> list[str | Listing]:
        kind: list[str | Listing] = [] if self.noise is None else [f"noise: {self.noise!r}"]
        if isinstance(self.cov, Noise):
            return [*kind, f"noise: {called(self.cov.function)} of ({listed(self.cov.given)})"]
        cov = self.cov[(0,) * (self.cov.ndim - 2)]
        if not (cov - np.diag(np.diagonal(cov))).any():
            return kind
        heads = components((self.child,))
        return [*kind, named_matrix(heads, heads, cov, "cov")]

    def require_proper(self, what: str) -> None:
        """Refuse an infinite variance where there is no use for it, for the reason given."""
        if not isinstance(self.cov, Noise) and np.isinf(self.cov).any():
            raise ModelError(
                f"{self!r} has an infinite variance: {what}; give it a finite one",
                variable=self.child,
                cpd=self,
            )

    @property
    def noise_given(self) -> Scope:
        """The parents that the noise covariance depends on."""
        return self.cov.given if isinstance(self.cov, Noise) else ()

    @quiet()  # what is too far off to be squared has no density that float64 can hold
    def _log_density(self, child: Values, known: Known) -> Array:
        mean, lower = self._law(known)
        centre, angles = unflat(mean, known.lead, 1), self.child.angle_mask
        if lower.ndim > 2:
            lower = unflat(lower, known.lead, 2)
        seen = ~np.isnan(child)
        if not seen.all():
            return self._marginal(child, known, seen, centre, lower)
        error = normal_density.INEXACT * (np.abs(child) + np.abs(centre))
        error = error + ROUNDING * unflat(self._summed(known), known.lead, 1)
        if self.noise is not None:
            return self._robust(lower, difference(child, centre, angles), child.shape[-1])
        value = _log_density(lower, difference(child, centre, angles), error)
        if angles.any() and roots.determined(lower).any():
            # Wrapped, an angle may leave the subspace on which the noise is.
            there = _log_density(lower, child - centre, error)
            value = np.where(np.isneginf(value), there, value)
        return value

    def _marginal(
        self, child: Values, known: Known, seen: Mask, centre: Array, lower: Array
    ) -> Array:
        lead = np.broadcast_shapes(child.shape[:-1], known.lead)
        pattern = seen.reshape(-1, seen.shape[-1])
        if (pattern == pattern[0]).all():
            seen = pattern[0]  # one root serves all
        # Components of unit variance and no residual have the density of a constant.
        cov = independent(lower @ transpose(lower), seen)
        alone = roots.root(cov)
        residual = np.where(seen, difference(child, centre, self.child.angle_mask), 0.0)
        error = normal_density.INEXACT * (np.abs(np.where(seen, child, 0.0)) + np.abs(centre))
        residual = np.broadcast_to(residual, (*lead, child.shape[-1]))
        if self.noise is not None:
            return self._robust(alone, residual, seen.sum(axis=-1))
        found: Array = _log_density(alone, residual, error) + 0.5 * LOG_2PI * (~seen).sum(axis=-1)
        return found

    def _robust(self, lower: Array, residual: Array, count: npt.ArrayLike) -> Array:
        assert self.noise is not None
        self.noise.require_proper(self.child.dimension, self)
        white = solving.whiten(lower, residual)
        level = self.noise.log_scale(count) - self.noise.loss(inner(white, white), count)
        value: Array = level - 0.5 * solving.log_determinant(lower)
        return value

    def _log_peak(self, child: Values) -> Array:
        if self.noise is None or isinstance(self.cov, Noise):
            return super()._log_peak(child)
        return self._robust(
            roots.root(independent(self.cov, ~np.isnan(child))),
            np.zeros_like(child),
            (~np.isnan(child)).sum(axis=-1),
        )

    def _draw(self, known: Known, rng: np.random.Generator, size: tuple[int, ...] = ()) -> Array:
        mean, lower = self._law(known)
        white = rng.standard_normal((*size, *known.shape, self.child.dimension))
        if self.noise is not None:
            self.noise.require_proper(self.child.dimension, self)
            white = self.noise.draw(white, rng)
        return normal_density.draw(mean, lower, white)

    def _law(self, known: Known) -> tuple[Array, Array]:
        """The mean, and the root of the noise: they broadcast to (*shape, d) and (*shape, d, d)."""
        lead, shape = known.lead, known.shape
        steps = None if known.step is None else np.asarray(known.step)
        wide = {v: np.broadcast_to(a, (*shape, a.shape[-1])) for v, a in known.values.items()}
        call = Call(self.child, "function", shape, steps, COUNTED, self)
        with np.errstate(all="ignore"):  # non-finite values are refused below
            mean = self._mean(wide, lead, call)
        if not np.isfinite(mean).all():
            index = tuple(int(k) for k in np.argwhere(~np.isfinite(mean))[0, :-1])
            raise call.error("has values that are NaN or infinite", index, kind=LinearisationError)
        if not isinstance(self.cov, Noise):
            return mean, self._lower if self._lower.ndim == 2 else flat(self._lower, lead, 2)
        lower = roots.root(evaluate(self, wide, shape, steps))
        if not roots.is_proper(lower):
            index = tuple(int(k) for k in np.argwhere(np.isnan(lower))[0, :-2])
            call = Call(self.child, "noise", shape, steps, COUNTED, self)
            raise call.error(f"cannot be used: {IMPROPER}", index, kind=NumericalError)
        if self.noise is not None:
            self.require_regular(lower)
        return mean, lower

    @cached_property
    def _lower(self) -> Array:
        self.require_proper("it has neither a density nor draws")
        assert not isinstance(self.cov, Noise)
        lower = roots.root(self.cov)
        if not roots.is_proper(lower):
            raise NumericalError(
                f"{self!r} has neither a density nor draws: {IMPROPER}",
                variable=self.child,
                cpd=self,
            )
        return lower

    def _mean(self, known: Mapping[Variable, Array], lead: tuple[int, ...], call: Call) -> Array:
        """The mean at values of all parents, which broadcasts to (*call.lead, d)."""
        raise ModelError(f"{self!r} is of a kind that has no mean here", cpd=self)

    def _summed(self, known: Known) -> Array:
        """Σ |summand| of the mean, a bound for its rounding, (..., d)."""
        return np.zeros((1, self.child.dimension))

    def _over(self, moved: Moved) -> dict[str, Any]:
        found = super()._over(moved)
        if isinstance(self.cov, Noise):
            found["cov"] = replace(self.cov, given=tuple(map(moved, self.cov.given)))
        return found


def _log_density(lower: Array, residual: Array, error: Array) -> Array:
    """The value ln N(r; 0, L Lᵀ), (...); −∞ where r is off its subspace by more than an error."""
    size = residual.shape[-1]
    points = (-1, size) if lower.ndim == 2 else (*residual.shape[:-1], 1, size)
    white, left = normal_density.whitened(lower, residual.reshape(points))
    value = normal_density.log_density(lower, white)
    if left is not None:
        error = np.broadcast_to(error, residual.shape).reshape(points)
        value = np.where(normal_density.off(lower, left, error), -np.inf, value)
    value = np.where(np.isnan(value), -np.inf, value) + 0.0  # no -0
    return value.reshape(residual.shape[:-1])
