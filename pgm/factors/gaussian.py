"""Gaussians in moment form, and their confidence ellipses."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from pgm.arguments import public
from pgm.boundary import (
    as_generator,
    as_lengths,
    as_tuple,
    is_number,
    is_unordered,
    is_whole,
)
from pgm.display import (
    Listing,
    NoArray,
    Shown,
    Summary,
    axes,
    by_component,
    column,
    places,
    stacked,
)
from pgm.errors import ModelError, NumericalError
from pgm.factors.arrays import (
    IMPROPER,
    as_covariance,
    as_points,
    as_steps,
    as_vector,
    lead_index,
    require_broadcast,
)
from pgm.factors.listing import Framed
from pgm.factors.scope import (
    Scope,
    angle_mask,
    as_scope,
    components,
    dimension,
    distinct_labels,
    labels,
    listed,
    names,
    parted,
    positions,
    units,
)
from pgm.immutable import Immutable
from pgm.kernels import moments, normal_density, roots
from pgm.kernels.angles import difference, wrap
from pgm.kernels.arrays import Array, Integers, block, deviation, frozen
from pgm.resources import require_memory
from pgm.variables import Variable


class Ellipse(NamedTuple):
    """The smallest region of a confidence of a two-dimensional Gaussian.

    The centre is (..., 2); half-axes (..., 2), the longer one first, are √(χ²₂(c) λᵢ), with χ²₂(c)
    = −2 ln(1 − c); the orientation (...) of the longer axis is atan2(v₁₂, v₁₁), in radians in
    (−π/2, π/2]: it has no direction.
    """

    centre: Array
    half_axes: Array
    orientation: Array

    def _summary(self) -> Summary:
        lead = self.orientation.shape
        found = [place for place in places(lead) if place is not None]
        parts = np.array(
            [[*self.centre[at], *self.half_axes[at], self.orientation[at]] for at in found]
        )
        cells = np.array([column(part) for part in parts.T]).reshape(5, -1)
        rows = {place: cells[:, k].tolist() for k, place in enumerate(found)}
        heads = ["centre", "", "half-axes", "", "orientation [rad]"]
        where = [""] if lead else []
        listed = [
            None if at is None else [*([str(list(at))] if lead else []), *rows[at]]
            for at in places(lead)
        ]
        return Summary(
            "Ellipse" + (f", {lead} of them" if lead else ""),
            [Listing([*where, *heads], listed, names=len(where))],
        )

    def __repr__(self) -> str:
        return self._summary().text()

    def _repr_html_(self) -> str:
        return self._summary().html()


def confidence_ellipse(
    scope: Scope, mean: Array, cov: Array, confidence: float, components: tuple[str, str] | None
) -> Ellipse:
    """The ellipse of two components of Gaussians, by name; of the first two without."""
    known = labels(scope)
    if not is_number(confidence) or not 0.0 < confidence < 1.0:
        raise ModelError(f"a confidence lies between 0 and 1; {confidence!r} does not")
    if len(known) < 2:
        raise ModelError(f"{names(scope)} has one component; an ellipse needs two")
    pair = known[:2] if components is None else as_tuple(components)
    if pair is None or len(pair) != 2 or is_unordered(components):
        raise ModelError(f"an ellipse is of two components, not of {components!r}")
    for label in pair:
        if known.count(label) != 1 or pair[0] == pair[1]:
            raise ModelError(f"{names(scope)} has no single component {label!r}; it has {known}")
    i, j = (known.index(label) for label in pair)
    variances, orientation = moments.principal_axes(cov[..., [[i], [j]], [i, j]])
    half_axes = np.sqrt(-2.0 * np.log1p(-confidence) * variances)
    return Ellipse(mean[..., [i, j]], half_axes, orientation)


@public
class Gaussian(Framed, Shown, NoArray, Immutable):
    r"""A normal density in moment form.

    .. math:: N(x; \mu, P) = |2\pi P|^{-1/2} \exp(-\tfrac12 (x-\mu)^\top P^{-1} (x-\mu))

    - x: the variables of the scope, stacked in its order, n components;
    - μ: `mean`, (..., n); components that are angles live on one unwrapped chart;
    - P: `cov`, (..., n, n), symmetric positive semidefinite, singular ones included.

    Leading axes are independent Gaussians: runs, and, where `steps` says so, steps in time.

    Parameters
    ----------
    scope : Variable or sequence of Variable
    mean : array_like
    cov : array_like
        (..., n, n); or (n,), the variance of each component; or one variance for all of them.
    steps : array_like of int, optional
        The steps that the last leading axis stands for.

    Raises
    ------
    ModelError
        If arguments do not fit, here and in all methods: shapes, a `cov` that is no covariance, a
        variable that is not in the scope or named twice, a run that there is not.
    NumericalError
        Raised by `log_density` and `kl`, if a covariance is singular or infinite; by `sample`, if a
        variance is infinite, or the covariance all but singular and off by more than rounding.

    Examples
    --------
    >>> x = Variable("x", components=("east", "north"))
    >>> belief = Gaussian(x, mean=[1.0, 2.0], cov=[4.0, 1.0])
    >>> belief.std
    array([2., 1.])
    >>> belief.sample(5, rng=0).shape
    (5, 2)
    """

    __slots__ = ("cov", "mean", "scope", "steps")

    scope: Scope
    mean: Array
    cov: Array
    steps: Integers | None

    def __init__(
        self,
        scope: Variable | Iterable[Variable],
        mean: npt.ArrayLike,
        cov: npt.ArrayLike,
        *,
        steps: npt.ArrayLike | None = None,
    ) -> None:
        scope = as_scope(scope)
        size = dimension(scope)
        what = f"Gaussian over {names(scope)}: the"
        mean = as_vector(scope, mean, f"{what} mean")
        if mean.shape[-1:] != (size,):
            raise ModelError(f"{what} mean has shape {mean.shape}; it must end in ({size},)")
        if not np.isfinite(mean).all():
            raise ModelError(
                f"Gaussian over {names(scope)}: the mean has entries that are NaN or infinite"
            )
        cov = as_covariance(scope, cov, f"{what} covariance")
        try:
            lead = np.broadcast_shapes(mean.shape[:-1], cov.shape[:-2])
        except ValueError:
            raise ModelError(
                f"Gaussian over {names(scope)}: the leading axes of the mean {mean.shape} and the "
                f"covariance {cov.shape} do not broadcast"
            ) from None
        self._put(
            scope,
            np.broadcast_to(mean, (*lead, size)),
            np.broadcast_to(cov, (*lead, size, size)),
            None if steps is None else as_steps(scope, steps, lead),
        )

    def _put(self, scope: Scope, mean: Array, cov: Array, steps: Integers | None) -> None:
        if mean.flags.writeable:
            mean = frozen(mean)
        if cov.flags.writeable:
            cov = frozen(cov)
        if steps is not None:
            steps.flags.writeable = False
        put = object.__setattr__  # as `_set`, in a third of the time
        put(self, "scope", scope)
        put(self, "mean", mean)
        put(self, "cov", cov)
        put(self, "steps", steps)

    @classmethod
    def _make(
        cls, scope: Scope, mean: Array, cov: Array, steps: Integers | None = None
    ) -> Gaussian:
        gaussian = object.__new__(cls)
        gaussian._put(scope, mean, cov, steps)
        return gaussian

    @property
    def components(self) -> tuple[str, ...]:
        """Names of components, preceded by their variable's where several variables share them."""
        return distinct_labels(self.scope)

    @property
    def std(self) -> Array:
        """Standard deviations, (..., n)."""
        return deviation(self.cov)

    @property
    def angles(self) -> npt.NDArray[np.bool_]:
        """The mask of components that are angles, (n,)."""
        return angle_mask(self.scope)

    @property
    def units(self) -> tuple[str, ...]:
        """The units of the components, as their variables say; empty where none is known."""
        return units(self.scope)

    def __getitem__(self, index: Any) -> Gaussian:
        """Some of the Gaussians, by their places along the leading axes.

        Each axis takes a number, a slice or a row of places or booleans, by itself; axes that are
        not mentioned stay. ``belief[100:200]`` is of a hundred runs, or steps where there are no
        runs, ``belief[..., -1]`` of the last step.

        Examples
        --------
        >>> x = Variable("x")
        >>> walk = Gaussian(x, mean=[[0.0], [1.0], [2.0]], cov=[[1.0]], steps=[0, 1, 2])
        >>> walk[1:].steps
        array([1, 2])
        """
        lead = self.mean.shape[:-1]
        mean, cov, steps = self.mean, self.cov, self.steps
        for axis, item in reversed(list(enumerate(lead_index(index, lead, self)))):
            at = (slice(None),) * axis + (item,)
            mean, cov = mean[at], cov[at]
            if axis == len(lead) - 1 and steps is not None:
                steps = None if isinstance(item, int) else steps[item]
        return self._make(self.scope, mean, cov, steps)

    __iter__ = None  # else Python would go through places until one is refused

    def marginal(self, *keep: Variable) -> Gaussian:
        """The `Gaussian` over some of the variables, in the order asked for; leading axes stay.

        Examples
        --------
        >>> x, y = pgm.variables("x y")
        >>> pgm.Gaussian((x, y), mean=[1.0, 2.0], cov=[4.0, 9.0]).marginal(y).mean
        array([2.])
        """
        scope = as_scope(keep)
        places = positions(self.scope, scope)
        return self._make(
            scope, self.mean[..., places], block(self.cov, places, places), self.steps
        )

    def run(self, *index: int) -> Gaussian:
        """One run of several, a `Gaussian` with all its steps, by places along axes of runs."""
        lead = self.mean.ndim - 1 - (self.steps is not None)
        if not all(map(is_whole, index)):
            raise ModelError(
                f"a run of {self._title} is given by whole numbers, not by {index}; several are "
                "taken by belief[places]"
            )
        if len(index) > lead:
            raise ModelError(f"{self._title} has {lead} axes of runs, not {len(index)}")
        shape = self.mean.shape[: len(index)]
        if not all(-size <= place < size for place, size in zip(index, shape, strict=True)):
            raise ModelError(f"{self._title} has no run {index}; its axes of runs are {shape}")
        return self._make(self.scope, self.mean[index], self.cov[index], self.steps)

    def wrapped(self) -> Gaussian:
        """The same Gaussian with the means of angles in [−π, π), for display."""
        mean = self.mean.copy()
        mean[..., self.angles] = wrap(mean[..., self.angles])
        return self._make(self.scope, mean, self.cov, self.steps)

    @public
    def sample(self, size: int | tuple[int, ...] = (), *, rng: np.random.Generator | int) -> Array:
        """Draws; the covariance may be singular, and angles stay on the mean's chart.

        Parameters
        ----------
        size : int or tuple of int
            How many draws of each Gaussian.
        rng : numpy.random.Generator or int
            The generator of draws, or its seed.

        Returns
        -------
        ndarray
            (*size, ..., n).
        """
        shape = as_lengths(size, "of each Gaussian")
        require_memory(
            math.prod(shape) * self.mean.size,
            f"{size} draws of {self._title}",
            "draw fewer at a time",
        )
        if not np.isfinite(self.cov).all():
            raise NumericalError(
                f"Gaussian over {names(self.scope)}: no draws, since a variance is infinite"
            )
        lower = roots.root(self.cov)
        if not roots.is_proper(lower):
            raise NumericalError(f"Gaussian over {names(self.scope)}: no draws, since {IMPROPER}")
        white = as_generator(rng).standard_normal((*shape, *self.mean.shape))
        return normal_density.draw(self.mean, lower, white)

    def log_density(self, x: npt.ArrayLike) -> Array:
        """The log-density at values (..., n), in nats, (...); differences of angles are wrapped.

        Leading axes broadcast.
        """
        value = moments.log_density(self._offset(x), self.cov)
        return self._exists(value, "log-density")

    def kl(self, other: Gaussian) -> Array:
        """KL(self ‖ other) in nats, (...), for a Gaussian of mean μ' and covariance P'.

        ½ (ln |P'|/|P| − n + tr(P'⁻¹P) + (μ' − μ)ᵀ P'⁻¹ (μ' − μ)), over one scope; differences of
        angles are wrapped.
        """
        if as_gaussian(other).scope != self.scope:
            raise ModelError(
                f"KL compares Gaussians of one scope, not {names(self.scope)} with "
                f"{names(other.scope)}; take marginals first"
            )
        what = f"KL from the Gaussian over {names(self.scope)}: another"
        require_broadcast(other.mean.shape[:-1], self.mean.shape[:-1], what)
        offset = difference(other.mean, self.mean, self.angles)
        return self._exists(moments.kl(offset, self.cov, other.cov), "divergence")

    def entropy(self) -> Array:
        """The differential entropy ½ ln |2πe P| in nats, (...)."""
        return self._exists(moments.entropy(self.cov), "entropy")

    def mutual_information(self, *variables: Variable) -> Array:
        """How much some variables of the scope tell of the others, in nats, (...).

        −½ Σ ln(1 − ρ²) over the canonical correlations ρ of the two parts; ∞ where one determines a
        direction of the other.

        Examples
        --------
        >>> a, b = pgm.variables("a b")
        >>> both = pgm.Gaussian((a, b), [0.0, 0.0], [[1.0, 0.8], [0.8, 1.0]])
        >>> round(float(both.mutual_information(a)), 6)
        0.510826
        """
        left = parted(self.scope, variables)
        both = self.marginal(*variables, *left).cov
        count = dimension(variables)
        own, rest = slice(None, count), slice(count, None)
        parts = both[..., own, own], both[..., own, rest], both[..., rest, rest]
        return self._exists(moments.mutual_information(*parts), "mutual information")

    def _offset(self, x: npt.ArrayLike) -> Array:
        what = f"a point of the Gaussian over {names(self.scope)}"
        values = as_points(self.scope, x, self.mean.shape[:-1], what)
        return difference(values, self.mean, self.angles)

    def _exists(self, value: Array, what: str) -> Array:
        if np.isnan(value).any():
            raise NumericalError(
                f"Gaussian over {names(self.scope)}: no {what}, since a covariance is singular or "
                "infinite"
            )
        return value

    @public
    def ellipse(
        self, confidence: float = 0.95, components: tuple[str, str] | None = None
    ) -> Ellipse:
        """The confidence ellipse of two components.

        Parameters
        ----------
        confidence : float
            Probability of the region, in (0, 1).
        components : pair of str, optional
            Which components, by name; the first two without.
        """
        return confidence_ellipse(self.scope, self.mean, self.cov, confidence, components)

    @property
    def _title(self) -> str:
        return f"Gaussian({listed(self.scope)}){axes(self.mean.shape[:-1], self.steps)}"

    def _summary(self) -> Summary:
        lead, heads = self.mean.shape[:-1], components(self.scope)
        if lead:
            each = stacked(heads, lead, self.steps, lambda at: (self.mean[at], self.cov[at]))
        else:
            each = by_component(heads, self.mean, self.cov)
        return Summary(self._title, [each])


def as_gaussian(value: object) -> Gaussian:
    """A Gaussian; refuses anything else."""
    if not isinstance(value, Gaussian):
        raise ModelError(f"a Gaussian was due, like posterior[x], not {type(value).__name__}")
    return value
