"""Divergences of one belief from another."""

from __future__ import annotations

import numpy as np

from pgm.consistency.checks import check_gaussian
from pgm.errors import ModelError
from pgm.factors import Gaussian
from pgm.factors.scope import names
from pgm.kernels.arrays import Array


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
