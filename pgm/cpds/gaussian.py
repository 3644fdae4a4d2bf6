"""Gaussian CPDs p(y | x) = N(f(x), R), with an affine f or any function."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from functools import cached_property
from types import MappingProxyType
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from pgm.arguments import public
from pgm.boundary import as_floats, is_whole
from pgm.cpds import by_step
from pgm.cpds.base import Known, Moved
from pgm.cpds.conditional import ConditionalGaussian, Noise
from pgm.cpds.derivatives import Derivatives
from pgm.cpds.robust import RobustNoise
from pgm.display import Listing, by_component, called, named_matrix, number, stacked, vector
from pgm.errors import ModelError
from pgm.factors.arrays import flat, matrices
from pgm.factors.scope import Scope, as_value, components, listed, namesake
from pgm.kernels import roots
from pgm.kernels.arrays import Array, Integers, apply, frozen
from pgm.linearisers import FunctionTemplate, Lineariser
from pgm.linearisers.calls import Call
from pgm.tracing import Tracer
from pgm.variables import Variable


class AffineCPD(ConditionalGaussian):
    """A CPD with mean Σ F_p p + offset over its parents p: exact without a lineariser."""

    matrices: Mapping[Variable, Array]
    offset: Array

    def _affine(
        self,
        hidden: tuple[Variable, ...],
        inputs: Mapping[Variable, Array],
        step: int | Integers | None = None,
    ) -> tuple[Array, Array]:
        """F (d, n) over the stacked hidden parents, and b with the evidence put in.

        Of numbers by step they are those of the `step`, whose axes they have first.
        """
        size = self.child.dimension
        matrices, offset = self._numbers(step)
        parts = [np.zeros((size, 0)), *(matrices[p] for p in hidden)]
        if any(part.ndim > 2 for part in parts):
            lead = np.broadcast_shapes(*(part.shape[:-2] for part in parts))
            parts = [np.broadcast_to(part, (*lead, *part.shape[-2:])) for part in parts]
        matrix = np.concatenate(parts, axis=-1)
        for parent in self.given:
            if parent not in hidden:
                offset = offset + apply(matrices[parent], inputs[parent])
        return matrix, offset

    def _numbers(self, step: int | Integers | None) -> tuple[Mapping[Variable, Array], Array]:
        """The matrices and the offset, of numbers by step those of the step."""
        return self.matrices, self.offset

    def _mean(self, known: Mapping[Variable, Array], lead: tuple[int, ...], call: Call) -> Array:
        if self.given or self.steps is not None:
            return self._affine((), known, call.step)[1]
        return flat(self.offset, lead, 1)

    def _summed(self, known: Known) -> Array:
        if not self.given:
            return super()._summed(known)
        matrices, offset = self._numbers(None if known.step is None else np.asarray(known.step))
        parts = (apply(np.abs(matrices[p]), np.abs(known.values[p])) for p in self.given)
        return sum(parts, np.abs(offset))

    def _over(self, moved: Moved) -> dict[str, Any]:
        found = super()._over(moved)
        matrices = dict(zip(found["given"], self.matrices.values(), strict=True))
        found["matrices"] = MappingProxyType(matrices)
        return found


def _finite(child: Variable, value: Array, what: str) -> Array:
    if not np.isfinite(value).all():
        raise ModelError(
            f"the {what} of {child!r} has entries that are NaN or infinite", variable=child
        )
    return frozen(value)


@public
class GaussianCPD(AffineCPD):
    """A density without parents: x ~ N(mean, cov).

    Parameters
    ----------
    child : Variable
    mean : array_like
        (..., d); leading axes are runs, each of which has a mean of its own.
    cov : array_like
        (..., d, d), positive semidefinite; or (d,), the variance of each component; or one
        variance for all of them. Zero where the value is known exactly. In the prior of a
        `DynamicBayesianNetwork`, and in a `BayesianNetwork`, variances may be infinite, of a
        component or, ``cov=np.inf``, of all: nothing is known of them but what measurements say,
        exactly (de Jong, The diffuse Kalman filter, 1991). As long as these do not determine a
        component of a chain, its variance is infinite and its mean has no meaning; in a network
        without time a direction that is left open is refused, naming it, and messages round loops
        do not settle. The log-evidence is the limit of ln p + ½ ln κ, a variance κ of each flat
        component that is determined growing without bound.

    Examples
    --------
    >>> x = Variable("x", components=("east", "north"))
    >>> GaussianCPD(x, mean=[0, 0], cov=[4.0, 1.0]).cov
    array([[4., 0.],
           [0., 1.]])
    """

    def __init__(self, child: Variable, mean: npt.ArrayLike, cov: npt.ArrayLike) -> None:
        self._set_family(child, (), cov, runs=True, flat=True)
        offset = np.array(as_value(child, mean, "mean"))
        self._set(matrices=MappingProxyType({}), offset=frozen(offset))
        try:
            self._lead()
        except ValueError:
            raise ModelError(
                f"GaussianCPD of {child!r}: the axes of runs of the mean, {offset.shape}, and of "
                "the covariance do not broadcast",
                variable=child,
            ) from None

    def _lead(self) -> tuple[int, ...]:
        if self.offset.ndim == 1 and (isinstance(self.cov, Noise) or self.cov.ndim == 2):
            return ()  # networks of thousands ask each of theirs
        covs = self.cov.shape[:-2] if isinstance(self.cov, np.ndarray) else ()
        if not covs:
            return self.offset.shape[:-1]
        return np.broadcast_shapes(self.offset.shape[:-1], covs)

    @property
    def mean(self) -> Array:
        """The mean, (..., d)."""
        return self.offset

    def _parts(self) -> list[str | Listing]:
        lead, heads = self._lead(), components((self.child,))
        if isinstance(self.cov, Noise):
            return [f"mean {vector(self.offset)}", *self._noise_shown()]
        if not lead:
            return [by_component(heads, self.offset, self.cov)]
        mean = np.broadcast_to(self.offset, (*lead, len(heads)))
        cov = np.broadcast_to(self.cov, (*lead, len(heads), len(heads)))
        return [stacked(heads, lead, None, lambda at: (mean[at], cov[at]))]


@public
class LinearGaussianCPD(AffineCPD):
    r"""A linear Gaussian density: y = Σ F_p p + offset + n, n ~ N(0, cov).

    .. math:: p(y_t \mid p) = N\Bigl(\sum_p F_{p,t}\, p + b_t,\; Q_t\Bigr)

    Its numbers are the same at all steps; or, in the transition or the observation of a
    `DynamicBayesianNetwork`, they change from step to step, as where steps last for different
    times. An array with one axis more, of length T and in front, then has **entry k, counted from
    0, for step k + 1**, as row k of a plain array of evidence: of a transition for the move from
    step k to step k + 1, of a sensor for its measurements at step k + 1. T is the number of steps
    of the network, which takes no other; a sensor of such numbers has none at step 0. Numbers with
    and without such an axis may stand beside one another.

    Parameters
    ----------
    child : Variable
        y, d components.
    given : mapping of Variable to array_like
        The matrix F_p, (d, dimension of p), of each parent p; a number c stands for c I where
        both have the same number of components. By step: (T, d, dimension of p).
    cov : array_like or Noise
        (d, d), positive semidefinite; or (d,), the variance of each component; or one variance for
        all of them; or ``pgm.noise(...)``. Zero where the sum is exact: a static unknown is
        ``LinearGaussianCPD(m, given={m.previous: 1.0}, cov=0)``. By step: (T, d, d).
    offset : array_like
        (d,); zero, if not given. By step: (T, d).
    noise : RobustNoise, optional
        See `NonlinearGaussianCPD`.

    Attributes
    ----------
    matrices : mapping of Variable to ndarray
    offset : ndarray
    cov : ndarray or Noise
        By step ``cov.covs`` are the matrices, (T, d, d).
    steps : int or None
        T, where some numbers change from step to step; ``cpd.at(t)`` has those of step t.

    Raises
    ------
    ModelError
        If shapes do not fit, a number is not finite, `cov` is not a covariance, or arrays by step
        differ in their numbers of steps.

    Examples
    --------
    >>> u = Variable("u", components=("v", "omega"))
    >>> command = Variable("command", components=("v", "omega"))
    >>> LinearGaussianCPD(u, given={command: 1.0}, cov=[0.1, 0.02])
    LinearGaussianCPD(u | command)

    A random walk over two steps, of 0.1 s and of 2 s, whose variance grows by 0.5 a second:

    >>> x = Variable("x")
    >>> dt = np.array([0.1, 2.0])
    >>> walk = LinearGaussianCPD(x, given={x.previous: 1.0}, cov=0.5 * dt[:, None, None])
    >>> walk.steps, walk.at(2).cov
    (2, array([[1.]]))
    """

    def __init__(
        self,
        child: Variable,
        given: Mapping[Variable, npt.ArrayLike],
        cov: npt.ArrayLike | Noise,
        *,
        offset: npt.ArrayLike = 0.0,
        noise: RobustNoise | None = None,
    ) -> None:
        if not isinstance(given, Mapping):
            raise ModelError(
                f"LinearGaussianCPD of {child!r}: given must map each parent to its matrix, "
                f"like given={{x: 1.0}}; found {given!r}",
                variable=child,
            )
        if isinstance(child, Variable):
            cov = by_step.as_noise(child, cov)
        self._set_family(child, given, cov)
        self._set_noise(noise)
        matrices = {parent: _matrix(child, parent, value) for parent, value in given.items()}
        shift = as_floats(
            offset, f"the offset of {child!r}", labels=child.components, variable=child
        ).copy()
        shift = np.full(child.dimension, shift) if shift.ndim == 0 else shift
        what = f"LinearGaussianCPD of {child!r}"
        shift = by_step.as_stack(f"{what}: the offset", shift, (child.dimension,), child)
        self._set(matrices=MappingProxyType(matrices), offset=_finite(child, shift, "offset"))
        every = {f"matrix of {p!r}": len(m) for p, m in matrices.items() if m.ndim > 2}
        every |= {"offset": len(shift)} if shift.ndim > 1 else {}
        covs = self.cov.covs if isinstance(self.cov, by_step.NoiseByStep) else None
        every |= {} if covs is None else {"covariance": len(covs)}
        steps = by_step.common(what, every, child)
        if steps is not None:
            self._set(steps=steps)
        if covs is not None and noise is not None:
            self.require_regular(roots.root(covs))

    def _numbers(self, step: int | Integers | None) -> tuple[Mapping[Variable, Array], Array]:
        if self.steps is None:
            return self.matrices, self.offset
        place = by_step.index(self, step)
        matrices = {p: m[place] if m.ndim > 2 else m for p, m in self.matrices.items()}
        return matrices, self.offset[place] if self.offset.ndim > 1 else self.offset

    def _held(self, step: int) -> Self:
        if self.steps is None or not is_whole(step):
            return self  # what is no step is refused by whoever places it
        matrices, offset = self._numbers(step)
        cov = self.cov
        if isinstance(cov, by_step.NoiseByStep):
            cov = cov.covs[by_step.index(self, step)]
        found = object.__new__(type(self))
        found.__dict__.update(self._bare())
        numbers = {"matrices": MappingProxyType(matrices), "offset": offset, "cov": cov}
        found._set(**numbers, steps=None, _origin=self.origin)
        return found

    def _parts(self) -> list[str | Listing]:
        if self.steps is not None:
            text = f"numbers of its own at each of the steps 1..{self.steps}; of step 1:"
            return [text, *self._held(1)._parts()]
        whole = np.concatenate(
            [np.zeros((self.child.dimension, 0)), *self.matrices.values()], axis=1
        )
        before = [("offset", self.offset)]
        if not isinstance(self.cov, Noise):
            before.append(("noise ±", self._deviations))
        rows, columns = components((self.child,)), components(tuple(self.matrices))
        return [named_matrix(rows, columns, whole, "F", before), *self._noise_shown()]


def _matrix(child: Variable, parent: Variable, value: npt.ArrayLike) -> Array:
    what = f"LinearGaussianCPD of {child!r}: the matrix of {parent!r}"
    matrix = as_floats(value, what, variable=parent).copy()
    due = (child.dimension, parent.dimension)
    if matrix.ndim == 0 and due[0] == due[1]:
        matrix = matrices(matrix, due[0])
    matrix = by_step.as_stack(what, matrix, due, parent)
    return _finite(child, matrix, f"matrix of {parent!r}")


@public
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
        The leading axes are runs, steps, and CPDs that share the function: each of their points
        is for itself, so that ``np.where(a > 0, ...)`` decides, not ``if (a > 0).any()``.
    cov : array_like or Noise
        (d, d), positive semidefinite; or (d,), the variance of each component; or one variance for
        all of them; or ``pgm.noise(...)``.
    jacobian : mapping of Variable to callable, optional
        Derivatives, ``jacobian[p](*given)`` giving (..., d, dimension of p), for some or all
        parents; missing ones are those of the function's trace, or differences (`derivatives`).
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
                f"{self!r}: a Jacobian is given by [{listed(unknown)}], not among its parents"
                f"{namesake(unknown[0], self.given)}",
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
        """How the Jacobian by each parent is found (given, traced or numerical), and why."""
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
        found = self._tracer.traced()
        if isinstance(found, str):
            raise ModelError(f"{self!r}: its function has no trace: {found}", cpd=self)
        return found.by(self._template(self.given).columns).batch_source

    def _parts(self) -> list[str | Listing]:
        by = f", Jacobians by ({listed(self.jacobian)})" if self.jacobian else ""
        own = f", linearised by {self.lineariser!r}" if self.lineariser is not None else ""
        grouped = ", grouped" * self.grouped
        parts: list[str | Listing] = [f"mean: {called(self.function)}{by}{own}{grouped}"]
        if not isinstance(self.cov, Noise):
            rows = zip(components((self.child,)), map(number, self._deviations), strict=True)
            parts.append(Listing(("", "noise ±"), list(rows)))
        return parts + self._noise_shown()

    def _with_covs(self, covs: Array) -> Self:
        """The CPD with a covariance of its own in each run, (runs, d, d); or (d, d)."""
        found = object.__new__(type(self))
        found.__dict__.update(self._bare(), cov=covs)
        return found

    def _lead(self) -> tuple[int, ...]:
        return () if isinstance(self.cov, Noise) else self.cov.shape[:-2]

    def _mean(self, known: Mapping[Variable, Array], lead: tuple[int, ...], call: Call) -> Array:
        due = (*call.lead, self.child.dimension)
        return call(self.function, [known[v] for v in self.given], due)

    def _over(self, moved: Moved) -> dict[str, Any]:
        jacobian = {moved(parent): derivative for parent, derivative in self.jacobian.items()}
        own = {"jacobian": MappingProxyType(jacobian), "_templates": {}}
        return super()._over(moved) | own

    def _template(self, hidden: Scope) -> FunctionTemplate:
        known = self._templates.get(hidden)
        return known or self._templates.setdefault(hidden, self._new_template(hidden))

    @cached_property
    def _templates(self) -> dict[Scope, FunctionTemplate]:
        # What is traced and compiled for one graph serves the next.
        return {}

    def _renew(self) -> None:
        """Have the function, and its derivatives, traced anew when they are next asked for."""
        for tracer in (self._tracer, *(each.whole for each in self._templates.values())):
            tracer.renew()

    def _new_template(self, hidden: Scope) -> FunctionTemplate:
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
