"""CPDs that are given by a sampler and a density."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import numpy as np

from pgm.arguments import public
from pgm.cpds.base import CPD, Known, Values
from pgm.display import Listing, called
from pgm.errors import LinearisationError, ModelError
from pgm.kernels.arrays import Array
from pgm.linearisers.calls import Call
from pgm.variables import Variable


@public
class SampledCPD(CPD):
    """Any density of a continuous child, by a sampler, a log-density, or both.

    Networks that have one take ``belief=pgm.Particles(...)``: states are drawn from their
    transition, and weighed by the density of their sensors; or ``belief=pgm.Grid(...)``, which
    asks for the densities of all.

    Parameters
    ----------
    child : Variable
        y, d components.
    given : Variable or sequence of Variable
        The parents, in the order of the functions' arguments.
    sample : callable, optional
        ``sample(*given, size=, rng=)``: draws (*size, d) from arrays (*size, dimension of parent),
        `size` a tuple and `rng` a `numpy.random.Generator`. Without, it cannot be drawn from.
    log_density : callable, optional
        ``log_density(child, *given)``: ln p in nats, (...), from arrays (..., dimension) with equal
        leading axes; −∞ where a value is impossible. Without, it cannot be a sensor, nor the
        transition of a smoother, nor stand on a grid.

    Examples
    --------
    >>> x = Variable("x")
    >>> jump = SampledCPD(
    ...     x,
    ...     given=x.previous,
    ...     sample=lambda x, size, rng: x + rng.laplace(scale=0.1, size=(*size, 1)),
    ...     log_density=lambda y, x: -10.0 * np.abs(y - x)[..., 0] + np.log(5.0),
    ... )
    >>> jump.log_density(0.1, {x.previous: 0.0}).round(3)
    np.float64(0.609)
    """

    sampler: Callable[..., Any] | None
    density: Callable[..., Any] | None

    def __init__(
        self,
        child: Variable,
        given: Variable | Iterable[Variable] = (),
        *,
        sample: Callable[..., Any] | None = None,
        log_density: Callable[..., Any] | None = None,
    ) -> None:
        self._set_scope(child, given)
        if sample is None and log_density is None:
            raise ModelError(
                f"{self!r}: give sample= to draw from it, log_density= to weigh by it, or both",
                variable=child,
                cpd=self,
            )
        for name, function in (("sample", sample), ("log_density", log_density)):
            if function is not None and not callable(function):
                raise ModelError(f"{self!r}: {name} must be callable, not {function!r}", cpd=self)
        self._set(sampler=sample, density=log_density)

    def _parts(self) -> list[str | Listing]:
        each = (("drawn by", self.sampler), ("log-density", self.density))
        return [f"{what}: {called(function)}" for what, function in each if function is not None]

    def _draw(self, known: Known, rng: np.random.Generator, size: tuple[int, ...] = ()) -> Values:
        if self.sampler is None:
            raise ModelError(
                f"{self!r} cannot be drawn from: give it sample=", variable=self.child, cpd=self
            )
        shape = (*size, *known.shape)
        call = self._call("sampler", shape, known)
        sampler, arguments = self.sampler, self._wide(known, shape)
        try:
            drawn = sampler(*arguments, size=shape, rng=rng)
        except Exception as error:
            reason = call.reason(sampler, arguments, error, None)
            raise call.error(f"failed: {reason}") from error
        found = call.array(sampler, arguments, drawn, (*shape, self.child.dimension))
        self._require(
            np.isfinite(found).all(axis=-1), call, "draws values that are NaN or infinite"
        )
        return found

    def _log_density(self, child: Values, known: Known) -> Array:
        if self.density is None:
            raise ModelError(
                f"{self!r} has no density: give it log_density=", variable=self.child, cpd=self
            )
        lead = np.broadcast_shapes(child.shape[:-1], known.lead)
        call = self._call("log-density", lead, known)
        wide = np.broadcast_to(child, (*lead, child.shape[-1]))
        density, arguments = self.density, [wide, *self._wide(known, lead, known.lead)]
        try:
            value = density(*arguments)
        except Exception as error:
            reason = call.reason(density, arguments, error, lead)
            raise call.error(f"failed: {reason}") from error
        found = call.array(density, arguments, value, lead)
        fine = ~(np.isnan(found) | (found == np.inf))
        self._require(fine, call, "has values that are NaN or plus infinity")
        return found

    def _call(self, what: str, lead: tuple[int, ...], known: Known) -> Call:
        step = None if known.step is None else np.asarray(known.step)
        return Call(self.child, what, lead, step, None, self)

    def _wide(
        self, known: Known, shape: tuple[int, ...], lead: tuple[int, ...] | None = None
    ) -> list[Values]:
        found = []
        for parent in self.given:
            value = known.values[parent]
            if lead is not None and value.shape[:-1] == known.shape:
                value = value.reshape(*lead, value.shape[-1])
            found.append(np.broadcast_to(value, (*shape, value.shape[-1])))
        return found

    def _require(self, fine: Any, call: Call, fault: str) -> None:
        if not fine.all():
            raise call.error(fault, kind=LinearisationError)
