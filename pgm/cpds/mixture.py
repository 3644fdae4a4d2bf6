"""Mixtures of CPDs, and CPDs mixed over several values of a parent."""

from __future__ import annotations

import copy
from collections.abc import Iterable
from typing import Any, Self, TypeVar

import numpy as np
import numpy.typing as npt

from pgm.arguments import public
from pgm.boundary import as_floats, as_tuple
from pgm.cpds import by_step
from pgm.cpds.base import CPD, Known, Moved, Values, of_case
from pgm.cpds.conditional import ConditionalGaussian, Noise
from pgm.cpds.gaussian import GaussianCPD
from pgm.display import Listing, few, number
from pgm.errors import ModelError
from pgm.factors.arrays import Shape, clash, unflat
from pgm.factors.scope import Scope
from pgm.kernels import mahalanobis, roots
from pgm.kernels.arrays import Array, Integers, frozen
from pgm.kernels.semirings import log_sum
from pgm.variables import Variable

# Weights whose sum is this far from one are those of no mixture.
_ROUNDING = 1e-9


@public
class MixtureCPD(CPD):
    r"""A weighted sum of densities of one child, p(y | x) = Σ_k w_k p_k(y | x).

    .. math:: p(y \mid x) = \sum_k w_k \, p_k(y \mid x)

    - p_k: the CPDs of the mixture, each with parents of its own;
    - w_k: their probabilities, the same whatever the parents are.

    Outliers of a sensor, wheels that slip, a robot that may have been carried away. Over time, with
    Gaussian components, beliefs are mixtures of Gaussians (`Gaussians`), of one unless ``belief=``
    asks for more; or any, with ``belief=pgm.Particles(...)`` or ``pgm.Grid(...)``. In networks
    without time they are mixtures of all configurations, as of a `SwitchingCPD`.

    Parameters
    ----------
    components : sequence of CPD
        CPDs of the same continuous child y: Gaussian ones, without infinite variance, a
        `SampledCPD`, mixtures; `parts` has them. Its parents are all of theirs, in the order in
        which they come first.
    weights : array_like
        (K,): w_k, positive, of sum one.

    References
    ----------
    McLachlan & Peel, Finite Mixture Models, 2000.

    Examples
    --------
    >>> from pgm import LinearGaussianCPD, Variable
    >>> x, z = Variable("x"), Variable("z")
    >>> seldom_wrong = MixtureCPD(
    ...     [LinearGaussianCPD(z, {x: 1.0}, cov=0.01), LinearGaussianCPD(z, {x: 1.0}, cov=9.0)],
    ...     weights=[0.95, 0.05],
    ... )
    >>> seldom_wrong.log_density([[0.1], [3.0]], {x: 0.0}).round(3)
    array([ 0.835, -5.513])
    """

    parts: tuple[CPD, ...]
    weights: Array

    def __init__(self, components: Iterable[CPD], weights: npt.ArrayLike) -> None:
        parts = (components,) if isinstance(components, CPD) else as_tuple(components)
        if not parts:
            raise ModelError(f"a mixture is of one CPD or more; found {components!r}")
        for part in parts:
            if not isinstance(part, CPD) or part.discrete:
                raise ModelError(f"a mixture is of CPDs of continuous variables; found {part!r}")
            if part.child != parts[0].child:
                raise ModelError(
                    f"a mixture is of CPDs of one child; found {parts[0]!r} and {part!r}",
                    variable=part.child,
                    cpd=part,
                )
            part.require_proper("a mixture weighs densities, and a flat one has none")
        noise = tuple(dict.fromkeys(v for part in parts for v in part.noise_given))
        self._set_scope(
            parts[0].child, tuple(dict.fromkeys(v for part in parts for v in part.given)), noise
        )
        self._set(parts=parts, weights=frozen(self._checked(weights, len(parts))))
        self._set(partial=all(part.partial for part in parts))
        changing = by_step.among(parts)
        if changing is not None:
            self._set(steps=changing.steps)
        self._lead()

    def _checked(self, weights: npt.ArrayLike, count: int) -> Array:
        found = as_floats(weights, "the weights of a mixture", cpd=self)
        if found.shape != (count,):
            raise ModelError(
                f"a mixture of {count} CPDs of {self.child!r} has {count} weights; found an array "
                f"of shape {found.shape}",
                variable=self.child,
                cpd=self,
            )
        total = float(found.sum())
        if not (found > 0.0).all() or not abs(total - 1.0) <= _ROUNDING:
            raise ModelError(
                f"the weights of a mixture of CPDs of {self.child!r} are positive, and their sum "
                f"is one; found {found.tolist()}, of sum {total:.12g}: leave out what has no "
                "weight, and divide by the sum",
                variable=self.child,
                cpd=self,
            )
        return found

    def _parts(self) -> list[str | Listing]:
        each = zip(self.weights, self.parts, strict=True)
        rows = [(part._title, number(weight)) for weight, part in each]
        return [Listing(("", "weight"), [None if k is None else rows[k] for k in few(len(rows))])]

    @property
    def noise_given(self) -> Scope:
        """The parents that a noise covariance depends on."""
        return tuple(dict.fromkeys(v for part in self.parts for v in part.noise_given))

    def require_proper(self, what: str) -> None:
        """Refuse an infinite variance, of which a mixture has none."""

    def _held(self, step: int) -> Self:
        if self.steps is None:
            return self
        found = self._with(tuple(part._held(step) for part in self.parts))
        found._set(steps=None, _origin=self.origin)
        return found

    def _with(self, parts: tuple[CPD, ...]) -> Self:
        found = copy.copy(self)
        found._set(parts=parts)
        return found

    def _lead(self) -> Shape:
        shapes = [(part, part._lead()) for part in self.parts]
        try:
            return np.broadcast_shapes(*(shape for _, shape in shapes))
        except ValueError:
            raise ModelError(
                f"{self!r}: its CPDs have axes of runs that do not broadcast: {clash(shapes)}; "
                "give each the same",
                variable=self.child,
                cpd=self,
            ) from None

    def _log_density(self, child: Values, known: Known) -> Array:
        terms = [part._log_density(child, _of(part, known)) for part in self.parts]
        return log_mixed(self.weights, np.broadcast_arrays(*terms))

    def _draw(self, known: Known, rng: np.random.Generator, size: tuple[int, ...] = ()) -> Values:
        shape = (*size, *known.shape)
        which = chosen(self.weights, shape, rng)
        drawn = np.empty((*shape, self.child.dimension))
        for k, part in enumerate(self.parts):
            rows = which == k
            if not rows.any():
                continue
            if part._lead():  # each of its runs has a law of its own
                drawn[rows] = part._draw(_of(part, known), rng, size)[rows]
                continue
            own, count = {}, (int(rows.sum()),)
            for parent in part.parents:
                value = known.values[parent]
                own[parent] = np.broadcast_to(value, (*shape, value.shape[-1]))[rows]
            step = known.step
            if step is not None and np.ndim(step):
                step = np.broadcast_to(np.asarray(step), shape)[rows]
            by = of_case(rng, k, np.flatnonzero(rows))
            drawn[rows] = part._draw(Known(own, count, count, step), by)
        return drawn

    def _over(self, moved: Moved) -> dict[str, Any]:
        parts = tuple(part._copy(moved, _origin=part.origin) for part in self.parts)
        return super()._over(moved) | {"parts": parts}


