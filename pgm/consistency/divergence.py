"""How far a belief is from another one."""

from __future__ import annotations

from pgm.factors import Gaussian
from pgm.kernels.arrays import Array


def kl(p: Gaussian, q: Gaussian) -> Array:
    """KL(p ‖ q), (...), in nats: what is lost by holding q where p is right; angles wrapped.

    See `Gaussian.kl`, which says what it raises.
    """
    return p.kl(q)
