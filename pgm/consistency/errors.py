"""Errors against the truth, angles wrapped; measured by covariances; divergences of beliefs."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from pgm.arguments import public
from pgm.boundary import as_floats, as_tuple, is_whole
from pgm.display import titled
from pgm.errors import ModelError, NumericalError
from pgm.evidence.degrees import in_degrees
from pgm.factors import Gaussian
from pgm.factors.scope import labels, names
from pgm.inference import Innovations
from pgm.kernels import roots, solving
from pgm.kernels.angles import difference
from pgm.kernels.arrays import Array, Integers, Mask, block, independent, inner


def check_gaussian(belief: Any) -> Gaussian:
    """The Gaussian; refuses anything else."""
    if not isinstance(belief, Gaussian) and hasattr(belief, "gaussian"):
        raise ModelError(
            f"a belief is a Gaussian, not {titled(belief)}; belief.gaussian() has its mean and "
            "covariance"
        )
    if not isinstance(belief, Gaussian):
        remedy = "take the marginal of one variable first"
        if hasattr(belief, "mean") and hasattr(belief, "cov"):
            remedy = "pgm.Gaussian(x, found.mean, found.cov, steps=range(T + 1)) has its moments"
        raise ModelError(
            f"a belief is a Gaussian, like posterior[x], not {type(belief).__name__}; {remedy}"
        )
    return belief


def check_innovations(innovations: Any) -> Innovations:
    """The innovations; refuses anything else."""
    if not isinstance(innovations, Innovations):
        raise ModelError(
            "innovations are those of one sensor, posterior.innovations[z], not "
            f"{type(innovations).__name__}"
        )
    return innovations


def check_confidence(confidence: npt.ArrayLike) -> Array:
    """Check confidences, (...): probabilities strictly between 0 and 1."""
    values = as_floats(confidence, "a confidence")
    if not ((values > 0.0) & (values < 1.0)).all():
        raise ModelError(f"a confidence lies between 0 and 1; {confidence!r} does not")
    return values


def check_count(what: str, value: Any) -> None:
    """Check a whole number of 1 or more."""
    if not is_whole(value) or value < 1:
        raise ModelError(f"{what} = {value!r}; a whole number, 1 or more, was due")


@public
def error(belief: Gaussian, truth: npt.ArrayLike) -> Array:
    """Mean less truth, (*runs, T+1, n), angles wrapped to [−π, π); NaN where no truth is known.

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
        If the belief is no Gaussian, the axes do not fit, a value is infinite, or angles over
        several steps seem to be degrees.

    Examples
    --------
    >>> x = pgm.Variable("x", components=("east", "heading"), angles=("heading",))
    >>> belief = pgm.Gaussian(x, mean=[2.0, 3.0], cov=1.0)
    >>> pgm.consistency.error(belief, [1.5, -3.0]).round(3)
    array([ 0.5  , -0.283])
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
    require_radians(belief, values)
    return difference(belief.mean, spread, belief.angles)


def require_radians(belief: Gaussian, truth: Array) -> None:
    """Refuse a truth (..., T+1, n) of a belief whose angles seem to be in degrees."""
    known = labels(belief.scope)
    angles = [name for name, angle in zip(known, belief.angles, strict=True) if angle]
    if belief.steps is not None and (odd := in_degrees(truth, known, angles)):
        raise ModelError(f"a truth for the belief over {names(belief.scope)}: {odd}")


def place(belief: Gaussian, index: tuple[int, ...]) -> str:
    """One Gaussian's place among several, in words; empty if there is one."""
    words = []
    run = index if belief.steps is None else index[:-1]
    if run:
        words.append(f"run {', '.join(map(str, run))}")
    if belief.steps is not None:
        words.append(f"step {belief.steps[index[-1]]}")
    return f" at {', '.join(words)}" if words else ""


