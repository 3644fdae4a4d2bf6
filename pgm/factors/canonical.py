"""Gaussian factors in canonical (information) form."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import ClassVar

import numpy as np
import numpy.typing as npt

from pgm.arguments import public
from pgm.boundary import as_floats, as_mapping
from pgm.display import NoArray, Shown, Summary, axes
from pgm.errors import ModelError, NumericalError
from pgm.factors.arrays import as_information, as_points, require_broadcast
from pgm.factors.gaussian import Gaussian, as_gaussian
from pgm.factors.listing import canonical_summary
from pgm.factors.scope import (
    Scope,
    as_scope,
    as_value,
    dimension,
    listed,
    names,
    positions,
)
from pgm.immutable import Immutable
from pgm.kernels import canonical as kernel
from pgm.kernels.arrays import Array, apply, frozen, inner
from pgm.variables import Variable


@public
class CanonicalForm(Shown, NoArray, Immutable):
    r"""A Gaussian factor in canonical form.

    .. math:: C(x; K, h, g) = \exp(-\tfrac12 x^\top K x + h^\top x + g)

    - x: the variables of the scope, stacked in its order, n components;
    - K: the information matrix, (..., n, n), symmetric; it need not be invertible;
    - h: the information vector, (..., n);
    - g: the log-scale, (...), so that products and messages stay unnormalised.

    Leading axes are independent factors and broadcast. Every operation carries g.

    Parameters
    ----------
    scope : Variable or sequence of Variable
    K, h, g : array_like

    Raises
    ------
    ModelError
        If arguments do not fit, here and in all methods: shapes, a K that is not symmetric, entries
        that are not finite, a variable that is not in the scope or named twice.
    NumericalError
        Raised by `log_integral`, `gaussian` and `normalised`, if K is not positive definite.

    References
    ----------
    Koller & Friedman, Probabilistic Graphical Models, 2009, section 14.2.

    Examples
    --------
    >>> from pgm.variables import variables
    >>> a, b = variables("a b")
    >>> f = CanonicalForm((a, b), K=[[2.0, -1.0], [-1.0, 2.0]], h=[0.0, 1.0], g=0.0)
    >>> f.marginal(a).K
    array([[1.5]])
    """

    __slots__ = ("K", "g", "h", "scope")

    _arrays: ClassVar[str] = ".K, .h and .g, or the .mean and .cov of its .gaussian()"

    scope: Scope
    K: Array
    h: Array
    g: Array

    def __init__(
        self,
        scope: Variable | Iterable[Variable],
        K: npt.ArrayLike,
        h: npt.ArrayLike,
        g: npt.ArrayLike = 0.0,
    ) -> None:
        scope = as_scope(scope)
        self._put(scope, *as_information(scope, K, h, g))

    def _put(self, scope: Scope, K: Array, h: Array, g: Array) -> None:
        try:
            lead = np.broadcast_shapes(K.shape[:-2], h.shape[:-1], g.shape)
        except ValueError:
            raise ModelError(
                f"canonical form over {names(scope)}: the leading axes of K {K.shape}, "
                f"h {h.shape} and g {g.shape} do not broadcast"
            ) from None
        self._set(
            scope=scope,
            K=frozen(np.broadcast_to(K, (*lead, *K.shape[-2:]))),
            h=frozen(np.broadcast_to(h, (*lead, h.shape[-1]))),
            g=frozen(np.broadcast_to(g, lead)),
        )

    @classmethod
    def _make(cls, scope: Scope, K: Array, h: Array, g: Array) -> CanonicalForm:
        form = object.__new__(cls)
        form._put(scope, K, h, np.asarray(g))
        return form

    @classmethod
    def vacuous(cls, scope: Variable | Iterable[Variable]) -> CanonicalForm:
        """The factor that is one everywhere: K = 0, h = 0, g = 0."""
        scope = as_scope(scope)
        size = dimension(scope)
        return cls._make(scope, np.zeros((size, size)), np.zeros(size), np.zeros(()))

    @classmethod
    @public
    def from_gaussian(cls, gaussian: Gaussian, log_weight: npt.ArrayLike = 0.0) -> CanonicalForm:
        """exp(log_weight) N(x; μ, P): K = P⁻¹, h = P⁻¹μ, g = ln N(0; μ, P) + log_weight.

        The log-weight is (...). If P is singular, K does not exist: a NumericalError.
        """
        gaussian = as_gaussian(gaussian)
        what = f"the log-weight of the Gaussian over {names(gaussian.scope)}"
        weight = as_floats(log_weight, what)
        if not np.isfinite(weight).all():
            raise ModelError(f"{what} must be finite")
        require_broadcast(weight.shape, gaussian.mean.shape[:-1], what)
        K, h, g = kernel.from_moments(gaussian.mean, gaussian.cov, weight)
        if np.isnan(g).any():
            raise NumericalError(
                f"the Gaussian over {names(gaussian.scope)} has no canonical form: its "
                "covariance is singular"
            )
        return cls._make(gaussian.scope, K, h, g)

    def extend(self, scope: Variable | Iterable[Variable]) -> CanonicalForm:
        """The same factor over a wider or reordered scope: zeros for the new variables."""
        scope = as_scope(scope)
        if scope == self.scope:
            return self
        missing = [variable for variable in self.scope if variable not in scope]
        if missing:
            raise ModelError(
                f"cannot extend to {names(scope)}: it lacks {names(missing)}; "
                "marginalise or reduce them first"
            )
        size = dimension(scope)
        places = np.arange(size)[positions(scope, self.scope)]
        K = np.zeros((*self.K.shape[:-2], size, size))
        h = np.zeros((*self.h.shape[:-1], size))
        K[..., places[:, None], places] = self.K
        h[..., places] = self.h
        return self._make(scope, K, h, self.g)

    rearrange = extend

    def _aligned(self, other: CanonicalForm) -> tuple[CanonicalForm, CanonicalForm]:
        scope = as_scope((*self.scope, *(v for v in other.scope if v not in self.scope)))
        try:
            np.broadcast_shapes(self.g.shape, other.g.shape)
        except ValueError:
            raise ModelError(
                f"the leading axes of {self._title} and {other._title} do not broadcast"
            ) from None
        return self.extend(scope), other.extend(scope)

    def __mul__(self, other: CanonicalForm) -> CanonicalForm:
        """Product of two factors: K, h and g add on the common scope."""
        if not isinstance(other, CanonicalForm):
            return NotImplemented
        a, b = self._aligned(other)
        return self._make(a.scope, a.K + b.K, a.h + b.h, a.g + b.g)

    def __truediv__(self, other: CanonicalForm) -> CanonicalForm:
        """Quotient of two factors: K, h and g subtract on the common scope."""
        if not isinstance(other, CanonicalForm):
            return NotImplemented
        a, b = self._aligned(other)
        return self._make(a.scope, a.K - b.K, a.h - b.h, a.g - b.g)

    def marginalise(self, *drop: Variable) -> CanonicalForm:
        """Integrate some variables out.

        K' = K_xx − K_xy K_yy⁻¹ K_yx, h' = h_x − K_xy K_yy⁻¹ h_y and
        g' = g + ½ (d_y ln 2π − ln|K_yy| + h_yᵀ K_yy⁻¹ h_y), for y the variables to drop.

        If K_yy is not positive definite, the integral diverges: a NumericalError.
        """
        out = positions(self.scope, as_scope(drop))
        keep = tuple(variable for variable in self.scope if variable not in drop)
        if not drop:
            return self
        K, h, g = kernel.marginalise(self.K, self.h, self.g, positions(self.scope, keep), out)
        if not np.isfinite(g).all():
            raise NumericalError(
                f"cannot integrate {names(drop)} out of a factor over {names(self.scope)}: its "
                "information about them is not positive definite, so the integral diverges"
            )
        return self._make(keep, K, h, g)

    def marginal(self, *keep: Variable) -> CanonicalForm:
        """Integrate all but some variables out; the result is in the order asked for."""
        positions(self.scope, as_scope(keep))
        dropped = (variable for variable in self.scope if variable not in keep)
        return self.marginalise(*dropped).rearrange(keep)

    def reduce(self, evidence: Mapping[Variable, npt.ArrayLike]) -> CanonicalForm:
        """Put in the values Y of some variables y.

        K' = K_xx, h' = h_x − K_xy Y and g' = g + h_yᵀY − ½ Yᵀ K_yy Y.

        Values are (..., dimension) each; a number for a scalar.
        """
        evidence = as_mapping(evidence, "the evidence of a factor", ModelError)
        if not evidence:
            return self
        fixed = positions(self.scope, evidence)
        values = [as_value(variable, value) for variable, value in evidence.items()]
        lead = np.broadcast_shapes(*(value.shape[:-1] for value in values))
        value = np.concatenate([np.broadcast_to(v, (*lead, v.shape[-1])) for v in values], axis=-1)
        keep = tuple(variable for variable in self.scope if variable not in evidence)
        return self._make(
            keep,
            *kernel.reduce(self.K, self.h, self.g, positions(self.scope, keep), fixed, value),
        )

    def _moments(self) -> tuple[Array, Array, Array]:
        mean, cov, log_integral = kernel.to_moments(self.K, self.h, self.g)
        if not np.isfinite(log_integral).all():
            raise NumericalError(
                f"the factor over {names(self.scope)} has no moments: its information matrix "
                "is not positive definite"
            )
        return mean, cov, log_integral

    @property
    def log_integral(self) -> Array:
        """The log-integral ln ∫ C(x) dx, (...)."""
        return self._moments()[2]

    def gaussian(self) -> Gaussian:
        """The normalised moment form."""
        mean, cov, _ = self._moments()
        return Gaussian._make(self.scope, mean, cov)

    def combine(self, gaussian: Gaussian) -> tuple[Gaussian, Array]:
        """The product N(x; m, P) C(x; K, h, g) in moment form, and its log-integral.

        P may be singular and is never inverted: for a root P = L Lᵀ the covariance is
        P⁺ = L (I + LᵀK L)⁻¹ Lᵀ and the mean m + P⁺ (h − K m).

        The Gaussian is over the variables of the factor, in any order; the product is in its order,
        normalised. Only an indefinite K can leave it without an integral: a NumericalError.
        """
        gaussian = as_gaussian(gaussian)
        if set(gaussian.scope) != set(self.scope):
            raise ModelError(
                f"combine takes a Gaussian over {names(self.scope)}, not {names(gaussian.scope)}"
            )
        form = self.rearrange(gaussian.scope)
        mean, cov, log_integral = kernel.combine(
            gaussian.mean, gaussian.cov, form.K, form.h, form.g
        )
        if np.isnan(log_integral).any():
            raise NumericalError(
                f"the product of a Gaussian and a factor over {names(self.scope)} has no integral"
            )
        return Gaussian._make(gaussian.scope, mean, cov), log_integral

    def normalised(self) -> CanonicalForm:
        """The factor divided by its integral."""
        return self._make(self.scope, self.K, self.h, self.g - self.log_integral)

    def log_value(self, x: npt.ArrayLike) -> Array:
        """The logarithm ln C(x) at stacked values (..., n), whose leading axes broadcast, (...)."""
        what = f"a point of the canonical form over {names(self.scope)}"
        x = as_points(self.scope, x, self.g.shape, what)
        return inner(self.h, x) - 0.5 * inner(apply(self.K, x), x) + self.g

    @property
    def _title(self) -> str:
        return f"CanonicalForm({listed(self.scope)}){axes(self.g.shape, None)}"

    def _summary(self) -> Summary:
        return canonical_summary(self._title, self.scope, self.K, self.h, self.g)
