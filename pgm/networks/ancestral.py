"""Ancestral sampling: drawing children given their parents, one after another."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from pgm.boundary import is_whole
from pgm.cpds import AffineCPD, ConditionalGaussian, Noise, NonlinearGaussianCPD, TableCPD
from pgm.cpds.noise import evaluate
from pgm.errors import EvidenceError, LinearisationError, ModelError
from pgm.evidence import Evidence, bind_values
from pgm.evidence.keys import unknown
from pgm.factors.scope import listed
from pgm.kernels import roots
from pgm.kernels.arrays import Array, Integers, apply
from pgm.linearisers.calls import Call
from pgm.sizes import require_memory
from pgm.variables import Variable

if TYPE_CHECKING:
    from pgm.networks.static import BayesianNetwork

# Values (runs, d), or indices of states (runs,).
Draws = npt.NDArray[Any]


def draw(
    network: BayesianNetwork,
    n: int | tuple[int, ...] | None,
    inputs: Evidence,
    rng: np.random.Generator,
) -> dict[Variable, Draws]:
    """Draw each variable of a network without time after its parents."""
    shape = _as_shape(n)
    require_memory(
        math.prod(shape) * sum(cpd.child.dimension or 1 for cpd in network.cpds),
        f"{n} draws of {len(network.cpds)} variables",
        "draw fewer at a time",
    )
    for variable in inputs:
        if variable not in network.variables:
            raise unknown(variable, network.variables)
        if variable not in network.inputs:
            raise EvidenceError(
                f"{variable!r} is no input of the network, whose inputs are "
                f"({listed(network.inputs)}); given evidence of other variables one infers, not "
                "samples",
                variable=variable,
            )
    try:
        shape = np.broadcast_shapes(shape, network.lead)
    except ValueError:
        raise ModelError(
            f"draws of shape {shape} do not broadcast with the model's axes of runs "
            f"{network.lead}; n=(1000, 1) draws a thousand for each"
        ) from None
    bound = bind_values(network.cpds, inputs, shape, network.inputs)
    lead, runs = bound.lead, bound.runs
    values: dict[Variable, Draws] = dict(bound.values)
    drawn: dict[Variable, Draws] = {}
    for cpd in network.cpds:
        parents = {v: values[v] for v in cpd.parents}
        child: Draws
        if isinstance(cpd, TableCPD):
            child = states(cpd, parents, rng, runs)
        elif isinstance(cpd, ConditionalGaussian):
            child = gaussian(cpd, parents, lead, rng, (runs,), cpd.child.step)
        else:
            raise ModelError(f"{cpd!r} is of a kind that cannot be drawn from", cpd=cpd)
        values[cpd.child] = child
        drawn[cpd.child] = child.reshape((*lead, *child.shape[1:]))
    return drawn


def _as_shape(n: Any) -> tuple[int, ...]:
    if n is None:
        return ()
    shape = n if isinstance(n, tuple) else (n,)
    for length in shape:
        if not is_whole(length) or length < 1:
            raise ModelError(f"n is the number of draws, 1 or more, or a tuple of such; not {n!r}")
    return tuple(map(int, shape))


def gaussian(
    cpd: ConditionalGaussian,
    values: Mapping[Variable, Array],
    lead: tuple[int, ...],
    rng: np.random.Generator,
    shape: tuple[int, ...],
    step: npt.ArrayLike | None,
) -> Array:
    """Continuous children, (*shape, d), where the last axis of the shape are the runs, flattened.

    Parameters
    ----------
    cpd : ConditionalGaussian
    values : mapping of Variable to ndarray
        Of all parents; they broadcast to (*shape, d).
    lead : tuple of int
        The axes of runs before they were flattened.
    step : array_like of int or None
        The step of each, which broadcasts to the shape; for messages.
    """
    cpd.require_proper("there is no drawing from it")
    steps = None if step is None else np.asarray(step)
    wide = {v: np.broadcast_to(a, (*shape, a.shape[-1])) for v, a in values.items()}
    due = (*shape, cpd.child.dimension)
    call = Call(cpd.child, "function", shape, steps, 0, cpd)
    if isinstance(cpd, NonlinearGaussianCPD):
        with np.errstate(all="ignore"):  # non-finite values are refused below
            mean = call(cpd.function, [wide[v] for v in cpd.given], due)
    elif isinstance(cpd, AffineCPD):
        mean = cpd._affine((), wide)[1]
        mean = np.broadcast_to(mean if cpd.given else _by_run(mean, lead, 1), due)
    if not np.isfinite(mean).all():
        index = tuple(int(k) for k in np.argwhere(~np.isfinite(mean))[0, :-1])
        raise call.error("has values that are NaN or infinite", index, kind=LinearisationError)
    if isinstance(cpd.cov, Noise):
        cov = evaluate(cpd, wide, shape, steps)
    else:
        cov = _by_run(cpd.cov, lead, 2)
    return mean + apply(roots.root(cov), rng.standard_normal(due))


def states(
    cpd: TableCPD, parents: Mapping[Variable, Integers], rng: np.random.Generator, runs: int
) -> Integers:
    """Indices of states of discrete children, (runs,); one of probability zero is never drawn."""
    cumulative = np.cumsum(cpd.table, axis=-1)
    row = tuple(parents[v] for v in cpd.given)
    # A uniform below one, times the last sum, stays below it, so that what rounding leaves of the
    # sum from one goes to no state of its own.
    level = rng.random(runs) * cumulative[(*row, -1)]
    # The first state whose cumulative sum exceeds the level, by bisection: all draws at once in
    # memory of their number alone.
    low, high = np.zeros(runs, dtype=np.intp), np.full(runs, cumulative.shape[-1] - 1)
    for _ in range((cumulative.shape[-1] - 1).bit_length()):
        middle = (low + high) // 2
        above = cumulative[(*row, middle)] > level
        low, high = np.where(above, low, middle + 1), np.where(above, middle, high)
    return low


def _by_run(array: Array, lead: tuple[int, ...], axes: int) -> Array:
    """A parameter with its axes of runs, if it has any, as one."""
    if array.ndim == axes:
        return array
    rest = array.shape[-axes:]
    return np.broadcast_to(array, (*lead, *rest)).reshape((math.prod(lead), *rest))
