"""Gaussian CPDs whose mean is any function of the parents."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from functools import cached_property
from types import MappingProxyType
from typing import Any

import numpy as np
import numpy.typing as npt

from pgm.cpds.conditional import ConditionalGaussian, Noise
from pgm.cpds.derivatives import Derivatives
from pgm.cpds.robust import RobustNoise
from pgm.display import Listing, called, number
from pgm.errors import ModelError
from pgm.factors.scope import Scope, components, listed
from pgm.kernels.arrays import Array
from pgm.linearisers import FunctionTemplate, Lineariser
from pgm.linearisers.calls import Call
from pgm.tracing import Tracer
from pgm.variables import Variable


class NonlinearGaussianCPD(ConditionalGaussian):
    """A Gaussian density about a function: y = f(*given) + n, n ~ N(0, cov).

    Parameters
    ----------
    child : Variable
        y, d components.
    given : Variable or sequence of Variable
        The parents, in the order of the function's arguments.
    function : callable
        ``function(*given)``, from arrays (..., dimension), leading axes equal or none, to (..., d).
    cov : array_like or Noise
        (d, d), positive semidefinite; or (d,), the variance of each component; or one variance for
        all of them; or ``pgm.noise(...)``.
    jacobian : mapping of Variable to callable, optional
        Derivatives, ``jacobian[p](*given)`` giving (..., d, dimension of p), for some or all
        parents; those of hidden parents are called, and missing ones are taken by differences.
    lineariser : Lineariser, optional
        The one for this CPD, which wins over the one given to `infer`.
    grouped : bool
        As a sensor: whether the sightings of one step are linearised as one stacked vector, so
        that a sigma-point rule keeps the cross terms of their approximation errors.
    noise : RobustNoise, optional
        Noise with heavier tails than Gaussian noise, of the scale matrix `cov`, which is then
        regular: ``pgm.StudentT(dof)``, ``Huber``, ``Cauchy``, ``TruncatedLeastSquares``.

    Raises
    ------
    ModelError
        If shapes do not fit, `cov` is not a covariance, or something callable is not.

    Examples
    --------
    >>> x, y = pgm.variables("x y")
    >>> cpd = pgm.NonlinearGaussianCPD(
    ...     y, given=x, function=np.sin, cov=0.0, jacobian={x: lambda x: np.cos(x)[..., None]}
    ... )
    >>> cpd
    NonlinearGaussianCPD(y | x)
    >>> cpd.sample({x: [[0.0], [np.pi / 2]]}, rng=0)
    array([[0.],
           [1.]])
    """

    function: Callable[..., Any]
    jacobian: Mapping[Variable, Callable[..., Any]]
    lineariser: Lineariser | None
    grouped: bool
    _tracer: Tracer

    def __init__(
        self,
        child: Variable,
        given: Variable | Iterable[Variable],
        function: Callable[..., Any],
        cov: npt.ArrayLike | Noise,
        *,
        jacobian: Mapping[Variable, Callable[..., Any]] | None = None,
        lineariser: Lineariser | None = None,
        grouped: bool = False,
        noise: RobustNoise | None = None,
    ) -> None:
        self._set_family(child, given, cov)
        self._set_noise(noise)
        if jacobian is not None and not isinstance(jacobian, Mapping):
            raise ModelError(
                f"{self!r}: jacobian maps parents to functions, jacobian={{x: by_state}}; found "
                f"{jacobian!r}",
                cpd=self,
            )
        derivatives = dict(jacobian or {})
        unknown = [parent for parent in derivatives if parent not in self.given]
        if unknown:
            raise ModelError(
                f"{self!r}: a Jacobian is given by [{listed(unknown)}], not among its parents",
                variable=unknown[0],
                cpd=self,
            )
        for what, value in [("function", function), *derivatives.items()]:
            if not callable(value):
                name = what if what == "function" else f"Jacobian by {what!r}"
                raise ModelError(f"{self!r}: the {name} must be callable, not {value!r}", cpd=self)
        if lineariser is not None and (not callable(lineariser) or isinstance(lineariser, type)):
            raise ModelError(
                f"{self!r}: a lineariser is called with a function and a belief; {lineariser!r} "
                "cannot be called",
                cpd=self,
            )
        if not isinstance(grouped, bool):
            raise ModelError(f"{self!r}: grouped is True or False, not {grouped!r}", cpd=self)
        self._set(
            function=function,
            jacobian=MappingProxyType(derivatives),
            lineariser=lineariser,
            grouped=grouped,
            # Copies at steps have it, too.
            _tracer=Tracer(
                function, [parent.dimension for parent in self.given], self.child.angle_mask
            ),
        )

    @property
    def derivatives(self) -> Derivatives:
        """How the derivative by each parent is found: given, traced or numerical, and why."""
        return Derivatives(self)

    def source(self) -> str:
        """The code that NumPy computes the traced function and its derivative with.

        Its arguments are arrays (..., dimension); a value (d, ...) and the derivative by all
        parents, (d, n, ...), are written to.

        Raises
        ------
        ModelError
            If the function has no trace.

        Examples
        --------
        >>> from pgm.examples import square
        >>> print(square.cpds[1].source())
        def batch(a0, value, slope):
            t0 = a0[..., 0]
            t2 = multiply(t0, t0, out=value[0, ...])
            t4 = add(t0, t0, out=slope[0, 0, ...])
        """
        if not self._tracer.confirm([np.zeros(parent.dimension) for parent in self.given]):
            raise ModelError(
                f"{self!r}: its function has no trace: {self._tracer.reason}", cpd=self
            )
        assert self._tracer.trace is not None
        return self._tracer.trace.program(self._template(self.given).columns).batch_source

    def _parts(self) -> list[str | Listing]:
        by = f", Jacobians by ({listed(self.jacobian)})" if self.jacobian else ""
        own = f", linearised by {self.lineariser!r}" if self.lineariser is not None else ""
        grouped = ", grouped" * self.grouped
        parts: list[str | Listing] = [f"mean: {called(self.function)}{by}{own}{grouped}"]
        if not isinstance(self.cov, Noise):
            rows = zip(components((self.child,)), map(number, self._deviations), strict=True)
            parts.append(Listing(("", "noise ±"), list(rows)))
        return parts + self._noise_shown()

    def _mean(self, known: Mapping[Variable, Array], lead: tuple[int, ...], call: Call) -> Array:
        due = (*call.lead, self.child.dimension)
        return call(self.function, [known[v] for v in self.given], due)

    def _placed(self, step: int) -> dict[str, Any]:
        jacobian = {parent.at(step): derivative for parent, derivative in self.jacobian.items()}
        return super()._placed(step) | {"jacobian": MappingProxyType(jacobian)}

    def _template(self, hidden: Scope) -> FunctionTemplate:
        return FunctionTemplate(
            child=self.child,
            given=self.given,
            hidden=hidden,
            function=self.function,
            jacobians=tuple(self.jacobian.get(parent) for parent in self.given),
            variances=self._variances,
            tracer=self._tracer,
        )

    @cached_property
    def _variances(self) -> tuple[float, ...]:
        if isinstance(self.cov, Noise):
            return (0.0,) * self.child.dimension
        each = np.diagonal(self.cov, axis1=-2, axis2=-1).reshape(-1, self.child.dimension)
        return tuple(each.min(axis=0).tolist())
