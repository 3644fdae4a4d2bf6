"""Factors of residuals: functions of several variables that are near zero."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from pgm.arguments import public
from pgm.boundary import as_floats, as_tuple
from pgm.cpds.conditional import Noise
from pgm.cpds.gaussian import NonlinearGaussianCPD
from pgm.cpds.robust import RobustNoise
from pgm.display import Listing, Shown, Summary, vector
from pgm.errors import ModelError
from pgm.factors.scope import Scope, as_scope, listed
from pgm.immutable import Immutable
from pgm.kernels.arrays import Array, frozen
from pgm.linearisers import Lineariser
from pgm.variables import Variable


@public
class NonlinearGaussianFactor(Shown, Immutable):
    r"""A factor of a residual: a function of its variables, less a value, that is Gaussian noise.

    .. math:: \phi(x) = N(f(x) - z; 0, R)

    - x: the variables of the scope;
    - f: the function, d components;
    - z: the value that was measured of it, or zero. Components of f − z that are angles are wrapped
      to [−π, π);
    - R: the noise covariance.

    A motion between two poses, an equation that holds but for noise, a custom factor. It has no
    direction: none of its variables needs another factor. Thousands of one function that differ by
    what was measured are declared by a `plate`, and linearised in one call of the function.

    Nonlinear factors are linearised first at `start`; without one, variables that no CPD of the
    network explains are taken to be zero.

    Parameters
    ----------
    scope : Variable or sequence of Variable
        Continuous variables, in the order of the function's arguments.
    function : callable
        ``function(*scope)``, (..., d), of arrays (..., dimension); as of a `NonlinearGaussianCPD`.
    cov : array_like or Noise
        (d, d), positive semidefinite; or (d,), the variance of each component; or one variance.
    value : array_like, optional
        z, (d,), what the function would be without noise; zero, if not given.
    angles : sequence of bool, optional
        The mask (d,) of the function's components that are angles, in radians; none, if not given.
    size : int, optional
        d, where neither `cov`, `value` nor `angles` tells it; 1, if not given.
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
    function, cov, noise
        As given; `cov` is (d, d), or a `Noise`.
    value : ndarray
        (d,).

    Raises
    ------
    ModelError
        As of a `NonlinearGaussianCPD`; and if `value`, `angles` or `size` do not fit the
        covariance, or a value is NaN or infinite.

    References
    ----------
    Dellaert & Kaess, Factor graphs for robot perception, 2017, section 2.1.

    Examples
    --------
    >>> a, b = pgm.variables("a b")
    >>> apart = pgm.NonlinearGaussianFactor((a, b), lambda a, b: b - a, cov=0.1, value=2.0)
    >>> held = pgm.NonlinearGaussianFactor(a, lambda a: a, cov=1e-4)
    >>> network = pgm.MarkovNetwork([apart, held])
    >>> network
    MarkovNetwork(φ(a, b)  φ(a))
    >>> pgm.infer(pgm.compile(network), {})[b].mean
    array([2.])
    """

    scope: Scope
    value: Array
    # The function as the mean of a child that has the value for evidence.
    _cpd: NonlinearGaussianCPD

    def __init__(
        self,
        scope: Variable | Iterable[Variable],
        function: Callable[..., Any],
        cov: npt.ArrayLike | Noise,
        *,
        value: npt.ArrayLike | None = None,
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
        measured = None if value is None else _value(of, given, value)
        residual = _residual(of, given, cov, measured, angles, size)
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
        zero = np.zeros(residual.dimension)
        self._set(scope=cpd.parents, value=frozen(zero if measured is None else measured), _cpd=cpd)

    @classmethod
    def _made(cls, cpd: NonlinearGaussianCPD, value: Array) -> Self:
        """The factor of a child that has a value, both checked."""
        found = object.__new__(cls)
        found.__dict__.update(scope=cpd.parents, value=value, _cpd=cpd)
        return found

    @property
    def function(self) -> Callable[..., Any]:
        """The function of the variables."""
        return self._cpd.function

    @property
    def cov(self) -> Array | Noise:
        """The covariance of the noise, (d, d)."""
        return self._cpd.cov

    @property
    def noise(self) -> RobustNoise | None:
        """The robust noise; None of Gaussian."""
        return self._cpd.noise

    @property
    def _title(self) -> str:
        return f"NonlinearGaussianFactor({listed(self.scope)})"

    def _summary(self) -> Summary:
        parts: list[str | Listing] = []
        if self.value.any():
            parts.append(f"value {vector(self.value)}")
        return Summary(self._title, [*parts, *self._cpd._parts()])


def _value(of: str, given: Scope, value: Any) -> Array:
    """A value of a factor's function, (d,), checked."""
    array = as_floats(value, f"{of}: value", variable=given[0])
    found = np.array(array[None] if array.ndim == 0 else array)
    if found.ndim > 1 or not found.size:
        raise ModelError(
            f"{of}: value has shape {found.shape}; a factor has one, (d,), and many factors are a "
            "plate, pgm.plate(factor, over, value=...)",
            variable=given[0],
        )
    if not np.isfinite(found).all():
        raise ModelError(f"{of}: the value has entries that are NaN or infinite", variable=given[0])
    return found


def _residual(
    of: str, given: Scope, cov: Any, value: Array | None, angles: Any, size: Any
) -> Variable:
    """The variable of a residual, of as many components as is told, of which some are angles."""
    told: dict[str, int] = {}
    shape = () if isinstance(cov, Noise) else np.shape(cov)
    if shape:
        told["cov"] = int(shape[-1])
    if value is not None:
        told["value"] = len(value)
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
    return Variable(free_name("residual", {v.name for v in given}), components=names, angles=turned)


def free_name(name: str, taken: Collection[str]) -> str:
    """A name like another that no variable has yet."""
    while name in taken:
        name = f"{name} "
    return name
