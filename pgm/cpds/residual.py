"""Factors of residuals: functions of several variables that are near zero."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from pgm.arguments import public
from pgm.boundary import as_tuple
from pgm.cpds.conditional import Noise
from pgm.cpds.gaussian import NonlinearGaussianCPD
from pgm.cpds.robust import RobustNoise
from pgm.display import Listing, Shown, Summary
from pgm.errors import ModelError
from pgm.factors.scope import Scope, as_scope, listed
from pgm.immutable import Immutable
from pgm.linearisers import Lineariser
from pgm.variables import Variable


@public
class NonlinearGaussianFactor(Shown, Immutable):
    r"""A factor of a residual: a function of its variables that is zero but for Gaussian noise.

    .. math:: \phi(x) = N(r(x); 0, R)

    - x: the variables of the scope;
    - r: the residual, d components, of which those that are angles are wrapped to [−π, π);
    - R: its covariance.

    What two poses of a pose graph have in common, an equation that holds but for noise, a custom
    factor. It has no direction: none of its variables needs another factor.

    Parameters
    ----------
    scope : Variable or sequence of Variable
        Continuous variables, in the order of the function's arguments.
    function : callable
        ``function(*scope)``, the residual (..., d), of arrays (..., dimension); as of a
        `NonlinearGaussianCPD`.
    cov : array_like or Noise
        (d, d), positive semidefinite; or (d,), the variance of each component; or one variance.
    angles : sequence of bool, optional
        The mask (d,) of the residual's components that are angles, in radians; none, if not given.
    size : int, optional
        d, where neither `cov` nor `angles` tells it; 1, if not given.
    jacobian : mapping of Variable to callable, optional
        Derivatives by some or all variables; as of a `NonlinearGaussianCPD`.
    lineariser : Lineariser, optional
        The one for this factor, which wins over the one given to `infer`.
    noise : RobustNoise, optional
        Noise with heavier tails than Gaussian noise, of the scale matrix `cov`.

    Attributes
    ----------
    scope : tuple of Variable
        The variables, then those that a noise depends on.

    Raises
    ------
    ModelError
        As of a `NonlinearGaussianCPD`; and if `angles` or `size` do not fit the covariance.

    References
    ----------
    Dellaert & Kaess, Factor graphs for robot perception, 2017, section 2.1.

    Examples
    --------
    >>> a, b = pgm.variables("a b")
    >>> apart = pgm.NonlinearGaussianFactor((a, b), lambda a, b: b - a - 2.0, cov=0.1)
    >>> held = pgm.NonlinearGaussianFactor(a, lambda a: a, cov=1e-4)
    >>> network = pgm.MarkovNetwork([apart, held])
    >>> network
    MarkovNetwork(φ(a, b)  φ(a))
    >>> pgm.infer(pgm.compile(network), {})[b].mean
    array([2.])
    """

    scope: Scope
    # The residual as a child that is observed to be zero.
    _cpd: NonlinearGaussianCPD

    def __init__(
        self,
        scope: Variable | Iterable[Variable],
        function: Callable[..., Any],
        cov: npt.ArrayLike | Noise,
        *,
        angles: Sequence[bool] | None = None,
        size: int | None = None,
        jacobian: Mapping[Variable, Callable[..., Any]] | None = None,
        lineariser: Lineariser | None = None,
        noise: RobustNoise | None = None,
    ) -> None:
        given = as_scope(scope, "NonlinearGaussianFactor: scope")
        if not given:
            raise ModelError("a NonlinearGaussianFactor is of one variable or more")
        of = f"the NonlinearGaussianFactor of ({listed(given)})"
        residual = _residual(of, given, cov, angles, size)
        try:
            cpd = NonlinearGaussianCPD(
                residual,
                given,
                function,
                cov,
                jacobian=jacobian,
                lineariser=lineariser,
                noise=noise,
            )
        except ModelError as error:
            raise ModelError(
                f"{of}, whose residual is the child here: {error}", variable=given[0]
            ) from None
        self._set(scope=cpd.parents, _cpd=cpd)

    @property
    def _title(self) -> str:
        return f"NonlinearGaussianFactor({listed(self.scope)})"

    def _summary(self) -> Summary:
        parts: list[str | Listing] = list(self._cpd._parts())
        return Summary(self._title, parts)


def _residual(of: str, given: Scope, cov: Any, angles: Any, size: Any) -> Variable:
    """The variable of a residual, of as many components as is told, of which some are angles."""
    told: dict[str, int] = {}
    shape = () if isinstance(cov, Noise) else np.shape(cov)
    if shape:
        told["cov"] = int(shape[-1])
    mask: tuple[Any, ...] = ()
    if angles is not None:
        mask = as_tuple(angles) or ()
        if not mask or not all(isinstance(each, bool | np.bool_) for each in mask):
            raise ModelError(
                f"{of}: angles is a mask of the residual's components, such as (False, True); "
                f"found {angles!r}"
            )
        told["angles"] = len(mask)
    if size is not None:
        if not isinstance(size, int | np.integer) or isinstance(size, bool) or size < 1:
            raise ModelError(f"{of}: size is how many components the residual has, not {size!r}")
        told["size"] = int(size)
    if len(set(told.values())) > 1:
        words = ", ".join(f"{count} by {name}=" for name, count in told.items())
        raise ModelError(f"{of}: the residual has one number of components; found {words}")
    count = next(iter(told.values()), 1)
    names = tuple(f"r{k}" for k in range(count)) if count > 1 else ("residual",)
    turned = tuple(name for name, angle in zip(names, mask, strict=False) if angle)
    name = "residual"
    while name in {v.name for v in given}:
        name = f"{name} "
    return Variable(name, components=names, angles=turned)
