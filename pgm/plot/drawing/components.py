"""The components of a belief to draw, and the columns of a truth that go with them."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from pgm.consistency.errors import check_gaussian
from pgm.display import titled
from pgm.errors import ModelError
from pgm.evidence.degrees import in_degrees
from pgm.factors import Gaussian, GaussianMixture
from pgm.factors.scope import labels, names
from pgm.inference import PointMixture
from pgm.kernels.arrays import Array


def as_gaussian(belief: Any) -> Gaussian:
    """A belief as a Gaussian; particles and mixtures by their moments; others are refused."""
    drawn = getattr(belief, "states", None) is not None
    moments = drawn or isinstance(belief, GaussianMixture | PointMixture)
    return belief.gaussian() if moments else check_gaussian(belief)


def one_run(belief: Any) -> Gaussian:
    """The belief with one leading axis, of steps; refuses several runs."""
    belief = as_gaussian(belief)
    lead = belief.mean.shape[: -1 if belief.steps is None else -2]
    if math.prod(lead) != 1:
        hint = " (or give steps= if they are steps)" if belief.steps is None else ""
        raise ModelError(
            f"{titled(belief)} has the leading axes {lead}, which are {math.prod(lead)} "
            f"runs{hint}; pick one with .run(0)",
            variable=belief.scope[0],
        )
    size = belief.mean.shape[-1]
    return Gaussian._make(
        belief.scope,
        belief.mean.reshape(-1, size),
        belief.cov.reshape(-1, size, size),
        belief.steps,
    )


def component_places(belief: Gaussian, components: Sequence[str]) -> list[int]:
    """The places of components in the stacked vector."""
    if isinstance(components, str):
        raise ModelError(f"components must be a sequence of names, not {components!r} alone")
    known = labels(belief.scope)
    for name in components:
        if known.count(name) != 1:
            raise ModelError(
                f"{names(belief.scope)} has no single component {name!r}; it has {list(known)}"
            )
    return [known.index(name) for name in components]


def truth_columns(belief: Gaussian, truth: npt.ArrayLike, places: Sequence[int]) -> Array:
    """The components of a truth that stand at some places of the belief's vector.

    truth: (..., rows, k), its columns the belief's components in order; columns that are not drawn
        may be missing at the end.
    """
    array = np.asarray(truth, dtype=float)
    array = array[None] if array.ndim == 1 else array
    needed = max(places) + 1
    if array.ndim < 2 or array.shape[-1] < needed:
        raise ModelError(
            f"the truth has shape {array.shape}; (..., steps, components) was due, at least "
            f"{needed} of them, in the order {list(labels(belief.scope))}"
        )
    found: Array = array[..., list(places)]
    known = labels(belief.scope)
    drawn, angles = [known[k] for k in places], [known[k] for k in places if belief.angles[k]]
    if odd := in_degrees(found, drawn, angles):
        raise ModelError(f"the truth of {names(belief.scope)}: {odd}")
    return found
