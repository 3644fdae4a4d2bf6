"""Errors against the truth, angles wrapped."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from pgm.errors import ModelError
from pgm.factors import Gaussian
from pgm.kernels.angles import difference
from pgm.kernels.arrays import Array, Integers


def error(belief: Gaussian, truth: npt.ArrayLike) -> Array:
    """Mean less truth, (..., n), angles wrapped to [−π, π).

    Raises
    ------
    ModelError
        If the truth has another number of components than the belief, or leading axes that do
        not fit its own.
    """
    values = np.asarray(truth, dtype=float)
    fault = f"a truth of shape {values.shape} for a belief with means of shape {belief.mean.shape}"
    if values.shape[-1:] != belief.mean.shape[-1:]:
        raise ModelError(f"{fault}; the last axes must agree")
    try:
        return difference(belief.mean, values, belief.angles)
    except ValueError:
        raise ModelError(f"{fault}; the leading axes, of runs and steps, must agree") from None


def places(belief: Gaussian, components: Sequence[str]) -> Integers:
    """Where the components named stand in the stacked vector; all of them, where none is named."""
    labels = [label for variable in belief.scope for label in variable.components]
    if isinstance(components, str):
        raise ModelError(f"components are a tuple of names, not {components!r} alone")
    if lost := [label for label in components if labels.count(label) != 1]:
        raise ModelError(f"the belief has components {labels}, not {lost}")
    found = [labels.index(label) for label in components] if components else range(len(labels))
    return np.array(found, dtype=np.intp)


def size(belief: Gaussian, truth: npt.ArrayLike, components: Sequence[str] = ()) -> Array:
    """The length of the error, (...), over the components named, or over all."""
    errors = error(belief, truth)[..., places(belief, components)]
    return np.asarray(np.sqrt(np.sum(errors**2, axis=-1)))


def rmse(belief: Gaussian, truth: npt.ArrayLike, components: Sequence[str] = ()) -> float:
    """Root mean square error over all runs and steps.

    √ of the mean of Σ e², the sum taken over the components named, or over all.
    """
    return float(np.sqrt(np.mean(size(belief, truth, components) ** 2)))
