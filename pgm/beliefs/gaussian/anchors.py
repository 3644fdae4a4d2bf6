"""The rows of an anchor: a measurement of each component, which holds a solution near a point.

An anchor says of a component x that its `mean` is x + e, e ~ N(0, std²/λ). In the coordinates of a
frame, x = m + s ξ, that is a factor of one row,

    (√λ / std) s ξ = (√λ / std) (mean − m).

V is the number of matrices that are kept of a factor, and N the number of right sides of each: V =
1 and N = runs where all runs share their matrices, else V = runs and N = 1.
"""

from __future__ import annotations

import numpy as np

from pgm.beliefs.gaussian.beliefs import Flat, by_run
from pgm.beliefs.gaussian.model import Model
from pgm.kernels.arrays import Array, Mask
from pgm.schedules.iteration import Anchor

# A deviation below this part of the frame's unit is rounding of what exact relations determine.
_DETERMINED = 1e-12


def anchor_rows(model: Model, anchor: Anchor | None) -> Flat:
    """The rows of an anchor, one for each hidden component; zeros where there is none.

    Components that relations without noise determine are not held, nor are runs of zero weight.
    Runs have weights of their own, and so must not share their matrices.
    """
    stacked, sides = (1, model.runs) if model.shared else (model.runs, 1)
    size = model.layout.size
    if anchor is None:
        return Flat(np.zeros((stacked, size)), np.zeros((stacked, size, sides)))
    held, root = holds(model, anchor)
    sharp = np.where(held, root, 0.0)
    right = sharp * (anchor.mean[0] - model.frame.mean)
    return Flat(sharp * model.frame.scale, by_run(right, shared=model.shared))


def holds(model: Model, anchor: Anchor) -> tuple[Mask, Array]:
    """Which components an anchor holds, and the roots √λ / std of their information, (runs, size).

    The roots of components that it does not hold are any numbers.
    """
    std, weight = anchor.std[0], anchor.weight[:, None]
    held = (std > _DETERMINED * model.frame.scale) & (weight > 0.0)
    return held, np.sqrt(weight) / np.where(std > 0.0, std, 1.0)
