"""Errors and innovations, measured by the covariance that a belief gives them; divergences."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from pgm.consistency.checks import check_gaussian, check_innovations
from pgm.consistency.errors import error, place, places
from pgm.errors import ModelError, NumericalError
from pgm.factors import Gaussian
from pgm.factors.scope import labels, names
from pgm.inference import Innovations
from pgm.kernels import roots
from pgm.kernels.arrays import Array, Integers, Mask, block, independent, inner


def nees(belief: Gaussian, truth: npt.ArrayLike, components: Sequence[str] = ()) -> Array:
    """Normalised estimation error squared, eᵀP⁻¹e, (...): χ² with n degrees for a right belief.

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
    chosen = places(belief, components)
    errors = error(belief, truth)[..., chosen]
    known = ~np.isnan(errors)
    lower = roots.root(independent(block(belief.cov, chosen, chosen), known))
    # A root that does not exist is NaN.
    faulty = ~(np.diagonal(lower, axis1=-2, axis2=-1) > 0.0)
    if faulty.any():
        raise _no_scale(belief, [labels(belief.scope)[k] for k in chosen], faulty)
    white = roots.whiten(lower, np.where(known, errors, 0.0))
    dof = known.sum(axis=-1)
    return np.where(dof > 0, inner(white, white), np.nan), dof


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


def nis(innovations: Innovations) -> Array:
    """Normalised innovation squared of each step, rᵀS⁻¹r, (..., T+1); NaN where nothing was read.

    χ² for a right model, its degrees the number of components read, ``innovations.dof``. After
    iterating, innovations are those of the last linearisation, z − (F x⁻ + b) at the predicted
    mean x⁻, not z − h(x⁻): they have seen the reading that they are innovations of.

    Parameters
    ----------
    innovations : Innovations
        As ``posterior.innovations[z]``.

    Raises
    ------
    ModelError
        If they are no innovations.
    """
    return check_innovations(innovations).nis


def kl(p: Gaussian, q: Gaussian) -> Array:
    """KL(p ‖ q), (...), in nats: what is lost by holding q where p is right; angles wrapped.

    Parameters
    ----------
    p, q : Gaussian
        Of one scope; leading axes broadcast.

    Raises
    ------
    ModelError
        If one of them is no Gaussian, they are over different variables, or their leading axes do
        not broadcast.
    NumericalError
        If a covariance is singular.
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
