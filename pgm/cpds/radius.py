"""The radius of draws from a robust density, by quadrature: its distribution, and its integral.

What is found of a noise by integrals is `kept` for noises of equal parameters.
"""

from __future__ import annotations

import pickle
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import lru_cache, wraps
from math import log, pi, sqrt
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

import numpy as np

from pgm.errors import ModelError
from pgm.kernels.arrays import Array, Mask

if TYPE_CHECKING:
    from pgm.cpds.robust import RobustNoise

Found = TypeVar("Found")

# Radii are looked for between e^{−345} and e^{345}, whose squares are float64's; the nodes of the
# search are no further apart than this, nor than this share of the narrowest peak's deviation.
_FURTHEST, _APART, _SHARE = 345.0, 0.05, 0.25
# Of an integrand e^{g} what lies below its top by so much in g is left out; at the ends of all
# radii it has to lie this much below, or there is more beyond.
_LEFT_OUT, _ENDS = 45.0, 25.0
_NODES = 2**14


@dataclass(frozen=True)
class _Stated:
    """A noise as it stands: equal to others of its class whose attributes are the same."""

    kind: type
    state: bytes
    noise: RobustNoise = field(compare=False)


def kept(function: Callable[[Any, int], Found]) -> Callable[[Any, int], Found]:
    """The same function of a noise and a size, whose results are kept.

    A noise that is a value, as a frozen dataclass is, is known by that. Any other is known by its
    attributes as they are at the call, so that one that was changed is another; and where these
    cannot be written down, nothing is kept.
    """
    by_value = lru_cache(maxsize=256)(function)
    by_state = lru_cache(maxsize=256)(lambda stated, size: function(stated.noise, size))

    @wraps(function)
    def found(noise: Any, size: int) -> Found:
        if _is_value(noise):
            return by_value(noise, size)
        try:
            state = pickle.dumps(noise.__getstate__())
        except Exception:  # of any kind, by attributes that are no values, such as a lambda
            return function(noise, size)
        return by_state(_Stated(type(noise), state, noise), size)

    return found


def _is_value(noise: Any) -> bool:
    """Whether a noise is equal to others of the same parameters, and has a hash of these."""
    kind: Any = type(noise)
    if kind.__hash__ is None or kind.__hash__ is object.__hash__:
        return False
    try:
        hash(noise)
    except TypeError:  # a frozen dataclass with an array
        return False
    return True


class Radius(NamedTuple):
    """The radius of draws from a robust density with covariance parameter I, by quadrature.

    logs: Logarithms of radii r, (N,), evenly spaced.
    within, beyond: The shares of the density within each, and beyond, (N,).
    log_integral: ln ∫ e^{−ρ(rᵀr)} dr over all residuals r.
    size: Their number of components, d.
    """

    logs: Array
    within: Array
    beyond: Array
    log_integral: float
    size: int

    @staticmethod
    def of(noise: RobustNoise, size: int) -> Radius:
        """The radius of a noise's residuals of `size` components.

        The integrand over t = ln r is e^{g(t)}, g = d t − ρ(e^{2t}), times the sphere's surface; it
        falls off at both ends, so that sums at even steps converge faster than any power of the
        step. Where it lies depends on the loss: all radii are searched. A loss concave in the
        square has g'' ≥ −2 d at a maximum, so that no peak is narrower than 1 / √(2d).
        """
        return _radius(noise, size)

    def moved(self, radius: Array) -> Array:
        """The radii (...) within which lies as much of the density as within those of a Gaussian.

        The shares nearer to 1 than to 0 are compared by what lies beyond.
        """
        from scipy.special import chdtr, chdtrc  # here, since they are slow to import

        beyond = chdtrc(self.size, radius**2)
        near = np.interp(chdtr(self.size, radius**2), self.within, self.logs)
        far = np.interp(-beyond, -self.beyond, self.logs)
        found: Array = np.exp(np.where(beyond < 0.5, far, near))
        return found


@kept
def _radius(noise: RobustNoise, size: int) -> Radius:
    from scipy.special import gammaln  # here, since it is slow to import

    narrowest = 1.0 / sqrt(2.0 * size)
    first, last = _window(noise, size, min(_APART, _SHARE * narrowest))
    count = max(_NODES, int(8.0 * (last - first) / narrowest))
    logs = np.linspace(first, last, count)
    exponent = _exponent(noise, size, logs)
    top = float(exponent.max())
    parts = np.exp(exponent - top)
    surface = log(2.0) + 0.5 * size * log(pi) - float(gammaln(0.5 * size))
    total = float(parts.sum())
    parts /= total
    within = np.cumsum(parts) - 0.5 * parts
    beyond = np.cumsum(parts[::-1])[::-1] - 0.5 * parts
    step = float(logs[1] - logs[0])
    return Radius(logs, within, beyond, surface + top + log(total * step), size)


def _window(noise: RobustNoise, size: int, apart: float) -> tuple[float, float]:
    """The logarithms of the radii between which the density lies; a ModelError if not found."""
    logs = np.linspace(-_FURTHEST, _FURTHEST, int(2.0 * _FURTHEST / apart) + 1)
    exponent = _exponent(noise, size, logs)
    top = float(exponent.max())
    within: Mask = exponent > top - _LEFT_OUT
    if not np.isfinite(top) or max(exponent[0], exponent[-1]) >= top - _ENDS:
        raise ModelError(
            f"{noise!r} of {size} components: no finite integral of its density was found, between "
            f"radii of {np.exp(-_FURTHEST):.0e} and {np.exp(_FURTHEST):.0e} standard deviations; "
            f"let is_proper({size}) be False if it has none"
        )
    (places,) = np.nonzero(within)
    ends = max(places[0] - 1, 0), min(places[-1] + 1, len(logs) - 1)
    return float(logs[ends[0]]), float(logs[ends[1]])


def _exponent(noise: RobustNoise, size: int, logs: Array) -> Array:
    """The exponents g(t) = d t − ρ(e^{2t}) at logarithms of radii, (N,)."""
    with np.errstate(all="ignore"):  # a loss too large for float64 is infinite
        loss = np.asarray(noise.loss(np.exp(2.0 * logs), np.full(logs.shape, size)), float)
    bad = np.isnan(loss)
    if loss.shape != logs.shape or bad.any():
        what = f"of shape {loss.shape}"
        if loss.shape == logs.shape:
            what = f"NaN at a square of {np.exp(2.0 * logs[bad.argmax()]):.3g}"
        raise ModelError(
            f"{noise!r}: the loss of {len(logs)} squares from 1e-300 to 1e300 is {what}; as many "
            "numbers were due, or infinity"
        )
    found: Array = size * logs - loss
    return found
