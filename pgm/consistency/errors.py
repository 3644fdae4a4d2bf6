"""Errors against the truth, angles wrapped."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from pgm.boundary import as_floats, as_tuple
from pgm.consistency.checks import check_gaussian
from pgm.errors import ModelError
from pgm.factors import Gaussian
from pgm.factors.scope import labels, names
from pgm.kernels.angles import difference
from pgm.kernels.arrays import Array, Integers


def error(belief: Gaussian, truth: npt.ArrayLike) -> Array:
    """Mean less truth, (..., n), angles wrapped to [−π, π); NaN where the truth is not known.

    A truth has the steps of the belief. Its runs are the belief's, or it is one truth that all of
    them had; several truths against one belief are refused, since statistics would count them as
    runs that were each estimated.

    Parameters
    ----------
    belief : Gaussian
        (*runs, T+1, n), as ``posterior[x]``; without steps, all its leading axes are runs.
    truth : array_like
        (*runs, T+1, n), or without the axes of runs; NaN in components that are not known.

    Raises
    ------
    ModelError
        If the belief is no Gaussian, the axes do not fit, or a value is infinite.
    """
    shape = check_gaussian(belief).mean.shape
    values = as_floats(truth, "a truth", labels=labels(belief.scope))
    what = (
        f"a truth of shape {values.shape} for the belief over {names(belief.scope)} with means of "
        f"shape {shape}"
    )
    if values.shape[-1:] != shape[-1:]:
        raise ModelError(f"{what}; the last axes, of components, must agree")
    if belief.steps is not None and values.shape[-2:] != shape[-2:]:
        raise ModelError(
            f"{what}; the axes before the last, of steps, must agree: give the truth at each of "
            f"its {belief.steps.size} steps, belief.steps"
        )
    try:
        spread = np.broadcast_to(values, shape)
    except ValueError:
        raise ModelError(
            f"{what}; the leading axes, of runs, must agree: give as many truths as the belief has "
            "runs, or one for all of them"
        ) from None
    if lost := int(np.isinf(values).sum()):
        *at, component = np.argwhere(np.isinf(spread))[0]
        raise ModelError(
            f"{what} has infinite values ({lost} of {values.size}), the first of "
            f"{labels(belief.scope)[component]}{place(belief, tuple(at))}; a truth that is not "
            "known is NaN"
        )
    return difference(belief.mean, spread, belief.angles)


def place(belief: Gaussian, index: tuple[int, ...]) -> str:
    """Where one of the Gaussians stands, in words; nothing where there is but one."""
    words = []
    run = index if belief.steps is None else index[:-1]
    if run:
        words.append(f"run {', '.join(map(str, run))}")
    if belief.steps is not None:
        words.append(f"step {belief.steps[index[-1]]}")
    return f" at {', '.join(words)}" if words else ""


def places(belief: Gaussian, components: Sequence[str]) -> Integers:
    """Where the components named stand in the stacked vector; all of them, where none is named."""
    known = labels(check_gaussian(belief).scope)
    named = as_tuple(components)
    if named is None:
        raise ModelError(f"components are a tuple of names, not {components!r} alone")
    components = named
    if lost := [label for label in components if known.count(label) != 1]:
        raise ModelError(f"the belief has components {list(known)}, not {lost}")
    if len(set(components)) < len(components):
        raise ModelError(f"components are {tuple(components)}; name each of them once")
    found = [known.index(label) for label in components] if components else range(len(known))
    return np.array(found, dtype=np.intp)


def size(belief: Gaussian, truth: npt.ArrayLike, components: Sequence[str] = ()) -> Array:
    """The length of the error over the components named, or over all, (...).

    NaN where the truth of one of them is not known.
    """
    errors = error(belief, truth)[..., places(belief, components)]
    return np.asarray(np.sqrt(np.sum(errors**2, axis=-1)))


def rmse(belief: Gaussian, truth: npt.ArrayLike, components: Sequence[str] = ()) -> float:
    """Root mean square error over all runs and steps.

    √ of the mean of Σ e², the sum taken over the components named, or over all, the mean over the
    runs and steps at which the truth of all these is known.

    Parameters
    ----------
    belief : Gaussian
        As ``posterior[x]``.
    truth : array_like
        (..., n), its leading axes as `error` asks for.
    components : sequence of str
        Over which the error's length is taken; all without.

    Raises
    ------
    ModelError
        If the truth or a component does not fit the belief, or none is known.
    """
    lengths = size(belief, truth, components)
    known = ~np.isnan(lengths)
    if not known.any():
        raise nothing_known(belief, components)
    return float(np.sqrt(np.mean(lengths[known] ** 2)))


def nothing_known(belief: Gaussian, components: Sequence[str]) -> ModelError:
    """The error of a truth that is NaN wherever it is needed."""
    wanted = ", ".join(components or labels(belief.scope))
    return ModelError(
        f"no truth of {names(belief.scope)} is known, at any run or step, in ({wanted}); name "
        "components that are, with components=(...)"
    )