def _of(part: CPD, known: Known) -> Known:
    return Known({v: known.values[v] for v in part.parents}, known.lead, known.shape, known.step)


def chosen(weights: Array, shape: tuple[int, ...], rng: np.random.Generator) -> Integers:
    """The CPD of a mixture that holds, for each of some draws."""
    found: Integers = np.searchsorted(np.cumsum(weights)[:-1], rng.random(shape), side="right")
    return found


def log_mixed(weights: Array, terms: Iterable[Array]) -> Array:
    """Log-density ln Σ_k w_k e^{t_k} of log-densities t_k; −∞ where all t_k are −∞."""
    stacked = np.stack([np.log(w) + t for w, t in zip(weights, terms, strict=True)])
    found: Array = np.logaddexp.reduce(stacked, axis=0)
    return found


class UnidentifiedCPD(CPD):
    """A sensor's CPD without one of its parents, which is one of some candidates, or none.

    `candidates` are (k, d), `log_shares` (k,) their log-probabilities; `log_outliers` (2,) the
    log-densities of spurious and of new sightings, with their probabilities. Without `summed` the
    likeliest term alone counts.
    """

    sensor: CPD
    parent: Variable
    candidates: Array
    log_shares: Array
    log_outliers: Array
    gate: float | None
    summed: bool

    def __init__(
        self,
        sensor: CPD,
        parent: Variable,
        candidates: Array,
        log_shares: Array,
        log_outliers: Array,
        gate: float | None,
        summed: bool,
    ) -> None:
        self._set_scope(sensor.child, [v for v in sensor.parents if v != parent])
        if gate is not None and not isinstance(sensor, ConditionalGaussian):
            raise ModelError(
                f"{sensor!r} is no Gaussian CPD, whose residuals have no χ² distribution: leave "
                "gate= of pgm.unknown(...) out",
                variable=sensor.child,
                cpd=sensor,
            )
        gaussian = sensor if isinstance(sensor, ConditionalGaussian) else None
        constant = gaussian is not None and not isinstance(gaussian.cov, Noise)
        if gaussian is not None and constant and roots.determined(gaussian._lower).any():
            raise ModelError(
                f"{sensor!r} has no noise in a component, or two that are one: no particle and no "
                "cell need agree with its measurement; give it some",
                variable=sensor.child,
                cpd=sensor,
            )
        self._set(
            sensor=sensor,
            parent=parent,
            candidates=candidates,
            log_shares=log_shares,
            log_outliers=log_outliers,
            gate=gate,
            summed=summed,
            partial=sensor.partial,
        )

    def _log_density(self, child: Values, known: Known) -> Array:
        terms = self.terms(child, known)
        found = np.logaddexp.reduce(terms, axis=0) if self.summed else terms.max(axis=0)
        return np.where(np.isnan(child).all(axis=-1), 0.0, found)

    def responsibilities(self, child: Values, known: Known) -> Array:
        """The probability of each candidate, a spurious and a new sighting, (k + 2, ...).

        NaN where the sighting is impossible.
        """
        terms = self.terms(child, known)
        with np.errstate(invalid="ignore"):
            return np.asarray(np.exp(terms - log_sum(terms, 0)))

    def terms(self, child: Values, known: Known) -> Array:
        """The logarithms of the density's terms, (k + 2, ...), −∞ beyond the gate."""
        lead = np.broadcast_shapes(child.shape[:-1], known.lead)
        found = np.empty((len(self.candidates) + 2, *lead))
        for k, candidate in enumerate(self.candidates):
            own = np.broadcast_to(candidate, (*known.shape, candidate.size))
            each = Known({**known.values, self.parent: own}, known.lead, known.shape, known.step)
            density = self.sensor._log_density(child, each)
            if self.gate is not None:
                density = self._gated(density, child, each, self.gate)
            found[k] = density + self.log_shares[k]
        found[-2:] = self.log_outliers.reshape(-1, *[1] * len(lead))
        return found

    def _gated(self, density: Array, child: Values, known: Known, gate: float) -> Array:
        assert isinstance(self.sensor, ConditionalGaussian)
        mean, _ = self.sensor._law(known)
        seen = ~np.isnan(child)
        middle = np.where(seen, unflat(mean, known.lead, 1), np.nan)
        square = 2.0 * (self.sensor._log_density(middle, known) - density)
        limit = mahalanobis.square_within(gate, np.maximum(seen.sum(axis=-1), 1))
        return np.where(square > limit, -np.inf, density)

    def __repr__(self) -> str:
        return f"{self.sensor!r}, {self.parent!r} being one of {len(self.candidates):,}"


C = TypeVar("C", bound=CPD)


def by_run(cpd: C, lead: tuple[int, ...]) -> C:
    """A CPD with its axes of runs, if any, broadcast to the evidence's."""
    if isinstance(cpd, GaussianCPD) and cpd._lead():
        assert isinstance(cpd.cov, np.ndarray)
        size = cpd.child.dimension
        mean = np.broadcast_to(cpd.mean, (*lead, size))
        cov = np.broadcast_to(cpd.cov, (*lead, size, size))
        return GaussianCPD(cpd.child, mean, cov)  # type: ignore[return-value]
    if isinstance(cpd, MixtureCPD) and cpd._lead():
        return cpd._with(tuple(by_run(part, lead) for part in cpd.parts))
    return cpd