def places(belief: Gaussian, components: Sequence[str]) -> Integers:
    """The places of components in the stacked vector; all of them, where none is named."""
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
    """The length of the error over the components named, or all, (...); NaN if one is not known."""
    errors = error(belief, truth)[..., places(belief, components)]
    return np.asarray(np.sqrt(np.sum(errors**2, axis=-1)))


@public
def rmse(belief: Gaussian, truth: npt.ArrayLike, components: Sequence[str] = ()) -> float:
    """Root mean square error over all runs and steps, in the units of the components.

    √ of the mean of Σ e², the sum taken over the components named, or over all, the mean over the
    runs and steps at which the truth of all these is known.

    Parameters
    ----------
    belief : Gaussian
        For instance ``posterior[x]``.
    truth : array_like
        (..., n), its leading axes as `error` asks for.
    components : sequence of str
        Over which the error's length is taken, of one unit; all without.

    Raises
    ------
    ModelError
        If the truth or a component does not fit the belief, or none is known.

    Examples
    --------
    >>> x = pgm.Variable("x", components=("east", "north"))
    >>> belief = pgm.Gaussian(x, mean=[[3.0, 4.0], [0.0, 5.0]], cov=1.0, steps=[0, 1])
    >>> pgm.consistency.rmse(belief, [[0.0, 0.0], [0.0, 0.0]])
    5.0
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


@public
def nees(belief: Gaussian, truth: npt.ArrayLike, components: Sequence[str] = ()) -> Array:
    """Normalised estimation error squared, eᵀP⁻¹e, (*runs, T+1): χ² with n degrees of a right one.

    Where the truth of some components is not known, e and P are those of the others, n of them;
    NaN where that of none is.

    Parameters
    ----------
    belief : Gaussian
    truth : array_like
        (..., n), its leading axes as `error` asks for.
    components : sequence of str
        Whose marginal is judged, n of them; all without.

    Raises
    ------
    ModelError
        If the truth or a component does not fit the belief.
    NumericalError
        If a covariance is singular or infinite.

    Examples
    --------
    >>> x = pgm.Variable("x", components=("east", "north"))
    >>> belief = pgm.Gaussian(x, mean=[2.0, 3.0], cov=[4.0, 9.0])
    >>> float(pgm.consistency.nees(belief, [0.0, 0.0]))
    2.0

    References
    ----------
    Bar-Shalom, Li & Kirubarajan, Estimation with Applications to Tracking and Navigation, 2001,
    section 5.4.
    """
    return nees_and_dof(belief, truth, components)[0]


def nees_and_dof(
    belief: Gaussian, truth: npt.ArrayLike, components: Sequence[str]
) -> tuple[Array, Integers]:
    """The NEES, and its degrees of freedom: how many of the components are known, (...)."""
    squares, dof, _ = _normalised(belief, truth, components)
    return squares, dof


@public
def log_score(belief: Gaussian, truth: npt.ArrayLike, components: Sequence[str] = ()) -> Array:
    """The log-density ln N(x; μ, P) of the truth x, in nats, (*runs, T+1): more is better.

    −½ (eᵀP⁻¹e + ln |2πP|), e = μ − x, angles wrapped. On average over truths that the posterior p
    draws it is the largest for p itself, and less by KL(p ‖ N) for another: it pays for being
    sharp and for being right. Where the truth of some components is not known it is that of the
    others, and NaN where that of none is.

    Parameters
    ----------
    belief : Gaussian
    truth : array_like
        (..., n), its leading axes as `error` asks for.
    components : sequence of str
        Whose marginal is judged; all without.

    Raises
    ------
    ModelError
        If the truth or a component does not fit the belief.
    NumericalError
        If a covariance is singular or infinite.

    Examples
    --------
    >>> x = pgm.Variable("x")
    >>> belief = pgm.Gaussian(x, mean=[0.0], cov=[1.0])
    >>> float(pgm.consistency.log_score(belief, [1.0]).round(4))
    -1.4189

    References
    ----------
    Gneiting & Raftery, Strictly proper scoring rules, prediction, and estimation, 2007.
    """
    squares, dof, log_det = _normalised(belief, truth, components)
    return np.asarray(-0.5 * (squares + dof * np.log(2.0 * np.pi) + log_det))


def _normalised(
    belief: Gaussian, truth: npt.ArrayLike, components: Sequence[str]
) -> tuple[Array, Integers, Array]:
    """eᵀP⁻¹e, its degrees of freedom and ln |P|, (...) each, of the components that are known."""
    chosen = places(belief, components)
    errors = error(belief, truth)[..., chosen]
    known = ~np.isnan(errors)
    lower = roots.root(independent(block(belief.cov, chosen, chosen), known))
    # A root that does not exist is NaN.
    faulty = ~(np.diagonal(lower, axis1=-2, axis2=-1) > 0.0)
    if faulty.any():
        raise _no_scale(belief, [labels(belief.scope)[k] for k in chosen], faulty)
    white = solving.whiten(lower, np.where(known, errors, 0.0))
    dof = known.sum(axis=-1)
    squares = np.where(dof > 0, inner(white, white), np.nan)
    return squares, dof, solving.log_determinant(lower)


def _no_scale(belief: Gaussian, judged: list[str], faulty: Mask) -> NumericalError:
    singular = faulty.any(axis=-1)
    first = tuple(np.argwhere(singular)[0])
    found = ", ".join(label for label, at in zip(judged, faulty[first], strict=True) if at)
    leave = ""
    if where := place(belief, first):
        found = f"{int(singular.sum())} of {singular.size}, the first{where}, in {found}"
        leave = ", or leave such beliefs out, with belief[..., kept] and truth[..., kept, :]"
    return NumericalError(
        f"no NEES of {names(belief.scope)}: a covariance is infinite or singular ({found}), so "
        f"that an error has no scale; judge components that vary, with components=(...){leave}",
        variable=belief.scope[0],
        step=None if belief.steps is None else int(belief.steps[first[-1]]),
    )


@public
def nis(innovations: Innovations) -> Array:
    """Normalised innovation squared, rᵀS⁻¹r, (*runs, T+1); NaN at steps where nothing was read.

    χ² for a right model, its degrees the number of components read, ``innovations.dof``. After
    iterating, innovations are those of the last linearisation, z − (F x⁻ + b) at the predicted
    mean x⁻, not z − h(x⁻): they have seen the measurement that they are innovations of.

    Parameters
    ----------
    innovations : Innovations
        For instance ``posterior.innovations[z]``.

    Raises
    ------
    ModelError
        If they are no innovations.

    Examples
    --------
    >>> from pgm.examples import walk, z
    >>> filtered = pgm.filter(walk, {z: [[2.0], [3.0]]})
    >>> pgm.consistency.nis(filtered.innovations[z])
    array([nan,  1.,  1.])
    """
    return check_innovations(innovations).nis


@public
def kl(p: Gaussian, q: Gaussian) -> Array:
    """KL(p ‖ q), (...), in nats: what is lost by holding q where p is right; angles wrapped.

    Parameters
    ----------
    p, q : Gaussian
        Gaussians of one scope; leading axes broadcast.

    Raises
    ------
    ModelError
        If one of them is no Gaussian, their variables differ, or leading axes do not broadcast.
    NumericalError
        If a covariance is singular.

    Examples
    --------
    >>> x = pgm.Variable("x")
    >>> p, q = pgm.Gaussian(x, [0.0], 1.0), pgm.Gaussian(x, [2.0], 1.0)
    >>> float(pgm.consistency.kl(p, q))
    2.0
    """
    shapes = [check_gaussian(belief).mean.shape[:-1] for belief in (p, q)]
    try:
        np.broadcast_shapes(*shapes)
    except ValueError:
        raise ModelError(
            f"KL of beliefs over {names(p.scope)} with leading axes {shapes[0]} and {shapes[1]}; "
            "they must broadcast"
        ) from None
    return p.kl(q)
