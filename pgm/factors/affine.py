"""Affine Gaussian conditionals p(y | x) = N(F x + b, Q), the result of linearising a CPD."""

from __future__ import annotations

from collections.abc import Iterable
from typing import ClassVar

import numpy as np
import numpy.typing as npt

from pgm.arguments import public
from pgm.boundary import as_floats
from pgm.display import NoArray, Shown, Summary, axes, named_matrix
from pgm.errors import ModelError, NumericalError
from pgm.factors.arrays import is_symmetric, matrices, symmetrised
from pgm.factors.canonical import CanonicalForm
from pgm.factors.gaussian import Gaussian, as_gaussian
from pgm.factors.scope import as_scope, dimension, names, one_name_each
from pgm.immutable import Immutable, set_writeable
from pgm.kernels import canonical, moments
from pgm.kernels.arrays import Array
from pgm.variables import Variable


@public
class AffineGaussian(Shown, NoArray, Immutable):
    r"""An affine Gaussian conditional.

    .. math:: y = F x + b + n, \qquad n \sim N(0, \Sigma)

    - F: (..., d, n);
    - b: (..., d);
    - Σ: `cov`, (..., d, d). Singular noise is ordinary: no operation but `canonical` inverts it.

    Parameters
    ----------
    F, b : array_like
    cov : array_like
        As above; or (d,), the variance of each component; or one variance for all of them.


    Examples
    --------
    >>> x = pgm.Variable("x")
    >>> double = pgm.AffineGaussian(F=[[2.0]], b=[1.0], cov=1.0)
    >>> double.forward(pgm.Gaussian(x, mean=3.0, cov=1.0), pgm.Variable("y"))
    Gaussian(y)
         mean ± deviation
      y       7.00 ± 2.24
    """

    __slots__ = ("F", "b", "cov")

    _arrays: ClassVar[str] = ".F, .b and .cov"

    F: Array
    b: Array
    cov: Array

    def __init__(self, F: npt.ArrayLike, b: npt.ArrayLike, cov: npt.ArrayLike) -> None:
        F = as_floats(F, "affine Gaussian: F").copy("K")
        b = as_floats(b, "affine Gaussian: b").copy("K")
        size = F.shape[-2] if F.ndim >= 2 else -1
        cov = as_floats(cov, "affine Gaussian: cov").copy()
        if cov.ndim < 2 and size >= 0:
            cov = matrices(cov, size)
        if b.shape[-1:] != (size,) or cov.shape[-2:] != (size, size):
            raise ModelError(
                f"affine Gaussian: F {F.shape}, b {b.shape} and cov {cov.shape} must end in "
                "(d, n), (d,) and (d, d)"
            )
        if F.ndim > 2 or b.ndim > 1 or cov.ndim > 2:
            try:
                np.broadcast_shapes(F.shape[:-2], b.shape[:-1], cov.shape[:-2])
            except ValueError:
                raise ModelError(
                    f"affine Gaussian: the leading axes of F {F.shape}, b {b.shape} and cov "
                    f"{cov.shape} do not broadcast"
                ) from None
        # Whether they are finite and symmetric is asked where they are used: an engine names the
        # CPD and the step, and what rounding leaves of an approximation error has no symmetry.
        cov = symmetrised(cov)
        put = object.__setattr__  # as `_set`, in a third of the time
        for name, part in (("F", F), ("b", b), ("cov", cov)):
            set_writeable(part, False)
            put(self, name, part)

    def forward(self, x: Gaussian, child: Variable) -> Gaussian:
        """The child's marginal: mean F μ + b and covariance F P Fᵀ + Σ.

        F has to map the scope of x, N(μ, P), to the child, and be finite as b and Σ are; Σ has to
        be symmetric: else it is a ModelError, here and in the other methods.
        """
        child_scope, given = as_scope(child), as_gaussian(x).scope
        one_name_each((*child_scope, *given))
        self._fits(child_scope, given)
        mean, cov = moments.push(x.mean, x.cov, moments.Conditional(self.F, self.b, self.cov))
        return Gaussian._make(child_scope, mean, cov)

    def backward(self, message: CanonicalForm, given: Iterable[Variable]) -> CanonicalForm:
        """∫ N(y; F x + b, Σ) C(y; K, h, g) dy over the parents x.

        With M = I + K Σ and e = h − K b: FᵀM⁻¹K F, FᵀM⁻¹e and
        g − ½ ln|M| + hᵀb − ½ bᵀK b + ½ eᵀΣM⁻¹e.

        The message is over the child, `given` are the parents. Only an indefinite K can make the
        integral diverge: a NumericalError.
        """
        if not isinstance(message, CanonicalForm):
            raise ModelError(f"a message is a CanonicalForm, not {type(message).__name__}")
        given = as_scope(given)
        one_name_each((*message.scope, *given))
        self._fits(message.scope, given)
        parts = canonical.backward(self.F, self.b, self.cov, message.K, message.h, message.g)
        if np.isnan(parts[2]).any():
            raise NumericalError(
                f"no message over {names(given)}: the integral over {names(message.scope)} diverges"
            )
        return CanonicalForm._make(given, *parts)

    def canonical(
        self, child: Variable | Iterable[Variable], given: Variable | Iterable[Variable]
    ) -> CanonicalForm:
        """The conditional as a factor over (child, *given).

        K = [[Σ⁻¹, −Σ⁻¹F], [−FᵀΣ⁻¹, FᵀΣ⁻¹F]], h = [Σ⁻¹b; −FᵀΣ⁻¹b] and
        g = −½ (bᵀΣ⁻¹b + d ln 2π + ln|Σ|).

        If Σ is singular, the factor has no canonical form: a NumericalError.
        """
        child, given = as_scope(child), as_scope(given)
        scope = as_scope((*child, *given), "the scope of the factor")
        self._fits(child, given)
        K, h, g = canonical.from_affine(self.F, self.b, self.cov)
        if np.isnan(g).any():
            raise NumericalError(
                f"the CPD of {names(child)} has no canonical form: its noise is singular",
                variable=child[0],
            )
        return CanonicalForm._make(scope, K, h, g)

    def _fits(self, child: tuple[Variable, ...], given: tuple[Variable, ...]) -> None:
        if (dimension(child), dimension(given)) != self.F.shape[-2:]:
            raise ModelError(
                f"an F of shape {self.F.shape} does not map {names(given)} to {names(child)}"
            )
        if not all(np.isfinite(part).all() for part in (self.F, self.b, self.cov)):
            raise ModelError(f"affine Gaussian of {names(child)}: F, b and cov must be finite")
        if not is_symmetric(self.cov):
            raise ModelError(f"affine Gaussian of {names(child)}: cov is not symmetric")

    @property
    def _title(self) -> str:
        lead = axes(self._lead, None)
        return f"AffineGaussian({self.F.shape[-1]} -> {self.F.shape[-2]}{lead})"

    @property
    def _lead(self) -> tuple[int, ...]:
        return np.broadcast_shapes(self.F.shape[:-2], self.b.shape[:-1], self.cov.shape[:-2])

    def _summary(self) -> Summary:
        if not all(self._lead):
            return Summary(self._title)
        F, b, cov = (
            part[(0,) * (part.ndim - own)]
            for part, own in ((self.F, 2), (self.b, 1), (self.cov, 2))
        )
        parents, children = (
            [f"{word}{k}" for k in range(size)]
            for word, size in (("x", F.shape[1]), ("y", F.shape[0]))
        )
        return Summary(
            self._title,
            [
                "y = F x + b + n" + ", of the first run" * bool(self._lead),
                named_matrix(children, parents, F, "F", before=[("b", b)]),
                named_matrix(children, children, cov, "cov"),
            ],
        )
