"""Mixtures of Gaussians: what is known of continuous variables beside discrete ones."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from pgm.arguments import public
from pgm.boundary import as_floats, as_generator, as_lengths
from pgm.display import Listing, NoArray, Shown, Summary, axes, few, number
from pgm.errors import ModelError, NumericalError
from pgm.factors.arrays import as_steps, lead_index
from pgm.factors.gaussian import Gaussian
from pgm.factors.scope import Scope, angle_mask, distinct_labels
from pgm.immutable import Immutable
from pgm.kernels import roots
from pgm.kernels.angles import nearest_branch
from pgm.kernels.arrays import Array, Integers, apply, deviation, frozen, transpose
from pgm.kernels.semirings import log_sum
from pgm.kernels.solving import solve_lower
from pgm.resources import require_memory

# The most components that are shown.
SHOWN = 8
# A mode is climbed to in at most so many steps, until one moves by less than this share of the
# least deviation of a component; places are one mode if they are closer than a larger share.
CLIMBS, SETTLED, ONE = 10_000, 1e-9, 1e-3


@public
class GaussianMixture(Shown, NoArray, Immutable):
    r"""A weighted sum of Gaussian densities, Σ_k w_k N(x; μ_k, P_k).

    .. math:: p(x) = \sum_k w_k \, N(x; \mu_k, P_k), \quad \mu = \sum_k w_k \mu_k, \quad
              P = \sum_k w_k \big(P_k + (\mu_k - \mu)(\mu_k - \mu)^\top\big)

    What inference answers of a continuous variable in a network that has discrete ones, too: a
    Gaussian for each configuration of the discrete variables that it depends on, weighed by the
    probability of that. Angles of the components are on the branches nearest to the likeliest one.

    Parameters
    ----------
    weights : array_like
        (..., K): w_k, not negative, of sum one.
    components : Gaussian
        The K Gaussians, (..., K, n), along the last of its leading axes.
    steps : array_like of int, optional
        The steps that the last leading axis stands for.

    Attributes
    ----------
    scope : tuple of Variable
    weights : ndarray
        (..., K).
    components : Gaussian
        (..., K, n).
    mean, cov, std : ndarray
        The moments of the whole mixture, (..., n), (..., n, n) and (..., n).
    steps : ndarray of int or None

    Raises
    ------
    ModelError
        If shapes do not fit, or the weights are none.

    Examples
    --------
    >>> x = pgm.Variable("x")
    >>> found = pgm.GaussianMixture([0.25, 0.75], pgm.Gaussian(x, [[0.0], [4.0]], [[1.0]]))
    >>> found.mean, found.cov
    (array([3.]), array([[4.]]))
    >>> found.log_density([[0.0], [4.0]]).round(3)
    array([-2.304, -1.207])
    """

    weights: Array
    components: Gaussian
    steps: Integers | None

    def __init__(
        self,
        weights: npt.ArrayLike,
        components: Gaussian,
        *,
        steps: npt.ArrayLike | None = None,
    ) -> None:
        if not isinstance(components, Gaussian):
            raise ModelError(f"the components of a mixture are a Gaussian; found {components!r}")
        found = as_floats(weights, "the weights of a mixture").copy()
        if found.ndim < 1 or found.shape != components.mean.shape[:-1]:
            raise ModelError(
                f"a mixture has a weight for each component: weights of shape {found.shape} and "
                f"Gaussians (..., K) of shape {components.mean.shape[:-1]} do not fit"
            )
        if not (found >= 0.0).all() or not (abs(found.sum(axis=-1) - 1.0) <= 1e-9).all():
            raise ModelError(
                "the weights of a mixture are not negative, and their sum is one; found sums of "
                f"{found.sum(axis=-1)}"
            )
        lead = found.shape[:-1]
        self._put(
            found, components, None if steps is None else as_steps(components.scope, steps, lead)
        )

    def _put(self, weights: Array, components: Gaussian, steps: Integers | None) -> None:
        angles = angle_mask(components.scope)
        if angles.any():
            best = weights.argmax(axis=-1)[..., None, None]
            middle = np.take_along_axis(components.mean, best, axis=-2)
            mean = nearest_branch(components.mean, middle, angles)
            components = Gaussian._make(components.scope, mean, components.cov)
        if steps is not None:
            steps.flags.writeable = False
        self._set(weights=frozen(weights), components=components, steps=steps)

    @classmethod
    def _make(
        cls, weights: Array, components: Gaussian, steps: Integers | None = None
    ) -> GaussianMixture:
        found = object.__new__(cls)
        found._put(weights, components, steps)
        return found

    @property
    def scope(self) -> Scope:
        """The variables, whose components are stacked in this order."""
        return self.components.scope

    @property
    def mean(self) -> Array:
        """The mean of the whole mixture, (..., n)."""
        return apply(transpose(self.components.mean), self.weights)

    @property
    def cov(self) -> Array:
        """The covariance of the whole mixture, (..., n, n)."""
        away = self.components.mean - self.mean[..., None, :]
        spread = transpose(away) @ (self.weights[..., None] * away)
        inside = np.einsum("...k,...kij->...ij", self.weights, self.components.cov)
        return np.asarray(inside + spread)

    @property
    def std(self) -> Array:
        """The standard deviations of the whole mixture, (..., n)."""
        return deviation(self.cov)

    @property
    def angles(self) -> npt.NDArray[np.bool_]:
        """The mask of components that are angles, (n,)."""
        return angle_mask(self.scope)

    def gaussian(self) -> Gaussian:
        """The Gaussian with the mixture's mean and covariance: of all, the nearest by KL."""
        return Gaussian._make(self.scope, self.mean, self.cov, self.steps)

    def log_density(self, x: npt.ArrayLike) -> Array:
        """The log-density ln Σ_k w_k N(x; μ_k, P_k) at values (..., n), in nats, (...)."""
        value = np.atleast_1d(as_floats(x, f"values of {self._title}"))
        each = self.components.log_density(value[..., None, :])
        with np.errstate(divide="ignore"):
            return log_sum(each + np.log(self.weights), -1)

    def modes(self) -> Array:
        r"""The places where the density is greatest around, the highest first, (modes, n).

        From the mean of each component of a weight the iteration

        .. math:: x \leftarrow \Big(\sum_k q_k P_k^{-1}\Big)^{-1} \sum_k q_k P_k^{-1} \mu_k,
                  \quad q_k \propto w_k N(x; \mu_k, P_k)

        climbs until x stays; places that are one are told once. In some mixtures of several
        dimensions there are modes that no mean leads to.

        Raises
        ------
        ModelError
            If the mixture has axes of runs: ask one of them, ``mixture[3].modes()``.
        NumericalError
            If a covariance is singular.

        References
        ----------
        Carreira-Perpiñán, Mode-finding for mixtures of Gaussian distributions, 2000.

        Examples
        --------
        >>> x = pgm.Variable("x")
        >>> found = pgm.GaussianMixture([0.25, 0.75], pgm.Gaussian(x, [[0.0], [4.0]], [[1.0]]))
        >>> found.modes().round(3)
        array([[4.   ],
               [0.004]])
        """
        if self.lead:
            raise ModelError(
                f"{self._title} has axes of runs; ask one of them for its modes, mixture[0].modes()"
            )
        some = self.weights > 0.0
        log_weights, parts = np.log(self.weights[some]), self.components[some]
        lower = roots.root(parts.cov)
        if roots.determined(lower).any():
            raise NumericalError(f"{self._title}: no modes, since a covariance is singular")
        white = solve_lower(lower, np.broadcast_to(np.eye(lower.shape[-1]), lower.shape))
        information = transpose(white) @ white
        pulls = apply(information, parts.mean)
        at: Array = parts.mean.copy()
        size = at.shape[-1]
        for _ in range(CLIMBS):
            logs = parts.log_density(at[:, None, :]) + log_weights
            share = np.exp(logs - log_sum(logs, 1)[:, None])
            whole = (share @ information.reshape(len(pulls), -1)).reshape(-1, size, size)
            new = np.asarray(np.linalg.solve(whole, (share @ pulls)[..., None]))[..., 0]
            away, at = np.abs(new - at) / parts.std.min(axis=0), new
            if away.max() <= SETTLED:
                break
        order = np.argsort(-self.log_density(at), kind="stable")
        found: list[Array] = []
        for place in at[order]:
            if all(np.abs((place - other) / parts.std.min(axis=0)).max() > ONE for other in found):
                found.append(place)
        return np.array(found)

    @public
    def sample(self, size: int | tuple[int, ...] = (), *, rng: np.random.Generator | int) -> Array:
        """Draws, each of a component that is drawn by its weight.

        Parameters
        ----------
        size : int or tuple of int
            How many draws of each mixture.
        rng : numpy.random.Generator or int
            The generator of draws, or its seed.

        Returns
        -------
        ndarray
            (*size, ..., n).
        """
        shape = (*as_lengths(size, "of each mixture"), *self.weights.shape[:-1])
        generator = as_generator(rng)
        require_memory(
            math.prod(shape) * self.components.mean.shape[-1] * self.weights.shape[-1],
            f"{size} draws of {self._title}",
            "draw fewer at a time",
        )
        ends = np.cumsum(self.weights, axis=-1)[..., :-1]
        which = (generator.random(shape)[..., None] >= ends).sum(axis=-1)
        extra = shape[: len(shape) - (self.weights.ndim - 1)]
        drawn = self.components.sample(extra, rng=generator)
        return np.take_along_axis(drawn, which[..., None, None], axis=-2)[..., 0, :]

    def __getitem__(self, index: Any) -> GaussianMixture:
        """Some of the mixtures, by their places along the leading axes, of runs and steps."""
        weights, mean, cov = self.weights, self.components.mean, self.components.cov
        steps = self.steps
        for axis, item in reversed(list(enumerate(lead_index(index, self.lead, self)))):
            at = (slice(None),) * axis + (item,)
            weights, mean, cov = weights[at], mean[at], cov[at]
            if axis == len(self.lead) - 1 and steps is not None:
                steps = None if isinstance(item, int) else steps[item]
        return self._make(weights, Gaussian._make(self.scope, mean, cov), steps)

    __iter__ = None  # else Python would go through places until one is refused

    @property
    def lead(self) -> tuple[int, ...]:
        """The leading axes: of runs, and of steps where `steps` says so."""
        return self.weights.shape[:-1]

    @property
    def _title(self) -> str:
        names = ", ".join(map(repr, self.scope))
        count, unused = self.weights.shape[-1], 0
        if not self.lead:
            unused = count - np.count_nonzero(self.weights)
        idle = f", {unused} of no weight" if unused else ""
        return f"GaussianMixture({names}: {count} Gaussians{idle}){axes(self.lead, self.steps)}"

    def _summary(self) -> Summary:
        if self.lead or self.weights.shape[-1] == 1:
            found = self.gaussian()._summary()
            alone = self.weights.shape[-1] == 1
            return found if alone else Summary(self._title, found.parts)
        heads = distinct_labels(self.scope)
        order = np.argsort(-self.weights, kind="stable")[: np.count_nonzero(self.weights)]
        rows: list[Any] = [["all", "1", *_shown(self.mean, self.std)]]
        std = self.components.std
        for k in few(order.size, SHOWN):
            if k is None:
                rows.append(None)
                continue
            own = order[k]
            weight = number(float(self.weights[own]))
            rows.append([str(own), weight, *_shown(self.components.mean[own], std[own])])
        return Summary(self._title, [Listing(["", "weight", *heads], rows)])


def _shown(mean: Array, std: Array) -> list[str]:
    pairs = zip(mean.tolist(), std.tolist(), strict=True)
    return [f"{number(middle)} ± {number(width)}" for middle, width in pairs]
